r"""Estimated error of integration, and the method and steps that follow from an accuracy.

A run, or parts of a long run (`spans`), is integrated twice from the same states: with n steps in a tick, and with
N >= 2 n. With the joint positions q_n at all ticks, the error is estimated as

.. math::

    e_n = \frac{\max |q_n - q_N|}{1 - (n / N)^p}, \qquad p = \log_2 \tfrac32. \tag{1}

It is at least the error if twice the steps leave at most two thirds of it: corners of a friction law, of a projection
or of a contact reduce the order of a method, and (1) is cautious where they do not.

Where only parts are compared, (1) is multiplied by 1.5, since the largest error may be between them. A part may end
before errors have accumulated that no feedback removes: if the difference grows in the second half of every part, (1)
is multiplied by the length of the run over that of a part.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Final, final

import casadi as ca
import numpy as np

from dmframe.block.model import SYMBOLIC
from dmframe.common.errors import ValueFault
from dmframe.common.units import plain
from dmframe.diagram import Diagram, Variable
from dmframe.program.program import codes
from dmframe.simulate.engine import CHUNK, Choice, Compiled, Engine, Stuck, choose, work_of, worth
from dmframe.simulate.recording import Estimate, Recording
from dmframe.simulate.solver import FIXED, MOST_SUBSTEPS, Method
from dmframe.simulate.step import Step
from dmframe.simulate.stiffness import EXPLICIT_TAKES, omitted_terms

if TYPE_CHECKING:
    from dmframe.simulate.run import Prepared

_FINER: Final = 2
_ORDER: Final = float(np.log2(1.5))
"""N over n, or over the number of automatic steps if that is larger; and p of (1)."""

_PARTS: Final = 1.5
"""Further factor if less than the whole run is compared, whose largest error may be between the parts."""

_SHARE: Final = 0.3
_FEW: Final = (1.5e7, 2e9)
_MOST: Final = 3e9
"""Instructions of an estimate: a share of those of the run, but at least the first or the second number, for a run that
`worth` leaves to the interpreter or compiles, and at most the last one."""

_STARTS: Final = (0.0, 0.618, 0.236, 0.854)
"""Where the parts begin, as fractions of the run: irregular, since paths are periodic."""
_SHORTEST: Final = 1.0
"""Shortest part if there are several [s]."""
_WHOLE: Final = 0.7
"""Fraction of a run from which all of it is compared."""
_GROWTH: Final = 1.5
"""Ratio of the largest differences in the two halves of a part from which it grows; 2 for linear growth."""

_STEPS: Final = tuple(sorted({k * 10**e // 10 for e in range(3) for k in (10, 12, 15, 20, 25, 30, 40, 50, 60, 80)}))
"""Numbers of steps in a tick that are tried."""
_DOUBLINGS: Final = 4
"""Number of times that automatic steps are halved."""
_ROUNDING: Final = frozenset((ca.OP_FLOOR, ca.OP_CEIL))
"""Operations of an encoder."""
_NOTICEABLE: Final = 4
"""Multiple of the automatic number of steps that must halve the error; otherwise no number is taken to reduce it."""
_RUNS: Final = 3
"""Most runs, each with shorter steps after the estimate of the one before."""
_EXPENSIVE: Final = 5000
"""Instructions of the plant's rate above which no second method is compiled for a comparison."""


@final
@dataclass(frozen=True)
class Span:
    """Part of a run: first tick, number of ticks, and the state at its beginning."""

    first: int
    ticks: int
    state: np.ndarray


def spans(step: Step, ticks: int) -> list[tuple[int, int]]:
    """First tick and length of the parts of a run that are compared."""
    work, period = work_of(step), step.period
    affordable = min(max(_SHARE * ticks * work, _FEW[worth(step, ticks)]), _MOST) / ((1 + _FINER) * work)
    if affordable >= _WHOLE * ticks:
        return [(0, ticks)]
    count = min(len(_STARTS), max(1, int(affordable * period / _SHORTEST)))
    length = max(1, int(affordable / count))
    return sorted((int(start * (ticks - length)), length) for start in _STARTS[:count])


def joint_rows(diagram: Diagram) -> tuple[np.ndarray, list[str], str]:
    """Rows of the joint positions in the column of states, the labels of these states, and the unit.

    They are those of the robot; without a robot all states of the plant in rad or m.
    """
    moving = {variable.label for variable in diagram.loop.flowing}

    def robot(variable: Variable) -> bool:
        return diagram.blocks[variable.block].uses_robot and (variable.unit, variable.shape) == ("rad", "n")

    def position(variable: Variable) -> bool:
        return variable.unit in ("rad", "m")

    for chosen in (robot, position):
        rows, labels, units, first = list[int](), list[str](), list[str](), 0
        for variable in diagram.loop.variables:
            size = variable.symbol.numel()
            if variable.label in moving and chosen(variable):
                rows += range(first, first + size)
                labels.append(variable.label)
                units.append(variable.unit)
            first += size
        if rows:
            kinds = {} if diagram.robot is None else {joint.kind: None for joint in diagram.robot.joints}
            if chosen is robot and kinds:
                units = ["m" if kind == "prismatic" else "rad" for kind in kinds]
            return np.array(rows, dtype=np.int64), labels, ", ".join(sorted(set(units), reverse=True))
    return np.zeros(0, np.int64), [], ""


@final
@dataclass(frozen=True)
class Comparison:
    """Parts of a run, integrated with several methods and steps.

    Parameters
    ----------
    base
        The setup with automatic steps, whose method computes the references.
    engines
        Engine for a setup that records the joint positions at every tick.
    """

    base: Prepared
    spans: Sequence[Span]
    p: np.ndarray
    joints: int
    unit: str
    engines: Callable[[Prepared], Engine]
    paths: dict[tuple[Method, int], list[np.ndarray | None]] = field(default_factory=dict)

    def estimate(self, own: Prepared) -> Estimate:
        """Estimated error of a setup by (1); infinite if one of its runs diverged."""
        n, share = own.step.substeps, sum(span.ticks for span in self.spans) / own.ticks
        most = min(MOST_SUBSTEPS, _FINER * max(n, self.base.step.substeps))
        if most == n:
            return Estimate(np.inf, self.unit, 0.0)
        finest = _with_steps(self.base, self.base.solver.method, most)
        error, growth = 0.0, np.inf
        for found, reference in zip(self._path(own), self._path(finest), strict=True):
            if found is None or reference is None:
                return Estimate(np.inf, self.unit, share)
            apart = np.max(np.abs(found - reference), axis=1, initial=0.0)
            first, second = np.array_split(apart, 2)
            error = max(error, float(np.max(apart)))
            growth = min(growth, float(np.max(second, initial=0.0)) / max(float(np.max(first)), 1e-300))
        if growth > _GROWTH and share < 1:
            error *= own.ticks / self.spans[0].ticks
        factor = (1 if share == 1 else _PARTS) / (1 - (n / most) ** _ORDER)
        return Estimate(factor * error, self.unit, share)

    def _path(self, own: Prepared) -> list[np.ndarray | None]:
        key = own.solver.method, own.step.substeps
        if key not in self.paths:
            engine = self.engines(own)
            self.paths[key] = [_advanced(engine, span, self.p, self.joints) for span in self.spans]
        return self.paths[key]


def _advanced(engine: Engine, span: Span, p: np.ndarray, joints: int) -> np.ndarray | None:
    """(ticks + 1, joints): the positions in a part of a run; None if it diverges."""
    rows, state, done = np.empty((span.ticks + 1, joints)), span.state.copy(), 0
    while done < span.ticks:
        wanted = span.ticks - done if engine.elastic else min(CHUNK, span.ticks - done)
        try:
            reached = engine.advance(state, p, span.first + done, wanted, rows[done:])
        except Stuck:
            return None
        if reached < wanted:
            return None
        done += wanted
    engine.advance(state, p, span.first + done, 0, rows[done:])
    return rows


def _size(estimate: Estimate) -> str:
    return f"{estimate.error:.1g} {estimate.unit}" if np.isfinite(estimate.error) else "without limit"


def _with_steps(own: Prepared, method: Method, n: int) -> Prepared:
    """The setup with n steps of a method in a tick."""
    return own.solved_by(replace(own.solver, method=method, step=own.step.instants.longest / n))


@final
@dataclass(frozen=True)
class Pilot:
    """Runs of one loop from one state, whose method and steps follow from `Solver.accuracy`.

    Parameters
    ----------
    base
        The setup with automatic steps, or with the written ones.
    notices
        Notices of the setup before its steps were chosen.
    run
        Runs a setup; the state at each tick of the given dictionary is written to its array.
    """

    base: Prepared
    notices: tuple[str, ...]
    diagram: Diagram
    state: np.ndarray
    speed: float
    choice: Choice
    rows: np.ndarray
    labels: Sequence[str]
    unit: str
    run: Callable[[Prepared, dict[int, np.ndarray]], Recording]
    engines: dict[Method, Engine]

    @classmethod
    def of(
        cls,
        base: Prepared,
        notices: tuple[str, ...],
        diagram: Diagram,
        state: np.ndarray,
        speed: float,
        choice: Choice,
        engine: Engine,
        run: Callable[[Prepared, dict[int, np.ndarray]], Recording],
    ) -> Pilot | None:
        """The pilot of a run; None without an accuracy or an estimate."""
        if base.solver.accuracy is None or base.solver.method not in FIXED:
            return None
        rows, labels, unit = joint_rows(diagram)
        if rows.size:
            engines = {base.solver.method: engine}
            return cls(base, notices, diagram, state, speed, choice, rows, labels, unit, run, engines)
        if base.solver.free:
            raise ValueFault(
                "solver.accuracy: expected a plant with joint positions, states in rad or m, found none; set "
                "solver.step",
                path=("solver", "accuracy"),
            )
        return None

    def recording(self, *, written: bool) -> Recording:
        """The recording of a run that keeps the accuracy if its steps are not `written`, with its estimate.

        A run whose estimate exceeds the accuracy is repeated with shorter steps, if these keep it in the compared
        parts.
        """
        accuracy = self.base.solver.accuracy
        assert accuracy is not None  # see `of`
        own, before = self.base if written else self._first(accuracy), None
        for _ in range(_RUNS):
            found, compared = self._compared(own)
            if found.interrupted and before is not None:
                return replace(before, interrupted=True)
            if found.divergence is not None or found.interrupted or found.solver != own.solver:
                if own is self.base or found.interrupted:
                    return found
                own = self.base  # the pilot run did not reach the place of the divergence
                continue
            try:
                estimate = compared.estimate(own)
                found, better = replace(found, estimate=estimate), None
                if estimate.error > accuracy and not (written or self._rounds):
                    better = self._cheapest(compared, accuracy, work_of(own.step))
            except KeyboardInterrupt:
                return replace(found, interrupted=True)
            if better is None:
                return found if estimate.error <= accuracy else self._missed(found, estimate, accuracy, written=written)
            before, own = found, self._explained(better, own, estimate)
        return found

    def _explained(self, better: Prepared, own: Prepared, estimate: Estimate) -> Prepared:
        """A setup with the notice why it replaces the automatic one; none for a graph that states an accuracy."""
        if self.base.solver.free:
            return better
        found = _size(estimate)
        notice = (
            f"the estimated error of the joints at steps of {plain(own.step.length, 's')} is {found}: "
            f"{better.solver.method} takes steps of {plain(better.step.length, 's')}; set solver.accuracy for others"
        )
        return replace(better, notices=(*better.notices, notice))

    @property
    def _rounds(self) -> bool:
        """True without an accuracy in the graph if its law rounds, which turns any error into quanta."""
        return not self.base.solver.free and not _ROUNDING.isdisjoint(codes(self.base.step.parts.sample))

    def _missed(self, found: Recording, estimate: Estimate, accuracy: float, *, written: bool) -> Recording:
        """The recording with a notice that it misses the accuracy, if that was stated or steps were tried."""
        if not self.base.solver.free and (written or self._rounds):
            return found
        remedy = "set a shorter solver.step" if written else "shorter steps do not keep it, and are not taken"
        notice = (
            f"solver.accuracy: the estimated error of the joints, {_size(estimate)}, exceeds {accuracy:g}; {remedy}"
        )
        return replace(found, notices=(*found.notices, notice))

    def _first(self, accuracy: float) -> Prepared:
        """The setup of the first run: automatic, or the cheapest one that a pilot run from the start permits."""
        if not self.base.solver.free:
            return self.base
        ticks = spans(self.base.step, self.base.ticks)[0][1]
        compared = self._comparison([Span(0, ticks, self.state)])
        return self._cheapest(compared, accuracy, 0) or self.base

    def _compared(self, own: Prepared) -> tuple[Recording, Comparison]:
        """A run, and the comparison of its parts."""
        parts = spans(self.base.step, own.ticks)
        marks = {first: np.zeros_like(self.state) for first, _ in parts}
        found = self.run(own, marks)
        compared = self._comparison([Span(first, ticks, marks[first]) for first, ticks in parts])
        states = [found.states.get(label) for label in self.labels]
        recorded = [each for each in states if each is not None and len(each) == own.ticks + 1]
        if len(recorded) == len(self.labels):
            path = np.hstack(recorded)
            compared.paths[own.solver.method, own.step.substeps] = [path[k : k + ticks + 1] for k, ticks in parts]
        return found, compared

    def _comparison(self, parts: Sequence[Span]) -> Comparison:
        return Comparison(self.base, parts, self.diagram.loop.p_values, self.rows.size, self.unit, self._engine)

    def _cheapest(self, compared: Comparison, accuracy: float, above: int) -> Prepared | None:
        """The setup of fewest instructions, but more than `above`, that keeps the accuracy in a comparison."""
        with SYMBOLIC:
            setups = [own for own in self._setups() if work_of(own.step) > above]
        first = np.inf
        for own in setups:
            error = compared.estimate(own).error
            if error <= accuracy:
                return own
            steps = own.step.substeps // self.base.step.substeps
            first = error if steps == 1 else first
            if steps >= _NOTICEABLE and error > first / 2:  # chaos, or a quantiser: no step reduces the difference
                return None
        return None

    def _setups(self) -> list[Prepared]:
        """Setups by number of instructions: longer steps if they are free, the automatic one, and shorter ones."""
        base, n = self.base, self.base.step.substeps
        found = [base]
        for method in self._methods():
            for steps in _STEPS:
                own = self._other(method, steps)
                cheaper = work_of(own.step) < work_of(base.step)
                if cheaper and (method != "rk4" or own.step.length * self.speed <= base.solver.takes):
                    found.append(own)
        for k in range(1, _DOUBLINGS + 1):
            if _FINER * n * 2**k <= MOST_SUBSTEPS:
                found.append(self._other(base.solver.method, n * 2**k))
        return sorted(found, key=lambda own: work_of(own.step))

    def _other(self, method: Method, n: int) -> Prepared:
        return replace(_with_steps(self.base, method, n), notices=self.notices)

    def _methods(self) -> Iterator[Method]:
        """Methods for longer steps; a short run does not repay the compilation of a second one."""
        base = self.base
        for method in base.solver.free:
            own = method == base.solver.method
            if not own and (not worth(base.step, base.ticks) or base.step.parts.rate.n_instructions() > _EXPENSIVE):
                continue
            stiff = method == "rk4" and base.solver.method != "rk4"
            omits = method == "ros34pw2" and self._omits(_with_steps(base, method, 1))
            if not (stiff or omits):
                yield method

    def _omits(self, own: Prepared) -> bool:
        return omitted_terms(own.step, self.state, self.diagram.loop.p_values) > EXPLICIT_TAKES

    def _engine(self, own: Prepared) -> Engine:
        """Engine that records the joint positions at every tick."""
        method = own.solver.method
        with SYMBOLIC:
            if method not in self.engines:
                self.engines[method] = own.engine(self.choice)
            engine = self.engines[method]
            if isinstance(engine, Compiled):
                return replace(engine, step=own.step, kept=self.rows, every=1)
            return choose("interpreted", own.step, own.solver, 1, self.rows, own.ticks)
