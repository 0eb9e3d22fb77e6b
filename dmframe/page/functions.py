"""CasADi functions that a page evaluates in addition to the loop: start, plotted signals, margins of the proof."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass
from typing import Any, final

import casadi as ca
import numpy as np

from dmframe.block.certificate import SX
from dmframe.certify import Verdict
from dmframe.certify.checked import Checked
from dmframe.certify.claim import Claim
from dmframe.certify.parameter_margins import Intervals, ParameterMargin, least_kappa, parameter_margins
from dmframe.certify.true_values import estimated
from dmframe.diagram import ClosedLoop, Diagram, Variable
from dmframe.diagram.closed_loop import stack
from dmframe.diagram.parts import Parts
from dmframe.results.metrics import TurnError, goal_of, turn_of
from dmframe.robot.frames import frames, tool
from dmframe.simulate.keep import rotation_distance_of
from dmframe.simulate.start import NEAR, turned
from dmframe.simulate.start_expressions import symbolic_start
from dmframe.simulate.step import build_parts


@final
@dataclass(frozen=True)
class Group:
    """Curves in one plot: rows of `shown` or of the state.

    Parameters
    ----------
    kind
        ``error``, ``turn`` (orientation error of a tool), ``storage``, ``steps`` (source whose steps start a new V),
        ``command`` or ``estimate``.
    label
        Label ``block.name`` of the signal.
    of
        ``shown`` or ``state``: the column with the rows, from `first` on.
    true
        Position of the true values in `judged`; None if they do not depend on parameters only.
    """

    kind: str
    label: str
    of: str
    first: int
    size: int
    unit: str
    true: int | None = None


Place = tuple[int, int]
"""First and count."""


@final
@dataclass(frozen=True)
class Functions:
    """CasADi functions of the closed loop; all arguments and results are columns.

    Parameters
    ----------
    parts
        Functions of one sample; only the state is recorded.
    begin
        (pose, T, p) -> initial state.
    reach
        (pose, p) -> distance of the pose from the start of the path, and its Jacobian; None without a sought pose.
    shown
        (state, t, T, p) -> plotted values: `scene`, then the groups.
    stored
        (state, t, T, p) -> V and the values of sources whose steps start a new V; None without V.
    judged
        (pose, T, p) -> margins of `conditions`, least kappa, true values of estimates. Conditions may depend on initial
        states, which are taken as given, inside their box or not.
    starts
        Rows of the state whose initial values depend on pose or p, and the elements of p that they depend on.
    scene
        Number of values in `shown` for the robot: 12 a joint, then 3 of the tool.
    margins
        Position of the margins of each condition in `judged`, first and count; None without margins.
    tacit
        Additional requirements that may fail at other parameter values, with the positions of their margins.
    reads
        For each condition, then for `tacit`: elements of (p, initial state) it depends on; None with margins, or if
        unknown.
    operations
        Number of operations of V; 0 without V.
    kappa
        Position of the least kappa in `judged`; None without a cascade.
    """

    parts: Parts
    posed: Variable | None
    begin: Any
    reach: Any
    shown: Any
    judged: Any
    scene: int
    goal: Group | None
    groups: tuple[Group, ...]
    conditions: tuple[Checked, ...]
    margins: tuple[Place | None, ...]
    tacit: tuple[tuple[ParameterMargin, Place | None], ...]
    reads: tuple[tuple[int, ...] | None, ...]
    kappa: int | None
    stored: Any = None
    starts: tuple[tuple[int, ...], tuple[int, ...]] = ((), ())
    operations: int = 0

    @property
    def exported(self) -> tuple[Any, ...]:
        """Functions exported in addition to the loop."""
        return tuple(f for f in (self.begin, self.reach, self.shown, self.judged, self.stored) if f is not None)

    def heeded(self, moved: Set[int], values: np.ndarray) -> set[int]:
        """Elements of p among `moved` that affect any visible result, the others fixed at `values`.

        Without Coulomb friction, for example, its velocity has no effect.
        """
        found, parts = set[int](), self.parts
        for function in (parts.trajectory, parts.sample, parts.rate, parts.clip, *self.exported):
            *given, p = (ca.SX.sym("given", function.size_in(i)) for i in range(function.n_in()))
            kept = ca.vertcat(*(p[k] if k in moved else ca.SX(float(values[k])) for k in range(p.numel())))
            seen = ca.vertcat(*map(ca.vec, function.call([*given, kept])))
            if function is self.judged:  # a number that only has to be positive is so at every factor
                tacit = {row for _, place in self.tacit if place for row in range(place[0], sum(place))}
                rows = [row for row in range(seen.numel()) if row not in tacit and not seen[row].is_symbolic()]
                seen = seen[rows]
            at = {p[k].element_hash(): k for k in moved}
            found |= {at[symbol.element_hash()] for symbol in ca.symvar(seen) if symbol.element_hash() in at}
        return found


def functions_of(
    diagram: Diagram,
    clock: float | None,
    start: Mapping[str, Any],
    verdict: Verdict,
    uncertain: Intervals | None = None,
) -> Functions:
    """Build the functions of a diagram, with V if proved; `uncertain` are the intervals given to `verify`."""
    loop, posed, followed = diagram.loop, _posed(diagram), goal_of(diagram.loop)
    units = {signal.label: signal.unit for signal in loop.outputs}
    claim = verdict.claim
    started, initial = symbolic_start(diagram, start, posed)
    known, reach = [_pose(posed), loop.period, loop.p], _reach(diagram, posed, start)
    starts, labels = _starts(loop, _function("start", known, [started]), reach)
    everything = parameter_margins(verdict.conditions, claim, uncertain or {}, labels)
    judged, places = _margins(everything)
    count, kappa, least = len(verdict.conditions), None, None
    if verdict.outcome == "proved" and verdict.flow_claim is not None and verdict.flow_claim.cascaded:
        kappa, least = judged.numel(), least_kappa(verdict.flow_claim, uncertain or {})
        judged = ca.vertcat(judged, least)
    scene, drawn, groups = _scene(diagram, posed), list[SX](), list[Group]()
    size = scene.numel()

    def add(kind: str, label: str, unit: str, expression: SX) -> Group:
        nonlocal size
        group = Group(kind, label, "shown", size, expression.numel(), unit)
        drawn.append(expression)
        size += expression.numel()
        return group

    goal = None
    if followed is not None:
        unit = units[followed.actual]
        goal = add("goal", followed.desired, unit, ca.vec(followed.wanted))
        groups.append(add("error", followed.actual, unit, ca.vec(followed.found) - ca.vec(followed.wanted)))
    turn, distance = turn_of(loop), rotation_distance_of(loop)
    if turn is not None and distance is not None:
        groups.append(add("turn", distance, TurnError.unit, turn))
    operations, whole = 0, list[SX]()
    if verdict.outcome == "proved" and verdict.flow_claim is not None:
        stored = _terms(verdict, least)
        operations = _function(
            "V", [loop.state, loop.time, loop.p], [loop.on_path(loop.acting([stored])[0])]
        ).n_instructions()
        groups.append(add("storage", "", "", stored))
        whole.append(ca.sum1(stored))
        for signal in loop.outputs:
            name = signal.label.rpartition(".")[2]
            if any(out.steps and out.name == name for out in diagram.models[signal.block].block.outputs):
                groups.append(add("steps", signal.label, signal.unit, ca.vec(signal.expression)))
                whole.append(ca.vec(signal.expression))
    for leaf in loop.commanded:
        if leaf.name.rpartition(".")[2].endswith("_c"):
            groups.append(add("command", leaf.name, units.get(leaf.name, ""), ca.vec(leaf.symbol)))
    truths = estimated(diagram)
    for variable in (variable for variable in loop.controller if variable.label in truths):
        label, true, first = variable.label, truths[variable.label], place_of(loop, variable)
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

    def read(name: str, columns: Sequence[SX]) -> Any:
        without = ca.substitute(loop.on_path(loop.acting([stack(columns)])[0]), loop.drawn, 0 * loop.drawn)
        return _function(name, reads, [without])

    return Functions(
        parts=build_parts(loop, clock, ca.SX(0, 1)),
        posed=posed,
        begin=_function("begin", known, [initial]),
        reach=reach,
        shown=read("shown", [scene, *drawn]),
        stored=read("stored", whole) if whole else None,
        judged=_function("judged", known, [_started(claim, judged, started)]),
        scene=scene.numel(),
        goal=goal,
        groups=tuple(groups),
        conditions=verdict.conditions,
        margins=places[:count],
        tacit=tuple(zip(everything[count:], places[count:], strict=True)),
        reads=_reads(loop, claim, everything),
        kappa=kappa,
        starts=starts,
        operations=operations,
    )


def _starts(loop: ClosedLoop, started: Any, reach: Any) -> tuple[tuple[tuple[int, ...], tuple[int, ...]], set[str]]:
    """`Functions.starts`, and the labels of the states of these rows."""
    patterns = [np.asarray(started.jac_sparsity(0, i).row()) for i in (0, 2)]
    rows = sorted({int(row) for pattern in patterns for row in pattern})
    read = set(started.jac_sparsity(0, 2).get_col())
    if reach is not None:
        read |= set(reach.jac_sparsity(0, 1).get_col())
    owners = [variable.label for variable in loop.variables for _ in range(variable.symbol.numel())]
    return (tuple(rows), tuple(sorted(int(place) for place in read))), {owners[row] for row in rows}


def _started(claim: Claim | None, judged: SX, started: SX) -> SX:
    """Substitute the initial state into margins."""
    if claim is None:
        return judged
    names = stack(claim.starts[variable.label] for variable in claim.loop.variables)
    return ca.substitute(judged, names, started)


def _function(name: str, reads: Sequence[SX], gives: Sequence[SX]) -> Any:
    return ca.Function(name, list(reads), [ca.cse(ca.densify(given)) for given in gives])


def _pose(posed: Variable | None) -> SX:
    return ca.SX.sym("pose", 0) if posed is None else posed.symbol


def _posed(diagram: Diagram) -> Variable | None:
    """Plant state with the joint positions of the robot, else a plant state ``q``."""
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


def place_of(loop: ClosedLoop, variable: Variable) -> int:
    """Index of the first element of a state in the whole state."""
    labels = [other.label for other in loop.variables]
    return sum(other.symbol.numel() for other in loop.variables[: labels.index(variable.label)])


def _reach(diagram: Diagram, posed: Variable | None, start: Mapping[str, Any]) -> Any:
    loop, given = diagram.loop, {key for key in start if key != NEAR}
    if posed is None or given & {posed.label, posed.name}:
        return None
    for plain in loop.followed:
        pair = turned(diagram, plain, posed)
        wanted, found = (loop.joined([ca.vec(side)])[0] for side in (pair.wanted, pair.found))
        unknown = {v.label for v in loop.variables if ca.depends_on(found, ca.vec(v.symbol))}
        if unknown == {posed.label}:
            goal = ca.substitute(loop.on_path(wanted), loop.time, ca.SX(0))
            return _function("reach", [posed.symbol, loop.p], [found - goal, ca.jacobian(found, posed.symbol)])
    return None


def _margins(everything: Sequence[ParameterMargin]) -> tuple[SX, tuple[Place | None, ...]]:
    """Margins as one column, with the position of each."""
    column, places = ca.SX(0, 1), list[Place | None]()
    for item in everything:
        if item.margin is None:
            places.append(None)
            continue
        places.append((column.numel(), item.margin.numel()))
        column = ca.vertcat(column, item.margin)
    return column, tuple(places)


def _reads(
    loop: ClosedLoop, claim: Claim | None, everything: Sequence[ParameterMargin]
) -> tuple[tuple[int, ...] | None, ...]:
    """Elements of (p, initial state) on which requirements without margins depend."""
    starts = [] if claim is None else [claim.starts[variable.label] for variable in claim.loop.variables]
    column = ca.vertcat(loop.p, *starts)
    at = {column[k].element_hash(): k for k in range(column.numel())}
    return tuple(
        None if item.reads is None else tuple(at[symbol.element_hash()] for symbol in ca.symvar(item.reads))
        for item in everything
    )


def _terms(verdict: Verdict, least: SX | None) -> SX:
    """Terms of V, with kappa twice its least value, or one if the least value is zero."""
    claim = verdict.flow_claim
    assert claim is not None
    column = stack(claim.weight(part) * square.value / 2 for part in claim.parts for square in part.certificate.storage)
    return column if least is None else ca.substitute(column, claim.kappa, ca.if_else(least > 0, 2 * least, 1))
