"""What a page evaluates beside the run itself: where it starts, what is drawn of it, and whether the proof holds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, final

import casadi as ca

from dmframe.block.model import symbols_in
from dmframe.certificate import SX
from dmframe.certify import Verdict
from dmframe.certify.checked import Checked
from dmframe.certify.payment import least_kappa
from dmframe.certify.true_values import estimated
from dmframe.diagram import ClosedLoop, Diagram, Variable
from dmframe.diagram.closed_loop import stack
from dmframe.diagram.parts import Parts
from dmframe.results.metrics import goal_of
from dmframe.robot.frames import frames, tool
from dmframe.simulate.start import NEAR, symbolic_start
from dmframe.simulate.step import build_parts


@final
@dataclass(frozen=True)
class Group:
    """Curves that share a plot: rows of `shown`, or of the state.

    Parameters
    ----------
    kind
        ``error``, ``storage``, ``command``, or ``estimate``.
    label
        Of the signals, as ``block.name``; texts that a person reads are made elsewhere.
    of
        ``shown`` or ``state``: the column in which the rows stand, from `first` on.
    true
        Where the true values stand in the column of `judged`; None where they are none of parameters alone.
    """

    kind: str
    label: str
    of: str
    first: int
    size: int
    unit: str
    true: int | None = None


@final
@dataclass(frozen=True)
class Functions:
    """CasADi functions of the closed loop, all of columns.

    Parameters
    ----------
    parts
        Of a tick; nothing is recorded beside the state.
    begin
        (pose, T, p) -> the state at the start.
    reach
        (pose, p) -> how far the pose is from the path's start, and the slope of that; None where nothing is sought.
    flow
        (state, t, T, p) -> the rates of what flows in the plant.
    shown
        (state, t, T, p) -> what is drawn of an instant: `scene`, then the groups.
    judged
        p -> the margins of `conditions`, the least kappa, and the true values of estimates.
    scene
        How many numbers of `shown` place the robot: 12 a joint, then 3 of the tool.
    margins
        For each condition where its margins stand in `judged`, first and count; None for one that is not judged.
    kappa
        Where the least kappa stands; None without a cascade.
    """

    parts: Parts
    posed: Variable | None
    begin: Any
    reach: Any
    flow: Any
    shown: Any
    judged: Any
    scene: int
    goal: Group | None
    groups: tuple[Group, ...]
    conditions: tuple[Checked, ...]
    margins: tuple[tuple[int, int] | None, ...]
    kappa: int | None

    @property
    def exported(self) -> tuple[Any, ...]:
        """Those that stand beside the run."""
        return tuple(f for f in (self.begin, self.reach, self.flow, self.shown, self.judged) if f is not None)


def functions_of(diagram: Diagram, clock: float | None, start: Mapping[str, Any], verdict: Verdict) -> Functions:
    """All of them for one diagram; V is drawn where it is proved."""
    loop, posed, followed = diagram.loop, _posed(diagram), goal_of(diagram.loop)
    units = {signal.label: signal.unit for signal in loop.outputs}
    judged, margins = _margins(loop, verdict)
    kappa = None
    if verdict.outcome == "proved" and verdict.claim is not None and verdict.claim.cascaded:
        kappa = judged.numel()
        judged = ca.vertcat(judged, _chosen_least(verdict))
    scene, drawn, groups = _scene(diagram, posed), list[SX](), list[Group]()
    size = scene.numel()

    def add(kind: str, label: str, unit: str, expression: SX) -> Group:
        nonlocal size
        groups.append(Group(kind, label, "shown", size, expression.numel(), unit))
        drawn.append(expression)
        size += expression.numel()
        return groups[-1]

    goal = None
    if followed is not None:
        unit = units[followed.actual]
        goal = add("goal", followed.desired, unit, ca.vec(followed.wanted))
        groups.pop()
        add("error", followed.actual, unit, ca.vec(followed.found) - ca.vec(followed.wanted))
    if verdict.outcome == "proved" and verdict.claim is not None:
        add("storage", "", "", _terms(verdict))
    for leaf in loop.commanded:
        if leaf.name.rpartition(".")[2].endswith("_c"):
            add("command", leaf.name, units.get(leaf.name, ""), ca.vec(leaf.symbol))
    truths = estimated(diagram)
    for variable in (variable for variable in loop.controller if variable.label in truths):
        label, true, first = variable.label, truths[variable.label], _place(loop, variable)
        groups.append(
            Group(
                "estimate",
                label,
                "state",
                first,
                variable.symbol.numel(),
                variable.unit,
                None if true is None else judged.numel(),
            )
        )
        judged = judged if true is None else ca.vertcat(judged, true)
    reads = [loop.state, loop.time, loop.period, loop.p]
    shown = loop.on_path(loop.acting([stack([scene, *drawn])])[0])
    return Functions(
        parts=build_parts(loop, clock, ca.SX(0, 1)),
        posed=posed,
        begin=_function("begin", [_pose(posed), loop.period, loop.p], [symbolic_start(diagram, start, posed)]),
        reach=_reach(diagram, posed, start),
        flow=_function("flow", reads, [loop.on_path(loop.acting([stack(v.rate for v in loop.flowing)])[0])]),
        shown=_function("shown", reads, [ca.substitute(shown, loop.drawn, ca.SX.zeros(loop.drawn.numel()))]),
        judged=_function("judged", [loop.p], [judged]),
        scene=scene.numel(),
        goal=goal,
        groups=tuple(groups),
        conditions=verdict.conditions,
        margins=margins,
        kappa=kappa,
    )


def _function(name: str, reads: Sequence[SX], gives: Sequence[SX]) -> Any:
    return ca.Function(name, list(reads), [ca.cse(ca.densify(given)) for given in gives])


def _pose(posed: Variable | None) -> SX:
    return ca.SX.sym("pose", 0) if posed is None else posed.symbol


def _posed(diagram: Diagram) -> Variable | None:
    """The plant's state that places its robot, or else what follows a trajectory itself."""
    for variable in diagram.loop.plant:
        robot = diagram.models[variable.block].robot
        if robot is not None and variable.name == "q" and variable.symbol.numel() == robot.n:
            return variable
    return next((variable for variable in diagram.loop.plant if variable.name == "q"), None)


def _scene(diagram: Diagram, posed: Variable | None) -> SX:
    robot = diagram.models[posed.block].robot if posed is not None else None
    if robot is None or posed is None:
        return ca.SX(0, 1)
    return ca.vertcat(ca.vec(frames(robot, posed.symbol)), tool(robot, posed.symbol))


def _place(loop: ClosedLoop, variable: Variable) -> int:
    sizes = {other.label: other.symbol.numel() for other in loop.variables}
    labels = list(sizes)
    return sum(sizes[label] for label in labels[: labels.index(variable.label)])


def _reach(diagram: Diagram, posed: Variable | None, start: Mapping[str, Any]) -> Any:
    loop, given = diagram.loop, {key for key in start if key != NEAR}
    if posed is None or given & {posed.label, posed.name}:
        return None
    for pair in loop.followed:
        wanted, found = (loop.joined([ca.vec(side)])[0] for side in (pair.wanted, pair.found))
        unknown = {v.label for v in loop.variables if ca.depends_on(found, ca.vec(v.symbol))}
        if unknown == {posed.label}:
            goal = ca.substitute(loop.on_path(wanted), loop.time, ca.SX(0))
            return _function("reach", [posed.symbol, loop.p], [found - goal, ca.jacobian(found, posed.symbol)])
    return None


def _margins(loop: ClosedLoop, verdict: Verdict) -> tuple[SX, tuple[tuple[int, int] | None, ...]]:
    """All margins as one column, and where each condition's stand."""
    known = symbols_in(parameter.symbol for parameter in loop.parameters)
    column, places = ca.SX(0, 1), list[tuple[int, int] | None]()
    for condition in verdict.conditions:
        margin = None if condition.margin is None else loop.joined([ca.vec(ca.densify(condition.margin))])[0]
        if margin is None or not symbols_in([margin]) <= known:
            places.append(None)
            continue
        places.append((column.numel(), margin.numel()))
        column = ca.vertcat(column, margin)
    return column, tuple(places)


def _chosen_least(verdict: Verdict) -> SX:
    assert verdict.claim is not None
    return verdict.claim.loop.joined([least_kappa(verdict.claim)])[0]


def _terms(verdict: Verdict) -> SX:
    """The terms of V, with kappa as `payment` chooses it: twice the least, or one where nothing has to be paid."""
    claim = verdict.claim
    assert claim is not None
    column = stack(claim.weight(part) * square.value / 2 for part in claim.parts for square in part.certificate.storage)
    if not claim.cascaded:
        return column
    least = _chosen_least(verdict)
    return ca.substitute(column, claim.kappa, ca.if_else(least > 0, 2 * least, 1))
