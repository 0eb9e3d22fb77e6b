"""Proportions, quantiles, comparisons and influences compared with SciPy's, and with their guarantees."""

from __future__ import annotations

import math

import numpy as np
import pytest
import scipy

from dmframe.study.statistics import adjusted, influence, map_of, paired, proportion, quantile


@pytest.mark.parametrize(("count", "runs"), [(0, 299), (1, 50), (7, 40), (40, 40)])
def test_the_interval_of_a_share_is_clopper_and_pearsons(count: int, runs: int) -> None:
    found = proportion(np.arange(runs) < count, independent=True)
    both = scipy.stats.binomtest(count, runs).proportion_ci(0.95, method="exact")
    one = scipy.stats.binomtest(count, runs, alternative="less").proportion_ci(0.95, method="exact")
    assert (found.low, found.high) == pytest.approx((both.low, both.high))
    assert found.most == pytest.approx(one.high)
    assert found.value == count / runs


def test_none_of_299_is_at_most_one_percent() -> None:
    found = proportion(np.zeros(299, dtype=bool), independent=True)
    assert found.most == pytest.approx(1 - 0.05 ** (1 / 299))
    assert found.most is not None
    assert found.most < 0.01 < (proportion(np.zeros(298, dtype=bool), independent=True).most or 0)


@pytest.mark.parametrize("p", [0.003, 0.02, 0.1, 0.4])
@pytest.mark.parametrize("runs", [20, 150])
def test_limits_of_a_share_hold_as_often_as_they_state(p: float, runs: int) -> None:
    weights = scipy.stats.binom.pmf(np.arange(runs + 1), runs, p)
    found = [proportion(np.arange(runs) < k, independent=True) for k in range(runs + 1)]
    assert sum(w for w, each in zip(weights, found, strict=True) if each.low <= p <= each.high) >= 0.95
    assert sum(w for w, each in zip(weights, found, strict=True) if p <= each.most) >= 0.95


def test_shares_that_hold_together_are_wider() -> None:
    happened = np.arange(100) < 5
    one, many = proportion(happened, independent=True), proportion(happened, independent=True, together=10)
    assert many.most == pytest.approx(proportion(happened, independent=True, level=0.995).most)
    assert many.low < one.low < one.high < many.high  # type: ignore[operator]


def test_a_design_that_spreads_its_points_gets_no_interval() -> None:
    happened, values = np.zeros(64, dtype=bool), np.arange(64.0)
    found = proportion(happened, independent=False)
    assert (found.low, found.high, found.most) == (None, None, None)
    assert (quantile(values, 0.9, independent=False).low, quantile(values, 0.9, independent=False).high) == (None, None)
    assert paired(values, values + 1, independent=False).p is None
    assert paired(values, values + 1, independent=False).difference.low is None
    assert influence("a", values, values, independent=False).p is None


@pytest.mark.parametrize("p", [0.5, 0.9, 0.99])
def test_the_interval_of_a_quantile_is_that_of_scipy(p: float) -> None:
    values = np.random.default_rng(3).lognormal(size=1000)
    found = quantile(values, p, independent=True)
    known = scipy.stats.quantile_test(values, p=p).confidence_interval(0.95)
    assert (found.low, found.high) == (known.low, known.high)
    assert found.value == np.sort(values)[math.ceil(p * 1000) - 1]


@pytest.mark.parametrize(("p", "runs"), [(0.5, 9), (0.5, 60), (0.9, 60), (0.95, 200)])
def test_the_interval_of_a_quantile_holds_as_often_as_it_states(p: float, runs: int) -> None:
    ranks = np.arange(1.0, runs + 1)  # of the values 1, 2, ...: the interval's ends are their places
    found = quantile(ranks, p, independent=True)
    lower = 0 if math.isinf(found.low or 0) else int(found.low or 0)
    upper = runs + 1 if math.isinf(found.high or 0) else int(found.high or 0)
    below = scipy.stats.binom(runs, p)
    assert below.cdf(upper - 1) - below.cdf(lower - 1) >= 0.95
    assert below.cdf(upper - 2) < 0.975 or upper == 1  # and not wider than necessary
    assert below.cdf(lower) > 0.025


def test_too_few_runs_give_no_upper_end() -> None:
    assert quantile(np.arange(50.0), 0.99, independent=True).high == math.inf


def test_a_run_that_diverged_counts_in_a_quantile() -> None:
    values = np.array([*range(90), *[math.inf] * 10], dtype=float)
    assert quantile(values, 0.5, independent=True).value == 49
    assert math.isinf(quantile(values, 0.95, independent=True).value)


def test_a_comparison_goes_by_signs_and_includes_divergence() -> None:
    first = np.array([1.0, 2.0, 3.0, math.inf, math.inf, 5.0, math.nan])
    second = np.array([0.5, 1.0, 4.0, 1.0, math.inf, math.inf, 1.0])
    found = paired(first, second, independent=True)
    assert (found.better, found.worse, found.alike, found.runs) == (3, 2, 1, 6)
    assert found.p == pytest.approx(scipy.stats.binomtest(3, 5).pvalue)


def test_a_comparison_on_the_same_samples_shows_what_two_medians_hide() -> None:
    rng = np.random.default_rng(1)
    robots = rng.lognormal(sigma=2, size=200)
    found = paired(robots, robots * 0.98, independent=True)
    assert found.better == 200
    assert found.ratio == pytest.approx(0.98)
    assert found.p is not None
    assert found.p < 1e-50
    assert found.difference.high is not None
    assert found.difference.high < 0
    assert scipy.stats.mannwhitneyu(robots, robots * 0.98).pvalue > 0.5  # unpaired, no difference is detected


def test_several_tests_are_adjusted_as_holm_did() -> None:
    assert adjusted([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])


def test_influences_are_the_first_order_indices_of_a_known_function() -> None:
    """y = 4 a + 2 b + c with uniform draws: variances as 16, 4, 1; in an almost normal sum, ranks keep the ratios."""
    a, b, c, d = np.random.default_rng(5).uniform(size=(4, 20000))
    y = 4 * a + 2 * b + c
    uniform = scipy.stats.uniform()
    known = scipy.stats.sobol_indices(
        func=lambda x: 4 * x[0] + 2 * x[1] + x[2],
        n=4096,
        dists=[uniform] * 4,
        rng=np.random.default_rng(1),
    ).first_order
    found = [influence(name, draws, y, independent=True) for name, draws in zip("abcd", (a, b, c, d), strict=True)]
    assert [each.explained for each in found] == pytest.approx(known.ravel().tolist(), abs=0.03)
    assert found[3].p is not None
    assert found[3].p > 0.01
    assert all(each.p is not None and each.p < 1e-10 for each in found[:3])


def test_an_influence_on_ranks_survives_decades_and_divergence() -> None:
    rng = np.random.default_rng(2)
    a, b = rng.uniform(size=(2, 5000))
    y = 10 ** (6 * a + 0.1 * b)
    y[a > 0.9] = math.inf
    assert influence("a", a, y, independent=True).explained > 0.95
    assert influence("b", b, y, independent=True).explained < 0.01


def test_the_chance_of_a_share_is_that_of_kruskal_and_wallis() -> None:
    rng = np.random.default_rng(7)
    a = rng.uniform(size=800)
    y = np.round(rng.normal(size=800) + 0.3 * a, 1)  # with ties
    found = influence("a", a, y, independent=True, bins=4)
    parts = [y[(a > low) & (a <= high)] for low, high in np.lib.stride_tricks.sliding_window_view(
        [-1, *np.quantile(a, [0.25, 0.5, 0.75]), 2], 2)]  # fmt: skip
    assert found.p == pytest.approx(scipy.stats.kruskal(*parts).pvalue)


def test_no_influence_is_claimed_more_often_than_its_chance_states() -> None:
    rng = np.random.default_rng(11)
    found = [influence("a", rng.uniform(size=200), rng.normal(size=200), independent=True) for _ in range(400)]
    assert np.mean([(each.p or 0) < 0.05 for each in found]) == pytest.approx(0.05, abs=0.03)
    assert np.mean([each.explained for each in found]) < 0.03  # chance is subtracted


def test_a_factor_of_one_value_has_no_influence() -> None:
    assert influence("a", np.ones(50), np.arange(50.0), independent=True).explained == 0
    assert influence("a", np.arange(50.0), np.ones(50), independent=True).explained == 0
    assert influence("a", np.empty(0), np.empty(0), independent=True).explained == 0


def test_a_map_counts_its_bins() -> None:
    x = np.repeat([1.0, 2.0], 4)
    y = np.tile([0.1, 0.2], 4)
    values = np.array([1, 2, 3, math.inf, 5, 6, math.nan, 8])
    found = map_of(x, y, values)
    assert found.runs.tolist() == [[2, 1], [2, 2]]
    assert found.median.tolist() == [[1, 5], [2, 6]]
    assert found.diverged.tolist() == [[0, 0], [0.5, 0]]


def test_draws_that_each_come_once_are_bins_however_few_they_are_and_values_that_come_back_are_not() -> None:
    draws = np.random.default_rng(0).uniform(1, 2, size=12)
    assert not map_of(draws, np.tile([1.0, 2.0], 6), draws).x.each
    assert map_of(draws, np.tile([1.0, 2.0], 6), draws).y.each


def test_a_map_of_many_draws_holds_all_of_them() -> None:
    x, y = np.random.default_rng(0).uniform([[0.01], [5]], [[1], [6]], size=(2, 4000))
    found = map_of(x, y, x + y, logs=(True, False))
    assert found.runs.sum() == 4000
    assert found.x.log
    assert not found.y.log
    assert found.x.edges[0] == x.min()
    assert found.x.edges[-1] == x.max()
    bin_of = found.x.place(x)
    assert all(found.x.edges[bin_of] <= x)
    assert all(x <= found.x.edges[bin_of + 1])
