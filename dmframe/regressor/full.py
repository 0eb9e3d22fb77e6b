"""The full regressor: ten inertial parameters a link, and friction where asked for."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, Final, Literal, final

import casadi as ca

from dmframe.errors import UnknownNameError
from dmframe.exact import Tape, Trial
from dmframe.robot.chain import SerialChain
from dmframe.robot.symbolic import SymbolicRobot

Friction = Literal["viscous", "coulomb"]

INERTIAL: Final = ("m", "mc_x", "mc_y", "mc_z", "I_xx", "I_xy", "I_yy", "I_xz", "I_yz", "I_zz")
SIGNALS: Final = ("q", "dq", "dq_ref", "ddq_ref")
KINEMATIC_SIGNALS: Final = ("q", "psi")
_FRICTION: Final = {"viscous": "B", "coulomb": "D"}


def parameter_names(n: int, friction: Collection[str] = ()) -> tuple[str, ...]:
    """m_1, mc_x1, ..., I_zzn in Pinocchio's order, then B_1, ... (viscous) and D_1, ... (Coulomb).

    Raises `UnknownNameError` for a kind of friction that is neither.
    """
    for kind in friction:
        if kind not in _FRICTION:
            raise UnknownNameError(f"friction {kind}", "kind of friction", kind, _FRICTION)
    inertial = [_indexed(name, link) for link in range(1, n + 1) for name in INERTIAL]
    return (*inertial, *(f"{_FRICTION[kind]}_{i}" for kind in _FRICTION if kind in friction for i in range(1, n + 1)))


def _indexed(name: str, link: int) -> str:
    return f"{name}{link}" if "_" in name else f"{name}_{link}"


def parameter_values(chain: SerialChain) -> tuple[Fraction, ...]:
    """The inertial parameters that the robot's model states, in the order of `parameter_names`; friction has none."""
    return tuple(value for row in chain.inertia for value in row)


@final
@dataclass(frozen=True, eq=False)
class FullRegressor:
    """Y_d (n, p) as a function of q, dq, dq_ref, ddq_ref and then of the robot's constants.

    `values` are those of the constants; `a_k` is the place of the translations among them.
    """

    function: ca.Function
    names: tuple[str, ...]
    values: tuple[tuple[Fraction, ...], ...]
    a_k: int

    @property
    def n(self) -> int:
        """The number of joints."""
        return int(self.function.size1_out(0))


def full_regressor(chain: SerialChain, friction: Collection[str] = ()) -> FullRegressor:
    r"""The Slotine-Li regressor of :math:`M\ddot q_r + C\dot q_r + g + B\dot q_r + D\varphi(\dot q_r)`, eq. (5).

    q_r-dot is `dq_ref`; friction columns are diag(dq_ref) and diag(phi(dq_ref)), phi the robot's smooth sign.
    """
    names = parameter_names(chain.n, friction)
    robot = SymbolicRobot(chain)
    signals = [ca.SX.sym(name, chain.n) for name in SIGNALS]
    columns: list[Any] = [robot.regressor(*signals)]
    if "viscous" in friction:
        columns.append(ca.diag(signals[2]))
    if "coulomb" in friction:
        columns.append(ca.diag(robot.coulomb(signals[2])))
    symbols = [constant.symbol for constant in robot.constants]
    place = next(i for i, constant in enumerate(robot.constants) if constant.name.endswith(".a_k"))
    function = ca.Function("Y_d", [*signals, *symbols], [ca.densify(ca.horzcat(*columns))])
    return FullRegressor(function, names, tuple(constant.values for constant in robot.constants), place)


@final
class Sampler:
    """Rows of the full regressor at random motions, in the field of a trial."""

    def __init__(self, regressor: FullRegressor) -> None:
        self.regressor = regressor
        self.columns = len(regressor.names)
        self._tape = Tape.from_function(regressor.function)

    def constants(self, trial: Trial) -> list[list[int]]:
        """The robot's constants as residues."""
        return [[trial.residue(value) for value in values] for values in self.regressor.values]

    def rows(self, trial: Trial, constants: Sequence[Sequence[int]]) -> list[list[int]]:
        """The n rows at one random motion."""
        n = self.regressor.n
        motion = [[trial.random() for _ in range(n)] for _ in SIGNALS]
        [dense] = self._tape.evaluate([*motion, *constants], trial)
        return [dense[i::n] for i in range(n)]
