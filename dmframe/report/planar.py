r"""The equations of a planar arm, written out: M, C, g and the regressor Y_d, from the expressions that run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, final

import casadi as ca

from dmframe.regressor.full import parameter_names
from dmframe.report.harmonics import harmonics, harmonics_latex
from dmframe.report.laws import Row
from dmframe.robot.chain import SerialChain
from dmframe.robot.symbolic import SymbolicRobot

MOST_JOINTS = 3


@final
@dataclass(frozen=True)
class RobotModel:
    """What a report shows of a robot.

    Parameters
    ----------
    about
        Marked text: what the symbols are.
    rows
        The entries of M, C and g as equations.
    regressor
        A row a parameter: its LaTeX, and its column of Y_d, an entry a joint.
    """

    about: str
    rows: tuple[Row, ...]
    regressor: tuple[tuple[str, tuple[str, ...]], ...]


def robot_model(chain: SerialChain | None) -> RobotModel | None:
    """The equations of an arm of at most three joints that moves in a plane; None for any other robot."""
    if chain is None or chain.n > MOST_JOINTS or chain.m > 2:
        return None
    robot = SymbolicRobot(chain)
    if any(constant.name.endswith(".rotations") for constant in robot.constants):
        return None
    try:
        return _written(_Printer(robot))
    except LookupError:
        return None


@final
class _Printer:
    """The symbols of a robot's motion and parameters, and how each is printed."""

    def __init__(self, robot: SymbolicRobot) -> None:
        self.robot, n = robot, robot.n
        self.q, self.dq = ca.SX.sym("q", n), ca.SX.sym("dq", n)
        self.v, self.dv = ca.SX.sym("v", n), ca.SX.sym("dv", n)
        self.inertia = [_inertial(name) for name in parameter_names(n)]
        gravity = [x for x in robot.chain.gravity if x]
        self.down = next((c.symbol for c in robot.constants if c.name.endswith(".gravity")), ca.SX(0, 1))
        self.sign = -1 if gravity and gravity[0] < 0 else 1
        axes = [axis for axis, x in zip("xyz", robot.chain.gravity, strict=True) if x]
        weights = ["g_0"] if len(axes) == 1 else [f"g_{{{axis}}}" for axis in axes]
        a_k = next(c.symbol for c in robot.constants if c.name.endswith(".a_k"))
        places = [f"p_{{{axis}{i}}}" for i in range(1, n + 1) for axis in "xyz"] + [f"p_{{{axis}t}}" for axis in "xyz"]
        named = [
            (robot.inertia, self.inertia),
            (a_k, places),
            (self.down, weights),
            (self.dv, [rf"\dot v_{i}" for i in range(1, n + 1)]),
            (self.v, [f"v_{i}" for i in range(1, n + 1)]),
            (self.dq, [rf"\dot q_{i}" for i in range(1, n + 1)]),
        ]
        self.symbols = [element for symbol, _ in named for element in ca.vertsplit(symbol)]
        self.names = [name for _, names in named for name in names]

    def __call__(self, entry: Any) -> str:
        """One entry of a matrix; g_0 counts downwards."""
        if self.down.numel() == 1 and self.sign < 0:
            entry = ca.substitute(entry, self.down, -self.down)
        return harmonics_latex(harmonics(entry, ca.vertsplit(self.q), self.symbols), self.names)

    def without_zeros(self, expression: Any) -> Any:
        """Inertial parameters that are zero in this robot left away."""
        zero = [k for k, x in enumerate(v for row in self.robot.chain.inertia for v in row) if x == 0]
        symbols = [self.robot.inertia[k] for k in zero]
        return ca.substitute(expression, ca.vertcat(*symbols), ca.SX.zeros(len(zero))) if zero else expression


def _inertial(name: str) -> str:
    head, _, tail = name.partition("_")
    return rf"\mathrm{{{head}}}_{{{tail}}}" if len(head) > 1 else f"{head}_{{{tail}}}"


def _written(show: _Printer) -> RobotModel:
    robot, n = show.robot, show.robot.n
    M = show.without_zeros(robot.mass_matrix(show.q))
    C = show.without_zeros(robot.coriolis(show.q, show.dq))
    g = show.without_zeros(robot.gravity_torque(show.q))
    rows = [_entry(show, "M", M, i, j) for i in range(n) for j in range(i, n)]
    rows += [_entry(show, "C", C, i, j) for i in range(n) for j in range(n)]
    rows += [Row(f"g_{i + 1}", f"= {show(g[i])}") for i in range(n)]
    Y_d = ca.densify(robot.regressor(show.q, show.dq, show.v, show.dv))
    columns = [(name, tuple(show(Y_d[i, k]) for i in range(n))) for k, name in enumerate(show.inertia)]
    return RobotModel(
        about=_about(robot.chain),
        rows=tuple(rows),
        regressor=tuple((name, column) for name, column in columns if any(entry != "0" for entry in column)),
    )


def _entry(show: _Printer, letter: str, matrix: Any, i: int, j: int) -> Row:
    mirrored = f" = {letter}_{{{j + 1}{i + 1}}}" if letter == "M" and i != j else ""
    return Row(f"{letter}_{{{i + 1}{j + 1}}}{mirrored}", f"= {show(matrix[i, j])}")


def _about(chain: SerialChain) -> str:
    joints = ", ".join(chain.joint_names)
    return (
        f"The equations of {chain.name} (joints {joints}), printed from the very expressions that are simulated and "
        "proved. $c_{12}$ stands for $\\cos(q_1 + q_2)$ and $s_2$ for $\\sin q_2$; $m_i$, $\\mathrm{mc}_i$ and $I_i$ "
        "are mass, first moments and inertia of link i about the origin of joint i, in its frame; $p_{x2}$ is the x "
        "coordinate of joint 2 in the frame of joint 1, $g_0$ the gravity. Parameters that are zero in this robot are "
        "left away in M, C and g, not in the regressor, where $v = \\dot q_{ref}$."
    )
