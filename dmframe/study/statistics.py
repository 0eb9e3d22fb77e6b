"""Statistics of many runs: proportions, quantiles, comparisons, influences, and their confidence intervals if valid.

The figure of a run that diverged is infinite, so that it is worse than every completed run and no quantile ignores it.
Intervals are exact or distribution-free and require independent draws; for a design that spreads its points (Sobol,
Latin hypercube) only estimates are given.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, final

import numpy as np
import scipy

LEVEL: Final = 0.95
"""Confidence level of every interval."""

FEWEST: Final = 16
"""Fewest runs for influences: two bins of eight."""

BINS: Final = 16
"""Bins of a factor's draws for its influence, with equally many runs each."""


@final
@dataclass(frozen=True)
class Proportion:
    """Proportion of runs with an event.

    Parameters
    ----------
    low, high
        Two-sided interval of the probability; None if the design gives none.
    most
        One-sided upper limit ("at most"); None as above. It is always printed with the two-sided interval: choosing
        between them by the count would lower the confidence level.
    """

    count: int
    runs: int
    low: float | None = None
    high: float | None = None
    most: float | None = None

    @property
    def value(self) -> float:
        """Proportion of the runs; nan without runs."""
        return self.count / self.runs if self.runs else float("nan")


def proportion(happened: np.ndarray, *, independent: bool, level: float = LEVEL, together: int = 1) -> Proportion:
    r"""Proportion of True values, with the exact binomial interval of Clopper and Pearson.

    With k of n, the upper end p of the two-sided interval solves :math:`P(B(n, p) \le k) = (1 - level) / 2`, and the
    one-sided limit the same with :math:`1 - level`.

    Parameters
    ----------
    happened : (N,) bool
    independent
        The runs are independent draws; otherwise there is no interval.
    together
        Number of proportions whose intervals hold simultaneously (Bonferroni).

    References
    ----------
    Clopper, Pearson: The use of confidence or fiducial limits illustrated in the case of the binomial. Biometrika 26,
    1934.
    """
    count, runs = int(np.count_nonzero(happened)), len(happened)
    if not independent or runs == 0:
        return Proportion(count, runs)
    miss = (1 - level) / together
    low, high = (_limit(count, runs, miss / 2, upper=upper) for upper in (False, True))
    return Proportion(count, runs, low, high, _limit(count, runs, miss, upper=True))


def _limit(count: int, runs: int, miss: float, *, upper: bool) -> float:
    """Bound of the exact binomial interval, a quantile of the beta distribution."""
    if upper:
        return 1.0 if count == runs else float(scipy.stats.beta.ppf(1 - miss, count + 1, runs - count))
    return 0.0 if count == 0 else float(scipy.stats.beta.ppf(miss, count, runs - count + 1))


@final
@dataclass(frozen=True)
class Quantile:
    """A quantile of a figure; infinite if it lies among the runs that diverged.

    `low` and `high` bound its interval: None if the design gives none, infinite if the runs are too few for a bound.
    """

    p: float
    value: float
    low: float | None = None
    high: float | None = None


def quantile(values: np.ndarray, p: float, *, independent: bool, level: float = LEVEL) -> Quantile:
    r"""A quantile with its distribution-free interval between two order statistics.

    Of N independent draws the number not above the quantile is :math:`B \sim B(N, p)`, so that the l-th value is above
    it with the probability :math:`P(B < l)`, and the u-th below it with :math:`P(B \ge u)`; each is at most
    half of one minus the level.

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
    below = scipy.stats.binom.cdf(np.arange(count + 1), count, p)
    lower = int(np.searchsorted(below, miss, side="right"))
    upper = int(np.searchsorted(below, 1 - miss, side="left")) + 1
    low = float(ordered[lower - 1]) if lower >= 1 else -np.inf
    high = float(ordered[upper - 1]) if upper <= count else np.inf
    return Quantile(p, value, low, high)


@final
@dataclass(frozen=True)
class Paired:
    """Comparison of two grid points on the same samples, the second with the first.

    Parameters
    ----------
    better, worse, alike
        Numbers of samples on which the second has the smaller, the larger, or the same figure.
    difference
        The median of second minus first, with its interval.
    ratio
        The median of second over first.
    p
        Of the two-sided sign test; None unless the samples are independent draws.
    """

    better: int
    worse: int
    alike: int
    difference: Quantile
    ratio: float
    p: float | None

    @property
    def runs(self) -> int:
        """Number of common samples."""
        return self.better + self.worse + self.alike


def paired(first: np.ndarray, second: np.ndarray, *, independent: bool) -> Paired:
    """Compare figures sample by sample with a sign test.

    No distribution of the differences is assumed, so that runs that diverged are included: they are worse than all
    others, and equal to one another. (Wilcoxon's test requires symmetric differences.)

    Parameters
    ----------
    first, second : (N,)
        Infinite for a run that diverged; samples with a nan in either are left out.
    """
    there = ~(np.isnan(first) | np.isnan(second))
    first, second = first[there], second[there]
    with np.errstate(invalid="ignore", divide="ignore"):
        both = np.isinf(first) & np.isinf(second)
        difference = np.where(both, 0.0, second - first)
        ratio = np.where(both | (first == second), 1.0, second / first)
    better, worse = int((difference < 0).sum()), int((difference > 0).sum())
    p = scipy.stats.binomtest(better, better + worse).pvalue if better + worse else 1.0
    return Paired(
        better,
        worse,
        len(difference) - better - worse,
        quantile(difference, 0.5, independent=independent),
        quantile(ratio, 0.5, independent=False).value,
        float(p) if independent else None,
    )


def adjusted(ps: Sequence[float]) -> list[float]:
    """Probabilities of several tests adjusted for their number (Holm 1979), in their order."""
    order, found, most = np.argsort(ps), [0.0] * len(ps), 0.0
    for place, index in enumerate(order.tolist()):
        most = max(most, min(1.0, (len(ps) - place) * ps[index]))
        found[index] = most
    return found


@final
@dataclass(frozen=True)
class Influence:
    """Influence of one factor on a figure.

    Parameters
    ----------
    explained
        Explained fraction of the variance of the figure's ranks, from 0 to 1.
    p
        Probability of so large a fraction if the factor has no influence; None unless the draws are independent.
    chance
        The same for any design, as a threshold for naming a factor.
    """

    factor: str
    explained: float
    p: float | None
    chance: float


def influence(factor: str, draws: np.ndarray, values: np.ndarray, *, independent: bool, bins: int = BINS) -> Influence:
    r"""Correlation ratio of ranks: a first-order Sobol index estimated from any sample.

    With the runs in M equally filled bins of the factor's draws, and r the ranks of the figure,

    .. math::

        \eta^2 = \frac{\mathrm{var}(E[r \mid \text{bin}])}{\mathrm{var}(r)}, \qquad
        S = 1 - (1 - \eta^2) \frac{N - 1}{N - M},

    where S excludes the fraction that M bins explain by chance. Ranks are used because an error spans decades; a run
    that diverged has the last rank. Without any influence, :math:`(N - 1) \eta^2` is the statistic of Kruskal and
    Wallis, which is chi-squared with M - 1 degrees of freedom.

    Parameters
    ----------
    draws, values : (N,)
        Draws are finite; values are infinite for a run that diverged.

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
    ranks = scipy.stats.rankdata(values)
    total = float(np.var(ranks)) if count else 0.0
    if most < 2 or total == 0:
        return Influence(factor, 0.0, 1.0 if independent else None, 1.0)
    sizes = np.bincount(groups, minlength=most)
    means = np.bincount(groups, weights=ranks, minlength=most) / sizes
    eta = float(np.sum(sizes * (means - ranks.mean()) ** 2) / (count * total))
    corrected = 1 - (1 - eta) * (count - 1) / (count - most)
    chance = float(scipy.stats.chi2.sf((count - 1) * eta, most - 1))
    return Influence(factor, min(max(corrected, 0.0), 1.0), chance if independent else None, chance)


def _groups(draws: np.ndarray, bins: int) -> np.ndarray:
    """The bin of each draw, from 0 without gaps; a bin per value if there are few values."""
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
        Of bins; for a factor with few values the values themselves, (B,), and `each` is true.
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
    """Equally wide bins over the draws, in logarithms for a `log` axis; a bin per value if there are few values.

    Values are few if they recur.
    """
    distinct = np.unique(draws)
    if len(distinct) <= 12 and (len(distinct) == 1 or 2 * len(distinct) <= len(draws)):
        return Axis(distinct, True, False)
    low, high = float(distinct[0]), float(distinct[-1])
    # about twenty runs per bin of two such axes
    count = int(np.clip(np.sqrt(runs / 20), 3, 16))
    log = log and low > 0
    edges = np.geomspace(low, high, count + 1) if log else np.linspace(low, high, count + 1)
    return Axis(edges, False, log)


def map_of(x: np.ndarray, y: np.ndarray, values: np.ndarray, *, logs: tuple[bool, bool] = (False, False)) -> Map:
    """Runs in bins of two factors; the median counts runs that diverged as infinite.

    `logs` states which of x and y have logarithmic axes.
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
