"""Matrix of a diagram that must keep full row rank: its arguments and the desired path."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal, final

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from dmframe.analysis.joint_path import ToolPath, period_of
from dmframe.block.certificate import SX
from dmframe.block.model import symbols_in
from dmframe.block.port import Side
from dmframe.certify.true_values import true_values
from dmframe.common.errors import MissingError, listed
from dmframe.diagram import ClosedLoop, Diagram, Variable
from dmframe.diagram.closed_loop import Signal
from dmframe.exact.enclosure import Enclosure
from dmframe.results.dataset import element_labels
from dmframe.robot.symbolic import SymbolicRobot
from dmframe.simulate.rank import watched
from dmframe.simulate.start import start_state

Array = NDArray[np.float64]
Centre = Literal["truth", "start"]


@final
@dataclass(frozen=True)
class RankProblem:
    """Matrix J(q, a, p) that must keep full row rank, and the path.

    Parameters
    ----------
    matrix
        ``block.port``.
    parameters
        ``block.state`` of the estimate, or ``robot.a_k``.
    options
        Parameters ``block.name`` for a box and a ball of the estimate; empty without one.
    expression, q, a, p
        J and its arguments, SX.
    enclosed, values
        p with each element exact or enclosed, and p in floating point.
    centre
        (h,) centre of the set of a.
    estimate
        (h,) initial estimate; None without one.
    names
        Names of the elements of a.
    start
        (n,) initial joint positions of a run.
    reach
        Tool position and desired path; None for a user's joint path.
    path
        Argument of `dmframe.analysis.path_tube`: the same as expressions, with enclosures of their parameters.
    period
        Period of the desired path; see `period_of`.
    """

    matrix: str
    unit: str
    parameters: str
    options: Mapping[str, str]
    expression: SX
    q: SX
    a: SX
    p: SX
    enclosed: Sequence[Any]
    values: Array
    centre: Array
    estimate: Array | None
    names: tuple[str, ...]
    start: Array
    reach: ToolPath | None = None
    path: tuple[Any, ...] = ()
    period: float | None = None


def rank_problem(diagram: Diagram, start: Mapping[str, Any], centre: Centre, *, given: bool = False) -> RankProblem:
    """Find a diagram's first matrix that must keep full row rank; `given`: the joint path is known and not computed.

    Raises
    ------
    MissingError
        There is no such matrix or no path to follow, or the matrix depends on more than a pose and one estimate.
    """
    matrices = watched(diagram)
    if not matrices:
        raise MissingError(
            "rank: expected a block with a matrix that must keep full row rank, such as J_hat; found none"
        )
    loop, signal = diagram.loop, matrices[0]
    state = start_state(diagram, start)
    (matrix,) = loop.joined([signal.expression])
    label, output, desired, actual = _goal(loop)
    joints = _only([v for v in loop.plant if _depends(actual, v)], f"one state of the plant behind {label}")
    estimates = [v for v in loop.controller if _depends(matrix, v)]
    common: dict[str, Any] = {"matrix": signal.label, "unit": signal.unit, "q": joints.symbol}
    common["start"] = _part(loop, state, joints)
    if not given:
        _refuse_others(diagram, label, output)
        wanted = _timed(loop, label, desired)
        common["reach"] = _reach(loop, wanted, actual, joints)
        common["path"] = actual, joints.symbol, wanted, loop.time, loop.p, _enclosed(diagram)
        common["period"] = period_of(_numeric(loop, wanted), loop.time)
    if estimates:
        found = _adapted(diagram, _only(estimates, f"one estimate in {signal.label}"), state, centre)
        found["expression"] = matrix
    else:
        found = _known(diagram, signal, matrix, joints)
    problem = RankProblem(**common, **found)
    known = symbols_in([problem.q]) | symbols_in([problem.a]) | symbols_in([problem.p])
    if symbols_in([problem.expression]) - known:
        raise MissingError(f"{signal.label}: expected a matrix of the pose and the kinematic parameters alone")
    return problem


def _adapted(diagram: Diagram, estimate: Variable, state: Array, centre: Centre) -> dict[str, Any]:
    """Set of the estimate, about its true value or its start."""
    loop = diagram.loop
    begin = _part(loop, state, estimate)
    truth = true_values(diagram).get(estimate.label) if centre == "truth" else begin
    if truth is None:
        text = f"{estimate.label}: expected a certificate that names the true value, found none; use centre start"
        raise MissingError(text)
    declared = next(s for s in diagram.blocks[estimate.block].states if s.name == estimate.name)
    options = {"box": declared.box, "ball": declared.ball}
    return {
        "parameters": estimate.label,
        "options": {shape: f"{estimate.block}.{name}" for shape, name in options.items() if name},
        "a": estimate.symbol,
        "p": loop.p,
        "enclosed": _enclosed(diagram),
        "values": loop.p_values,
        "centre": truth,
        "estimate": begin,
        "names": element_labels(diagram, estimate.shape, estimate.symbol.numel()),
    }


def _known(diagram: Diagram, signal: Signal, matrix: SX, joints: Variable) -> dict[str, Any]:
    """Set about known kinematics: every translation may be wrong, also those that are zero in the model."""
    if diagram.robot is None:
        raise MissingError(f"{signal.label}: expected a robot, whose translations are the parameters; found none")
    robot = SymbolicRobot(diagram.robot)
    a = ca.SX.sym("a_k", robot.k)
    expression = robot.jacobian(joints.symbol, a)
    others = [constant for constant in robot.constants if constant.name != "robot.a_k"]
    translations = next(constant for constant in robot.constants if constant.name == "robot.a_k")
    found = {
        "parameters": "robot.a_k",
        "options": {},
        "expression": expression,
        "a": a,
        "p": ca.vertcat(ca.SX(0, 1), *(constant.symbol for constant in others)),
        "enclosed": [Enclosure.around(value) for constant in others for value in constant.values],
        "values": np.array([float(value) for constant in others for value in constant.values]),
        "centre": np.array([float(value) for value in translations.values]),
        "estimate": None,
        "names": tuple(f"{place} {axis}" for place in (*diagram.robot.joint_names, "tool") for axis in "xyz"),
    }
    pose = np.random.default_rng(0).uniform(-1, 1, joints.symbol.numel())
    given = ca.Function("own", [joints.symbol, a, found["p"]], [expression])
    own = given(pose, found["centre"], found["values"]).full()
    used = ca.Function("used", [joints.symbol, diagram.loop.p], [matrix], {"allow_free": True})
    if used.has_free() or not np.allclose(used(pose, diagram.loop.p_values).full(), own, atol=1e-9):
        text = f"{signal.label}: expected the robot's own Jacobian where no block estimates it"
        raise MissingError(f"{text}, found another matrix")
    return found


def _enclosed(diagram: Diagram) -> list[Enclosure]:
    """Parameters of the loop, each element a number or, if it is rational, an enclosure."""
    enclosed = list[Enclosure]()
    for parameter in diagram.loop.parameters:
        rational = parameter.rational
        numbers = parameter.value.ravel(order="F") if rational is None else map(Enclosure.around, rational)
        enclosed += [Enclosure.of(number) for number in numbers]
    return enclosed


_PASS_PATH: Final = "pass the joint path of a run: rank_region(..., path=...)"


def _goal(loop: ClosedLoop) -> tuple[str, str, SX, SX]:
    pairs = loop.followed
    if not pairs:
        raise MissingError("rank: expected a path that a measured signal follows, such as x_d; found none")
    label, output, desired, actual = pairs[0]
    return label, output, desired, loop.joined([actual])[0]


def _refuse_others(diagram: Diagram, label: str, output: str) -> None:
    """Raise `MissingError` if the robot follows another goal, which would change its joint path."""
    loop = diagram.loop
    led = dict(loop.led).get(output)
    if led is not None:
        text = f"found {led}, which a controller block computes from {label} and {output} follows"
        raise MissingError(f"rank: expected a path that is known in advance, {text}; {_PASS_PATH}")
    sources = {name for name, block in diagram.blocks.items() if block.side is Side.SOURCE}
    others = [s.label for s in loop.outputs if s.block in sources and s.name.endswith("_d") and s.label != label]
    if others:
        text = f"found {listed(others)} too, which also determines the joint positions and is not supported here"
        raise MissingError(f"rank: expected {label} as the only goal, {text}; {_PASS_PATH}")


def _timed(loop: ClosedLoop, label: str, desired: SX) -> SX:
    """Desired path as a function of time and parameters; raises `MissingError` if it depends on anything else."""
    wanted = loop.on_path(loop.joined([desired])[0])
    others = symbols_in([wanted]) - symbols_in([loop.time]) - symbols_in([loop.p])
    if others:
        moving = listed([v.label for v in loop.variables if v.identities & others] or ["a signal"])
        text = f"found {label}, which also depends on {moving}"
        raise MissingError(f"rank: expected a path that is a function of time, {text}; {_PASS_PATH}")
    return wanted


def _reach(loop: ClosedLoop, desired: SX, actual: SX, joints: Variable) -> ToolPath:
    p = loop.p_values
    values = ca.Function("actual", [joints.symbol, loop.p], [ca.vec(actual)])
    slopes = ca.Function("slope", [joints.symbol, loop.p], [ca.jacobian(ca.vec(actual), joints.symbol)])
    goal = ca.Function("goal", [loop.time, loop.p], [ca.vec(desired)])
    return ToolPath(
        lambda q: np.asarray(values(q, p).full().ravel()),
        lambda q: np.asarray(slopes(q, p).full()),
        lambda t: np.asarray(goal(t, p).full().ravel()),
    )


def _numeric(loop: ClosedLoop, expression: SX) -> SX:
    return ca.substitute(expression, loop.p, ca.SX(ca.DM(loop.p_values)))


def _part(loop: ClosedLoop, state: Array, variable: Variable) -> Array:
    sizes = [(v.label, v.symbol.numel()) for v in loop.variables]
    first = sum(size for _, size in sizes[: [label for label, _ in sizes].index(variable.label)])
    return state[first : first + variable.symbol.numel()]


def _depends(expression: SX, variable: Variable) -> bool:
    return bool(symbols_in([expression]) & variable.identities)


def _only(found: Sequence[Variable], expected: str) -> Variable:
    if len(found) != 1:
        labels = ", ".join(variable.label for variable in found) or "none"
        raise MissingError(f"rank: expected {expected}, found {labels}")
    return found[0]
