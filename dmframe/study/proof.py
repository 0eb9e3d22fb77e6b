"""Whether the proof's conditions hold over all that a study draws: decided exactly, over intervals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, final

import casadi as ca
import numpy as np

from dmframe.block.model import SYMBOLIC
from dmframe.certify import Verdict, verify
from dmframe.certify.checked import Checked
from dmframe.certify.elsewhere import elsewhere
from dmframe.diagram import Diagram
from dmframe.diagram.closed_loop import stack
from dmframe.diagram.values import with_values
from dmframe.errors import DmframeError
from dmframe.exact.rational import Interval
from dmframe.robot.rational import decimal
from dmframe.study.design import Spread
from dmframe.study.plan import Study
from dmframe.study.table import Loops
from dmframe.study.varied import Factor

HELD: Final = 0.99
"""Probability of the box, where what is drawn has no ends."""
MOST: Final = 12
"""Grid points at which the proof is decided; it takes about two seconds each."""
LOOKED: Final = 20_000
"""Samples of which each is looked at by itself, where the proof does not hold over the whole box."""


@final
@dataclass(frozen=True, eq=False)
class Box:
    """All values that parameters take in a study.

    Parameters
    ----------
    ends
        By ``block.parameter`` its lower and its upper ends, in the parameter's shape.
    held
        The probability that a sample lies in it; 1 where everything that is drawn has ends.
    units
        Of the parameters.
    outside
        Columns that are drawn and are no parameter of the loop: a clock, a start.
    """

    ends: Mapping[str, tuple[np.ndarray, np.ndarray]]
    units: Mapping[str, str]
    held: float
    outside: tuple[str, ...]

    @property
    def intervals(self) -> dict[str, list[Interval]]:
        """As `dmframe.certify.verify` takes them: exact, of the decimals that a graph would state."""
        return {
            label: [Interval(decimal(float(a)), decimal(float(b))) for a, b in zip(*map(_column, ends), strict=True)]
            for label, ends in self.ends.items()
        }


def _column(values: np.ndarray) -> np.ndarray:
    return values.ravel(order="F")


def box_of(diagram: Diagram, factors: Sequence[Factor]) -> Box:
    """The box of what factors do to a loop's parameters.

    The ends are computed as the runs compute their values, and rounding never turns an order round: no run lies
    outside.
    """
    parameters = diagram.loop.parameters
    own = {parameter.label: np.asarray(parameter.value, dtype=float) for parameter in parameters}
    ends, outside = dict[str, tuple[np.ndarray, np.ndarray]](), list[str]()
    drawn = [(factor, factor.spread) for factor in factors if factor.spread is not None]
    endless = sum(len(factor.columns) for factor, spread in drawn if not _has_ends(spread))
    # draws are independent, so that the probabilities of boxes multiply
    each = HELD ** (1 / endless) if endless else 1.0
    for factor, spread in drawn:
        low, high = _reach(spread, each)
        for label in factor.labels:
            if label not in own:
                outside += factor.columns
                continue
            below, above = ends.get(label, (own[label], own[label]))
            if factor.how == "scale":
                products = np.stack([low * below, low * above, high * below, high * above])
                ends[label] = products.min(axis=0), products.max(axis=0)
            elif factor.how == "shift":
                ends[label] = below + low, above + high
            else:
                ends[label] = np.full_like(own[label], low), np.full_like(own[label], high)
    units = {parameter.label: parameter.unit for parameter in parameters if parameter.label in ends}
    return Box(ends, units, HELD if endless else 1.0, tuple(dict.fromkeys(outside)))


def _has_ends(spread: Spread) -> bool:
    return bool(np.isfinite(spread.lower) and np.isfinite(spread.upper))


def _reach(spread: Spread, probability: float) -> tuple[float, float]:
    """The ends of a distribution; of one without, those between which so much of it lies, as much beyond each."""
    if _has_ends(spread):
        return spread.lower, spread.upper
    low, high = spread.at(np.array([(1 - probability) / 2, (1 + probability) / 2])).tolist()
    return low, high


@final
@dataclass(frozen=True, eq=False)
class Proof:
    """What the proof says of one grid point, over a box.

    Parameters
    ----------
    verdict
        None where the point could not be built; `why` says the reason.
    drawn
        (n,) bool, where the box as a whole is not proved: which of the first n samples fulfil every condition by
        themselves; None where that is not known.
    """

    index: int
    name: str
    box: Box
    verdict: Verdict | None
    why: str = ""
    drawn: np.ndarray | None = None

    @property
    def proved(self) -> bool:
        """Every condition holds anywhere in the box."""
        return self.verdict is not None and self.verdict.outcome == "proved"

    @property
    def failing(self) -> tuple[Checked, ...]:
        """The conditions that do not hold everywhere in the box."""
        return () if self.verdict is None else tuple(item for item in self.verdict.conditions if not item.holds)


def proofs_of(study: Study, names: Sequence[str]) -> list[Proof]:
    """Decide the certificates of a study's first grid points over all that it draws. A fault is told, not raised."""
    loops, found = Loops(), list[Proof]()
    for point in study.points[:MOST]:
        name = names[point.index]
        try:
            experiment = point.graph.experiment
            diagram, numbers = loops.of(experiment)
            diagram = with_values(diagram, numbers) if numbers else diagram
            found.append(_proof(study, point.index, name, diagram, experiment.start))
        except DmframeError as error:
            found.append(Proof(point.index, name, Box({}, {}, 1.0, ()), None, str(error)))
    return found


def _proof(study: Study, index: int, name: str, diagram: Diagram, start: Mapping[str, Any]) -> Proof:
    box = box_of(diagram, study.factors)
    with SYMBOLIC:
        verdict = verify(diagram, uncertain=box.intervals, start=start)
    drawn = None
    if verdict.outcome == "not_applicable" and study.samples > 1:
        count = min(study.samples, LOOKED)
        drawn = held_at(diagram, start, study.values(index, 0, count), count)
    return Proof(index, name, box, verdict, drawn=drawn)


def held_at(
    diagram: Diagram, start: Mapping[str, Any], values: Mapping[str, np.ndarray], count: int
) -> np.ndarray | None:
    """Which of `count` samples fulfil every condition of the proof, each at its own numbers, in floating point.

    Parameters
    ----------
    values
        Rows by ``block.parameter``, as `Study.values` has them.

    Returns
    -------
    (count,) bool
        None where some condition cannot be had as a margin, or the claim is not proved but for its conditions.
    """
    with SYMBOLIC:
        verdict = verify(diagram, start=start)
        claim = verdict.claim
        if claim is None or verdict.test is None or not verdict.test.zero or not verdict.conditions:
            return None
        everything = elsewhere(verdict.conditions, claim, {})
        loop, shapes = claim.loop, {item.label: item.value.shape for item in claim.loop.parameters}
        rows = {label: _rows(column, shapes[label], count) for label, column in values.items() if label in shapes}
        moved = stack([item.symbol for item in loop.parameters if item.label in rows])
        margins = ca.SX(0, 1)
        strict, holds = list[bool](), True
        for item in everything:
            if item.margin is None:
                if item.reads is not None and ca.depends_on(item.reads, moved):
                    return None
                holds = holds and item.checked.holds
                continue
            margins = ca.vertcat(margins, ca.vec(item.margin))
            strict += [item.checked.strict] * item.margin.numel()
        function = ca.Function("margins", [loop.p], [margins])
    fixed = {item.label: item.value.ravel(order="F")[:, None] for item in loop.parameters}
    column = np.vstack([rows[label] if label in rows else np.repeat(fixed[label], count, axis=1) for label in fixed])
    found = np.array(function(column)).reshape(len(strict), count)
    above = np.where(np.array(strict)[:, None], found > 0, found >= 0)
    return np.asarray(above.all(axis=0) & holds)


def _rows(values: np.ndarray, shape: tuple[int, ...], count: int) -> np.ndarray:
    """(elements, count): each sample's parameter, column by column; one number stands for all elements."""
    if values.ndim == 1:
        values = values.reshape(count, *(1 for _ in shape))
    full = np.broadcast_to(values, (count, *shape))
    return np.stack([each.ravel(order="F") for each in full], axis=1) if count else np.zeros((0, 0))
