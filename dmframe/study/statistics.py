"""What many runs say: shares, quantiles, comparisons and influences, with intervals only where they are valid.

A run that diverged has no figure; in all that follows its figure is infinite, so that it is worse than every run that
came to its end, and no quantile forgets it. Intervals are exact or distribution-free, and hold for independent draws
alone: of a design that spreads its points (Sobol, Latin hypercube) estimates are given without any.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, final

import numpy as np
from scipy import stats

LEVEL: Final = 0.95
"""Of every interval."""

FEWEST: Final = 16
"""Runs below which nothing is said of influences: there are two bins of eight at least."""

BINS: Final = 16
"""Into which a factor's draws are cut for its influence, each with as many runs."""


@final
@dataclass(frozen=True)
class Share:
    """How many of some runs did something.

    Parameters
    ----------
    low, high
        Ends of the two-sided interval for the probability; None where the design gives none.
    most
        The one-sided upper limit, which is what "at most" means; None as above. It is a statement of its own: to print
        it for no case at all, and the two-sided interval otherwise, would hold less often than it says.
    """

    count: int
    runs: int
    low: float | None = None
    high: float | None = None
    most: float | None = None

    @property
    def value(self) -> float:
        """The share itself; nan of no runs."""
        return self.count / self.runs if self.runs else float("nan")


def share(happened: np.ndarray, *, independent: bool, level: float = LEVEL, together: int = 1) -> Share:
    r"""The share of True, with the exact binomial interval of Clopper and Pearson.

    With k of n, the upper end p of the two-sided interval solves :math:`P(B(n, p) \le k) = (1 - level) / 2`, and the
    one-sided limit the same with :math:`1 - level`.

    Parameters
    ----------
    happened : (N,) bool
    independent
        The runs are independent draws; without it there is no interval.
    together
        So many shares hold at the level all at once (Bonferroni).

    References
    ----------
    Clopper, Pearson: The use of confidence or fiducial limits illustrated in the case of the binomial. Biometrika 26,
    1934.
    """
    count, runs = int(np.count_nonzero(happened)), len(happened)
    if not independent or runs == 0:
        return Share(count, runs)
    miss = (1 - level) / together
    low, high = (_limit(count, runs, miss / 2, upper=upper) for upper in (False, True))
    return Share(count, runs, low, high, _limit(count, runs, miss, upper=True))


def _limit(count: int, runs: int, miss: float, *, upper: bool) -> float:
    """One end of the binomial's exact interval, as a quantile of the beta distribution."""
    if upper:
        return 1.0 if count == runs else float(stats.beta.ppf(1 - miss, count + 1, runs - count))
    return 0.0 if count == 0 else float(stats.beta.ppf(miss, count, runs - count + 1))


@final
@dataclass(frozen=True)
class Quantile:
    """A quantile of a figure; infinite where it lies among the runs that diverged.

    `low` and `high` are the ends of its interval: None where the design gives none, infinite where the runs are too few
    for that end.
    """

    p: float
    value: float
    low: float | None = None
    high: float | None = None


def quantile(values: np.ndarray, p: float, *, independent: bool, level: float = LEVEL) -> Quantile:
    r"""A quantile with its distribution-free interval: two of the values in their order.

    Of N independent draws the number not above the quantile is :math:`B \sim B(N, p)`, so that the l-th value is above
    it with the probability :math:`P(B < l)`, and the u-th below it with :math:`P(B \ge u)`; each is at most half of
    what is left beside the level.

    Parameters
    ----------
    values : (N,)
        Infinite for a run that diverged.
    """
    count = len(values)
    if count == 0:
        return Quantile(p, float("nan"))
    ordered = np.sort(values)
    value = float(np.quantile(ordered, p, method="inverted_cdf"))
    if not independent:
        return Quantile(p, value)
    miss = (1 - level) / 2
    # P(B <= l - 1) <= miss for the largest l; P(B <= u - 1) >= 1 - miss for the least u
    below = stats.binom.cdf(np.arange(count + 1), count, p)
    lower = int(np.searchsorted(below, miss, side="right"))
    upper = int(np.searchsorted(below, 1 - miss, side="left")) + 1
    low = float(ordered[lower - 1]) if lower >= 1 else -np.inf
    high = float(ordered[upper - 1]) if upper <= count else np.inf
    return Quantile(p, value, low, high)


@final
@dataclass(frozen=True)
class Paired:
    """Two grid points on the same samples; the second against the first.

    Parameters
    ----------
    better, worse, alike
        Samples on which the second has the smaller, the greater, or the same figure.
    difference
        The median of second minus first, with its interval.
    ratio
        The median of second over first.
    p
        Of the sign test, two-sided: how likely so uneven a split is where neither is better; None for no random draws.
    """

    better: int
    worse: int
    alike: int
    difference: Quantile
    ratio: float
    p: float | None

    @property
    def runs(self) -> int:
        """Samples that both have."""
        return self.better + self.worse + self.alike


def paired(first: np.ndarray, second: np.ndarray, *, independent: bool, level: float = LEVEL) -> Paired:
    """Compare figures sample by sample, by their signs alone.

    Nothing is assumed of how the differences are distributed, so that a run that diverged can take part: it is worse
    than any that did not, and of two that diverged none is. (Wilcoxon's test would ask for symmetric differences.)

    Parameters
    ----------
    first, second : (N,)
        Infinite for a run that diverged; samples where either is nan, as it could not be run, are left out.
    """
    there = ~(np.isnan(first) | np.isnan(second))
    first, second = first[there], second[there]
    with np.errstate(invalid="ignore", divide="ignore"):
        both = np.isinf(first) & np.isinf(second)
        difference = np.where(both, 0.0, second - first)
        ratio = np.where(both | (first == second), 1.0, second / first)
    better, worse = int((difference < 0).sum()), int((difference > 0).sum())
    p = stats.binomtest(better, better + worse).pvalue if better + worse else 1.0
    return Paired(
        better,
        worse,
        len(difference) - better - worse,
        quantile(difference, 0.5, independent=independent, level=level),
        quantile(ratio, 0.5, independent=False).value,
        float(p) if independent else None,
    )


def adjusted(ps: Sequence[float]) -> list[float]:
    """Probabilities of several tests such that all hold at once (Holm 1979), in their order."""
    order, found, most = np.argsort(ps), [0.0] * len(ps), 0.0
    for place, index in enumerate(order.tolist()):
        most = max(most, min(1.0, (len(ps) - place) * ps[index]))
        found[index] = most
    return found


@final
@dataclass(frozen=True)
class Influence:
    """How much of a figure's variation one factor alone explains.

    Parameters
    ----------
    share
        Of the variance of the figure's ranks, from 0 to 1.
    p
        How likely so large a share is where the factor has no influence; None for no random draws.
    chance
        The same as a yardstick by which a share is named or not, of any design.
    """

    factor: str
    share: float
    p: float | None
    chance: float


def influence(factor: str, draws: np.ndarray, values: np.ndarray, *, independent: bool, bins: int = BINS) -> Influence:
    r"""The correlation ratio of ranks: a first-order Sobol index that any sample gives.

    With the runs in M bins of the factor's draws, as many in each, and r the ranks of the figure,

    .. math::

        \eta^2 = \frac{\mathrm{var}(E[r \mid \text{bin}])}{\mathrm{var}(r)}, \qquad
        S = 1 - (1 - \eta^2) \frac{N - 1}{N - M},

    where S is without the share that M bins explain by chance. Ranks, since a figure of error spans decades, and a run
    that diverged has none: it is last. Where no factor matters, :math:`(N - 1) \eta^2` is the statistic of Kruskal and
    Wallis, whose distribution is chi-squared with M - 1 degrees of freedom.

    Parameters
    ----------
    draws, values : (N,)
        Finite; and infinite for a run that diverged.

    References
    ----------
    Pearson 1905 for the ratio; Plischke, Borgonovo, Smith: Global sensitivity measures from given data. European
    Journal of Operational Research 226, 2013, for bins.
    """
    there = ~np.isnan(values)
    draws, values = draws[there], values[there]
    count = len(values)
    groups = _groups(draws, min(bins, count // 8))
    most = int(groups.max(initial=0)) + 1
    ranks = stats.rankdata(values)
    total = float(np.var(ranks)) if count else 0.0
    if most < 2 or total == 0:
        return Influence(factor, 0.0, 1.0 if independent else None, 1.0)
    sizes = np.bincount(groups, minlength=most)
    means = np.bincount(groups, weights=ranks, minlength=most) / sizes
    eta = float(np.sum(sizes * (means - ranks.mean()) ** 2) / (count * total))
    corrected = 1 - (1 - eta) * (count - 1) / (count - most)
    chance = float(stats.chi2.sf((count - 1) * eta, most - 1))
    return Influence(factor, min(max(corrected, 0.0), 1.0), chance if independent else None, chance)


def _groups(draws: np.ndarray, bins: int) -> np.ndarray:
    """The bin of each draw, from 0 without gaps; of few values, each is a bin."""
    distinct, place = np.unique(draws, return_inverse=True)
    if len(distinct) <= max(bins, 1):
        return np.asarray(place)
    edges = np.unique(np.quantile(draws, np.linspace(0, 1, max(bins, 1) + 1)[1:-1]))
    return np.asarray(np.unique(np.searchsorted(edges, draws, side="left"), return_inverse=True)[1])


@final
@dataclass(frozen=True, eq=False)
class Axis:
    """One direction of a map.

    Parameters
    ----------
    edges : (B + 1,)
        Of bins; for a factor of few values the values themselves, (B,), and `each` is true.
    """

    edges: np.ndarray
    each: bool
    log: bool

    @property
    def size(self) -> int:
        """B."""
        return len(self.edges) - (not self.each)

    def place(self, draws: np.ndarray) -> np.ndarray:
        """The bin of each draw."""
        if self.each:
            return np.asarray(np.searchsorted(self.edges, draws))
        return np.asarray(np.clip(np.searchsorted(self.edges, draws, side="right") - 1, 0, self.size - 1))


@final
@dataclass(frozen=True, eq=False)
class Map:
    """A figure over two factors: `runs`, `median` and `diverged` are (B_y, B_x); nan in a bin without runs."""

    x: Axis
    y: Axis
    runs: np.ndarray
    median: np.ndarray
    diverged: np.ndarray


def axis_of(draws: np.ndarray, runs: int, *, log: bool = False) -> Axis:
    """Bins that the draws fill: equally wide, of a `log` axis in their logarithms; of few values, these themselves.

    Few are values that come back: a dozen draws that each come once are draws all the same.
    """
    distinct = np.unique(draws)
    if len(distinct) <= 12 and (len(distinct) == 1 or 2 * len(distinct) <= len(draws)):
        return Axis(distinct, True, False)
    low, high = float(distinct[0]), float(distinct[-1])
    # some twenty runs in a bin of two such axes
    count = int(np.clip(np.sqrt(runs / 20), 3, 16))
    log = log and low > 0
    edges = np.geomspace(low, high, count + 1) if log else np.linspace(low, high, count + 1)
    return Axis(edges, False, log)


def map_of(x: np.ndarray, y: np.ndarray, values: np.ndarray, *, logs: tuple[bool, bool] = (False, False)) -> Map:
    """Cut the runs into bins of two factors; the median counts those that diverged as infinite.

    `logs` are those of x and y that are drawn by their logarithms.
    """
    there = ~np.isnan(values)
    x, y, values = x[there], y[there], values[there]
    across, up = (axis_of(axis, len(values), log=log) for axis, log in zip((x, y), logs, strict=True))
    shape = (up.size, across.size)
    cell = up.place(y) * across.size + across.place(x)
    runs = np.bincount(cell, minlength=up.size * across.size)
    lost = np.bincount(cell, weights=np.isinf(values), minlength=up.size * across.size)
    median = np.full(up.size * across.size, np.nan)
    order = np.argsort(cell, kind="stable")
    for index, part in enumerate(np.split(values[order], np.cumsum(runs)[:-1])):
        if len(part):
            median[index] = np.quantile(part, 0.5, method="inverted_cdf")
    with np.errstate(invalid="ignore"):
        return Map(across, up, runs.reshape(shape), median.reshape(shape), (lost / runs).reshape(shape))
