"""Whether the proof's conditions hold over all that a study draws: decided exactly, over intervals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, final

import numpy as np

from dmframe.certify import Verdict, verify
from dmframe.certify.checked import Checked
from dmframe.errors import DmframeError
from dmframe.exact.rational import Interval
from dmframe.robot.rational import decimal

if TYPE_CHECKING:
    from dmframe.graph import Graph
    from dmframe.study.design import Spread
    from dmframe.study.varied import Factor

HELD: Final = 0.99
"""Probability of the box, where what is drawn has no ends."""
MOST: Final = 24
"""Grid points at which the proof is decided; it takes about a second each."""


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


def box_of(graph: Graph, factors: Sequence[Factor]) -> Box:
    """The box of what factors do to a graph's parameters.

    The ends are computed as the runs compute their values, and rounding never turns an order round: no run lies
    outside.
    """
    parameters = graph.diagram.loop.parameters
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
    """

    index: int
    name: str
    box: Box
    verdict: Verdict | None
    why: str = ""

    @property
    def proved(self) -> bool:
        """Every condition holds anywhere in the box."""
        return self.verdict is not None and self.verdict.outcome == "proved"

    @property
    def failing(self) -> tuple[Checked, ...]:
        """The conditions that do not hold everywhere in the box."""
        return () if self.verdict is None else tuple(item for item in self.verdict.conditions if not item.holds)


def proof_of(index: int, name: str, graph: Graph, factors: Sequence[Factor]) -> Proof:
    """Decide a graph's certificate over all that factors draw. A fault is told, not raised."""
    from dmframe.block.model import SYMBOLIC

    try:
        box = box_of(graph, factors)
        with SYMBOLIC:
            verdict = verify(graph.diagram, uncertain=box.intervals, start=graph.experiment.start)
    except DmframeError as error:
        return Proof(index, name, Box({}, {}, 1.0, ()), None, str(error))
    return Proof(index, name, box, verdict)
