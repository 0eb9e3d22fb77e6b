"""What a page evaluates beside the run itself: where it starts, what is drawn of it, and whether the proof holds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass
from typing import Any, final

import casadi as ca
import numpy as np

from dmframe.certificate import SX
from dmframe.certify import Verdict
from dmframe.certify.checked import Checked
from dmframe.certify.claim import Claim
from dmframe.certify.elsewhere import Elsewhere, Intervals, elsewhere, least_kappa
from dmframe.certify.true_values import estimated
from dmframe.diagram import ClosedLoop, Diagram, Variable
from dmframe.diagram.closed_loop import stack
from dmframe.diagram.parts import Parts
from dmframe.results.metrics import TurnError, goal_of, turn_of
from dmframe.robot.frames import frames, tool
from dmframe.simulate.keep import apart_of
from dmframe.simulate.start import NEAR, turned
from dmframe.simulate.start_expressions import symbolic_start
from dmframe.simulate.step import build_parts


@final
@dataclass(frozen=True)
class Group:
    """Curves that share a plot: rows of `shown`, or of the state.

    Parameters
    ----------
    kind
        ``error``, ``turn``, of a tool from its orientation, ``storage``, ``command``, or ``estimate``.
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


Place = tuple[int, int]
"""First and count."""


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
    shown
        (state, t, T, p) -> what is drawn of an instant: `scene`, then the groups.
    judged
        (pose, T, p) -> the margins of `conditions`, the least kappa, and the true values of estimates: conditions may
        depend on where the states start, and there a start is taken as it is said to be, inside of its box or not.
    starts
        The rows of the state whose starts the pose or p decides, and the elements of p that decide any of them.
    scene
        How many numbers of `shown` place the robot: 12 a joint, then 3 of the tool.
    margins
        For each condition where its margins stand in `judged`, first and count; None for one that is not judged.
    tacit
        The same of what is no condition of the verdict and may fail at other numbers, with its place.
    reads
        For each condition, and then for what is tacit, the elements of (p, state at the start) on which it depends;
        None where it is judged, or depends on what is not known.
    operations
        Of the computation of V; 0 where V is not drawn.
    kappa
        Where the least kappa stands; None without a cascade.
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
    tacit: tuple[tuple[Elsewhere, Place | None], ...]
    reads: tuple[tuple[int, ...] | None, ...]
    kappa: int | None
    starts: tuple[tuple[int, ...], tuple[int, ...]] = ((), ())
    operations: int = 0

    @property
    def exported(self) -> tuple[Any, ...]:
        """Those that stand beside the run."""
        return tuple(f for f in (self.begin, self.reach, self.shown, self.judged) if f is not None)

    def heeded(self, moved: Set[int], values: np.ndarray) -> set[int]:
        """The elements of p, among those that are `moved`, on which anything depends that a reader sees.

        All others stay what they are in `values`: with no Coulomb friction, say, nothing depends on where it sets in.
        """
        found, parts = set[int](), self.parts
        for function in (parts.trajectory, parts.sample, parts.rate, parts.clip, *self.exported):
            *given, p = (ca.SX.sym("given", function.size_in(i)) for i in range(function.n_in()))
            kept = ca.vertcat(*(p[k] if k in moved else ca.SX(float(values[k])) for k in range(p.numel())))
            seen = ca.vertcat(*map(ca.vec, function.call([*given, kept])))
            if function is self.judged:  # a number that has to be positive, and no more, is so at every factor
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
    """All of them for one diagram; V is drawn where it is proved. `uncertain` is what `verify` had."""
    loop, posed, followed = diagram.loop, _posed(diagram), goal_of(diagram.loop)
    units = {signal.label: signal.unit for signal in loop.outputs}
    claim = verdict.claim if verdict.samples is None else verdict.samples.base
    said, begun = symbolic_start(diagram, start, posed)
    known, reach = [_pose(posed), loop.period, loop.p], _reach(diagram, posed, start)
    starts, labels = _starts(loop, _function("said", known, [said]), reach)
    everything = elsewhere(verdict.conditions, claim, uncertain or {}, labels)
    judged, places = _margins(everything)
    count, kappa, least = len(verdict.conditions), None, None
    if verdict.outcome == "proved" and verdict.claim is not None and verdict.claim.cascaded:
        kappa, least = judged.numel(), least_kappa(verdict.claim, uncertain or {})
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
    turn, apart = turn_of(loop), apart_of(loop)
    if turn is not None and apart is not None:
        groups.append(add("turn", apart, TurnError.unit, turn))
    operations = 0
    if verdict.outcome == "proved" and verdict.claim is not None:
        stored = _terms(verdict, least)
        operations = _function(
            "V", [loop.state, loop.time, loop.p], [loop.on_path(loop.acting([stored])[0])]
        ).n_instructions()
        groups.append(add("storage", "", "", stored))
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
    shown = loop.on_path(loop.acting([stack([scene, *drawn])])[0])
    return Functions(
        parts=build_parts(loop, clock, ca.SX(0, 1)),
        posed=posed,
        begin=_function("begin", known, [begun]),
        reach=reach,
        shown=_function("shown", reads, [ca.substitute(shown, loop.drawn, ca.SX.zeros(loop.drawn.numel()))]),
        judged=_function("judged", known, [_started(claim, judged, said)]),
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


def _starts(loop: ClosedLoop, said: Any, reach: Any) -> tuple[tuple[tuple[int, ...], tuple[int, ...]], set[str]]:
    """See `Functions.starts`; and the labels of the states that these rows are of."""
    patterns = [np.asarray(said.jac_sparsity(0, i).row()) for i in (0, 2)]
    rows = sorted({int(row) for pattern in patterns for row in pattern})
    read = set(said.jac_sparsity(0, 2).get_col())
    if reach is not None:
        read |= set(reach.jac_sparsity(0, 1).get_col())
    owners = [variable.label for variable in loop.variables for _ in range(variable.symbol.numel())]
    return (tuple(rows), tuple(sorted(int(place) for place in read))), {owners[row] for row in rows}


def _started(claim: Claim | None, judged: SX, said: SX) -> SX:
    """Margins with what is said of the start in the place of the symbols of starts."""
    if claim is None:
        return judged
    names = stack(claim.starts[variable.label] for variable in claim.loop.variables)
    return ca.substitute(judged, names, said)


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


def place_of(loop: ClosedLoop, variable: Variable) -> int:
    """Where a state begins in the column of all."""
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


def _margins(everything: Sequence[Elsewhere]) -> tuple[SX, tuple[Place | None, ...]]:
    """All margins as one column, and where each one's stand."""
    column, places = ca.SX(0, 1), list[Place | None]()
    for item in everything:
        if item.margin is None:
            places.append(None)
            continue
        places.append((column.numel(), item.margin.numel()))
        column = ca.vertcat(column, item.margin)
    return column, tuple(places)


def _reads(
    loop: ClosedLoop, claim: Claim | None, everything: Sequence[Elsewhere]
) -> tuple[tuple[int, ...] | None, ...]:
    """On which elements of (p, state at the start) each depends that has no margin."""
    starts = [] if claim is None else [claim.starts[variable.label] for variable in claim.loop.variables]
    column = ca.vertcat(loop.p, *starts)
    at = {column[k].element_hash(): k for k in range(column.numel())}
    return tuple(
        None if item.reads is None else tuple(at[symbol.element_hash()] for symbol in ca.symvar(item.reads))
        for item in everything
    )


def _terms(verdict: Verdict, least: SX | None) -> SX:
    """The terms of V, with kappa as `payment` chooses it: twice the least, or one where nothing has to be paid."""
    claim = verdict.claim
    assert claim is not None
    column = stack(claim.weight(part) * square.value / 2 for part in claim.parts for square in part.certificate.storage)
    return column if least is None else ca.substitute(column, claim.kappa, ca.if_else(least > 0, 2 * least, 1))
