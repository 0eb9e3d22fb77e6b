"""V along a run: the same expressions that were proved, evaluated at what was simulated.

The true parameters in V are those of the plant as wired, and the states are those that the run kept. A source that
steps, such as a load, makes V jump while no state moves: each such jump is computed and kept apart from what the loop
does.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache, cached_property
from typing import Any, final

import casadi as ca
import numpy as np

from dmframe.certify.assumed import assumed_positive
from dmframe.certify.checked import Numbers
from dmframe.certify.claim import Claim, total
from dmframe.certify.climb import Climb, climb_of
from dmframe.diagram.closed_loop import stack
from dmframe.errors import ValueFault
from dmframe.simulate import Recording

CHUNK = 2048
"""Samples evaluated in one call."""

LOOKED_AT = 128
"""Instants at which the rounding error of V is bounded; between two of them the larger bound is taken."""


def _none() -> np.ndarray:
    return np.zeros(0)


@final
@dataclass(frozen=True)
class TermAlong:
    r"""One term of V: :math:`\tfrac12 \kappa |a|_W^2` of `block`, or without kappa for a cascade; (N,) values.

    `of` is a in the code's names, and `drawn` the same for a drawing.
    """

    block: str
    of: str
    values: np.ndarray
    drawn: str = ""


@final
@dataclass(frozen=True)
class Jump:
    """A step of V at `time` [s], by which a source that steps changes it while every state stays."""

    time: float
    change: float


@final
@dataclass(frozen=True)
class Along:
    """V and its terms at every sample of a run.

    Parameters
    ----------
    time
        (N,) [s].
    kappa
        The weight of the servo level.
    dissipation
        (N,) The dissipated squares, each with its weight; empty where they were not evaluated.
    rate
        (N,) dV/dt as the claim states it, of continuous time, at the same states; empty where it was not evaluated.
    rounding
        (N,) How far V may be wrong by rounding; empty for exact numbers.
    jumps
        What sources that step add to V at their steps.
    crossings
        Sentences on what the claim assumes and this run does not have: weights above zero, constants inside their box.
    residual
        (N,) What a claim over samples lets V gain from each sample to the next; empty where it was not evaluated.
    constants
        Unknown constants in V with the values that the run determines, by label ``block.name``.
    about
        Which constants these are, in words.
    """

    time: np.ndarray
    kappa: float
    V: np.ndarray
    terms: tuple[TermAlong, ...]
    dissipation: np.ndarray = field(default_factory=_none)
    rate: np.ndarray = field(default_factory=_none)
    rounding: np.ndarray = field(default_factory=_none)
    jumps: tuple[Jump, ...] = ()
    crossings: tuple[str, ...] = ()
    residual: np.ndarray = field(default_factory=_none)
    constants: Mapping[str, np.ndarray] = field(default_factory=dict)
    about: str = ""

    @cached_property
    def climb(self) -> Climb:
        """How far V rose between its jumps, beyond what rounding explains."""
        jumped = np.zeros_like(self.V)
        for jump in self.jumps:
            jumped[self.time >= jump.time] += jump.change
        return climb_of(self.time, self.V - jumped, self.rounding)

    @property
    def steps(self) -> np.ndarray:
        """(N - 1,) V at each sample minus V at the one before."""
        with np.errstate(over="ignore", invalid="ignore"):  # the last samples of a run that diverged
            return np.diff(self.V)

    @property
    def beyond(self) -> int:
        """From how many samples to the next V rises by more than its claim over samples allows, and than rounding."""
        if not self.residual.size:
            return 0
        allowed = self.residual[:-1] + self.rounding[:-1] + self.rounding[1:]
        return int(np.count_nonzero(self.steps > allowed))

    @property
    def largest_increase(self) -> float:
        """The most that V rises from one sample to the next; 0 where it never rises."""
        return float(max(0.0, np.max(self.steps, initial=0.0)))

    @property
    def increase_at(self) -> float | None:
        """When the largest increase begins [s]; None where V never rises."""
        steps = self.steps
        return float(self.time[int(np.argmax(steps))]) if steps.size and np.max(steps) > 0 else None

    @property
    def rises(self) -> int:
        """From how many samples to the next V rises."""
        return int(np.count_nonzero(self.steps > 0))


def along(claim: Claim, run: Recording, kappa: float = 1.0) -> Along:
    r"""Evaluate :math:`V = \kappa (S_1 + S_2 + \dots) + S_{cascade}` along a run.

    Parameters
    ----------
    claim
        Of the diagram that was run, or of one of the same blocks and parameters' sizes.
    kappa
        Above the least value of the small-gain condition (`Verdict.kappa`); without a cascade it has no effect.

    Raises
    ------
    ValueFault
        A run whose states are not those of the claim.
    """
    _check_same(claim, run)
    stored = [
        (part, square, law)
        for part in claim.parts
        for square, law in zip(part.certificate.storage, claim.laws[part.block].storage, strict=True)
    ]
    with np.errstate(over="ignore", invalid="ignore"):
        own = _Evaluated(claim, run, kappa)
        rows = own.of([claim.weight(part) * square.value / 2 for part, square, _ in stored])
        V = np.sum(rows, axis=0) if len(rows) else np.zeros(run.time.size)
        dissipation, rate = own.rates()
    terms = tuple(
        TermAlong(part.block, square.of, row, law.vector.unicode)
        for (part, square, law), row in zip(stored, rows, strict=True)
    )
    crossings = tuple(_crossings(claim, run, own))
    return Along(run.time, kappa, V, terms, dissipation, rate, own.rounding(), own.jumps(), crossings)


def _crossings(claim: Claim, run: Recording, own: _Evaluated) -> Iterator[str]:
    """Where along the run a weight is not above zero that the claim assumes to be."""
    for item in assumed_positive(claim, Numbers(claim, {})):
        least = np.min(own.of(claim.loop.projected([item.column])), axis=0)
        wrong = np.flatnonzero(~(least > 0))
        if wrong.size:
            first = int(wrong[0])
            yield (
                f"{item.text} is {least[first]:.3g} at t = {run.time[first]:.6g} s; the proof assumes that it stays "
                "above a positive constant, and does not apply from there on"
            )


def _check_same(claim: Claim, run: Recording) -> None:
    """The run has the states and parameters of the claim, each of its size."""
    variables = claim.loop.variables
    wanted = {variable.label: variable.symbol.numel() for variable in variables}
    wanted |= {parameter.label: parameter.symbol.numel() for parameter in claim.loop.parameters}
    found = {label: rows.shape[1] for label, rows in run.states.items()}
    found |= {parameter.label: parameter.symbol.numel() for parameter in run.diagram.loop.parameters}
    for label in dict.fromkeys((*wanted, *found)):
        if wanted.get(label) != found.get(label):
            here, there = (f"{sizes[label]} of" if label in sizes else "no" for sizes in (wanted, found))
            raise ValueFault(
                f"V along a run: expected a run of the claim's own blocks, with {here} {label}, found {there}"
            )


@final
class _Evaluated:
    """Expressions of a claim at the instants of a run."""

    def __init__(self, claim: Claim, run: Recording, kappa: float) -> None:
        self.claim, self.run, self.kappa = claim, run, kappa
        self._rows = np.hstack([run.states[variable.label] for variable in claim.loop.variables])

    def of(self, expressions: list[Any]) -> np.ndarray:
        """(expressions, N), with the trajectories as the functions of time that they are."""
        loop = self.claim.loop
        return self._mapped(loop.on_path(self._weighed(stack(expressions))), np.arange(self.run.time.size))

    def rates(self) -> tuple[np.ndarray, np.ndarray]:
        """The dissipation, and dV/dt as claimed; empty where a derivative enters that this loop does not take.

        By the claim's identity this is dV/dt in continuous time, and much cheaper than its derivative.
        """
        claim, loop = self.claim, self.claim.loop
        spent = total([claim.weight(part) * part.dissipation for part in claim.parts])
        left = total([claim.weight(part) * (part.excess + part.lemma) for part in claim.parts]) + claim.consumption
        column = loop.on_path(loop.projected([self._weighed(stack([spent, left - spent]))])[0])
        known = stack([loop.state, loop.time, loop.p])
        if ca.Function("rates", [known], [column], {"allow_free": True}).has_free():
            return _none(), _none()
        spent_rows, rate = self._mapped(column, np.arange(self.run.time.size))
        return spent_rows, rate

    def rounding(self) -> np.ndarray:
        """How far V may be wrong by rounding, to first order.

        Each of its n operations and each of the numbers that it reads is rounded by a share eps, and what a number adds
        is |dV/dz| |z|: the difference of two near numbers is as uncertain as the numbers are. So the bound is
        n eps (V + sum |dV/dz| |z|), z the states.
        """
        loop, count = self.claim.loop, self.run.time.size
        V = loop.on_path(self._weighed(self.claim.V))
        read = ca.dot(ca.fabs(ca.gradient(V, loop.state)), ca.fabs(loop.state))
        operations = ca.Function("V", [loop.state, loop.time, loop.p], [ca.cse(V)]).n_instructions()
        looked = np.unique(np.linspace(0, count - 1, min(LOOKED_AT, count)).astype(int))
        with np.errstate(over="ignore", invalid="ignore"):
            (size,) = self._mapped(ca.fabs(V) + read, looked)
        bound = operations * np.finfo(float).eps * size
        after = np.minimum(np.searchsorted(looked, np.arange(count)), len(looked) - 1)
        found: np.ndarray = np.maximum(bound[after], bound[np.maximum(after - 1, 0)])
        return found

    def jumps(self) -> tuple[Jump, ...]:
        """What each step of a source adds to V at the first kept instant that has it, with the states of that instant.

        Exact for a step at a kept instant; of one between two, the states of the later one are taken.
        """
        loop, resolver = self.claim.loop, self.claim.diagram.resolver
        stepping = [leaf for (block, port, _), leaf in resolver.trajectories.items() if resolver.steps(block, port)]
        if not stepping:
            return ()
        held, moves = stack(leaf.symbol for leaf in stepping), stack(leaf.expression for leaf in stepping)
        values = self._mapped(loop.on_path(moves), np.arange(self.run.time.size))
        places = np.flatnonzero(np.any(np.diff(values, axis=1) != 0, axis=0)) + 1
        if not places.size:
            return ()
        kept = ca.SX.sym("kept", held.numel())
        V = loop.on_path(ca.substitute([self._weighed(self.claim.V)], [held], [kept])[0])
        before, after = (self._mapped(V, places, (kept, values[:, places - back])) for back in (1, 0))
        return tuple(
            Jump(float(self.run.time[place]), float(change))
            for place, change in zip(places, (after - before).ravel(), strict=True)
        )

    def _weighed(self, expression: Any) -> Any:
        kappa = self.claim.kappa
        return expression if kappa.is_constant() else ca.substitute(expression, kappa, self.kappa)

    def _mapped(self, column: Any, places: np.ndarray, *more: tuple[Any, np.ndarray]) -> np.ndarray:
        """A column of expressions at some instants, with the run's own parameters; `more` are further inputs."""
        loop, count = self.claim.loop, places.size
        fixed = ca.substitute(ca.cse(column), loop.p, ca.DM(self.run.diagram.loop.p_values))
        inputs = [loop.state, loop.time, *(symbol for symbol, _ in more)]
        function = ca.Function("terms", inputs, [ca.densify(ca.cse(fixed))])
        values, mapped = np.empty((count, column.numel())), cache(function.map)
        at = [self._rows[places], self.run.time[places], *(np.ascontiguousarray(numbers.T) for _, numbers in more)]
        for first in range(0, count, CHUNK):
            part = slice(first, min(first + CHUNK, count))
            buffer, evaluate = mapped(part.stop - first).buffer()
            for place, rows in enumerate(at):  # no array is converted, which takes as long as the evaluation
                buffer.set_arg(place, rows[part].data)
            buffer.set_res(0, values[part].data)
            evaluate()
        return np.ascontiguousarray(values.T)
