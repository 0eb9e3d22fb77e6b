"""The least K_c, compared with NumPy's roots, with Remark 5's closed forms, and with `verify` on either side of it."""

from __future__ import annotations

import math
from fractions import Fraction
from itertools import product
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dmframe.analysis import ReferenceGain, least_K_c, reference_gains
from dmframe.certify import verify
from dmframe.certify.uncertain import intervals
from dmframe.common.errors import ValueFault
from dmframe.exact.rational import Interval
from dmframe.graph.graph import Graph

gain = st.floats(1e-3, 1e4)
pair = st.tuples(gain, gain).map(lambda ends: (min(ends), max(ends)))


def root(K_D: float, K_P: float, K_I: float, B: float, K: float) -> float:
    """The positive K_c at which (K_D + B/K) K_c + K_P - K_I / K_c is zero."""
    return float(max(np.roots([K_D + B / K, K_P, -K_I]).real))


@settings(max_examples=60, deadline=None)
@given(pair, pair, pair, pair, pair)
def test_it_is_the_largest_root_over_the_corners_rounded_up_in_the_last_digit(
    K_D: Any, K_P: Any, K_I: Any, B: Any, K: Any
) -> None:
    expected = max(root(*corner) for corner in product(K_D, K_P, K_I, B, K))
    found = least_K_c(K_D, K_P, K_I, B=B, K=K, digits=6)
    unit = 10.0 ** (math.floor(math.log10(float(found))) - 5)
    assert expected * (1 - 1e-9) <= float(found) <= expected * (1 + 1e-9) + unit * 1.001


@settings(max_examples=40, deadline=None)
@given(pair, pair, pair, pair, pair, st.randoms(use_true_random=False))
def test_no_gains_inside_their_intervals_need_more(K_D: Any, K_P: Any, K_I: Any, B: Any, K: Any, random: Any) -> None:
    found = float(least_K_c(K_D, K_P, K_I, B=B, K=K))
    for _ in range(20):
        inside = [random.uniform(*ends) for ends in (K_D, K_P, K_I, B, K)]
        assert root(*inside) <= found * (1 + 1e-9)


@settings(max_examples=40, deadline=None)
@given(pair, pair, pair)
def test_one_unit_less_in_the_last_digit_is_too_small_exactly(K_D: Any, K_P: Any, K_I: Any) -> None:
    def M_bar(k: Fraction) -> Fraction:
        D, P, I = (Fraction(repr(end)) for end in (K_D[0], K_P[0], K_I[1]))  # noqa: E741 - the paper's name
        return D * k + P - I / k

    found = least_K_c(K_D, K_P, K_I, digits=3)
    power = Fraction(10) ** math.floor(math.log10(found) + 1e-12)
    assert found == 10 * power or (found / power * 100).denominator == 1  # three digits
    below = found - power / 100 if found > power else found - power / 1000
    assert M_bar(found) >= 0 > M_bar(below)


@pytest.mark.parametrize("wrong", ["K_D", "K_P", "K_I", "B", "K"])
def test_the_other_end_of_any_interval_would_be_too_small(wrong: str) -> None:
    """A seeded fault in the choice of the corner: each of the five ends has an effect."""
    box = {"K_D": (2.0, 4.0), "K_P": (1.0, 3.0), "K_I": (5.0, 9.0), "B": (0.5, 2.0), "K": (0.4, 0.8)}
    found = least_K_c(**box, digits=9)  # type: ignore[arg-type] - keywords by name
    low, high = box[wrong]
    other = {**box, wrong: (low, low) if wrong in ("K_I", "K") else (high, high)}
    assert least_K_c(**other, digits=9) < found  # type: ignore[arg-type] - as above


@settings(max_examples=40, deadline=None)
@given(gain, st.floats(1, 1e3), st.floats(1, 1e3))
def test_the_golden_ratio_is_enough_where_the_integral_gain_is_the_least(K_I: float, p: float, d: float) -> None:
    golden = (math.sqrt(5) - 1) / 2
    assert float(least_K_c(d * K_I, p * K_I, K_I, digits=9)) <= golden * (1 + 1e-8)


def test_the_golden_ratio_is_met_where_all_gains_are_equal() -> None:
    assert least_K_c(3.0, 3.0, 3.0, digits=12) == Fraction("0.618033988750")  # (sqrt 5 - 1)/2 = 0.61803398874989...


def test_a_root_of_few_digits_is_that_root() -> None:
    assert least_K_c(1.0, 1.0, 2.0) == 1  # k^2 + k - 2 = (k - 1)(k + 2)
    assert least_K_c(1.0, 1.0, 6.0, digits=1) == 2
    assert least_K_c(1.0, 0.5, 0.5, digits=1) == Fraction(1, 2)  # k^2 + k/2 - 1/2 = (k - 1/2)(k + 1)
    assert least_K_c(1.0, 1.0, 9900.0, digits=1) == 100  # (k - 99)(k + 100): the carry into a new digit


def test_friction_and_intervals_may_be_left_out_or_given_exactly() -> None:
    gains = (Interval(Fraction(2), Fraction(3)), Fraction(5), 7)
    assert least_K_c(*gains, B=(0, 9)) == least_K_c(2, 5, 7)
    assert least_K_c(*gains, B=(1, 9), K=0.5) == least_K_c(4, 5, 7)


@pytest.mark.parametrize(
    ("change", "found"),
    [
        ({"K_D": 0.0}, "K_D: expected a gain > 0, found 0"),
        ({"K_I": (-1.0, 2.0)}, "K_I: expected a gain > 0, found -1"),
        ({"B": -1.0}, "B: expected a gain >= 0, found -1"),
        ({"K_P": (2.0, 1.0)}, "K_P: expected [lower, upper], found 2 above 1"),
        ({"digits": 0}, "digits: expected at least 1, found 0"),
    ],
)
def test_gains_that_no_servo_has_are_refused(change: dict[str, Any], found: str) -> None:
    with pytest.raises(ValueFault) as fault:
        least_K_c(**{"K_D": 1.0, "K_P": 1.0, "K_I": 1.0, **change})
    assert fault.value.text == found


UNCERTAIN = {"servo.K_D": [300, 1000], "servo.K_P": [800, 2000], "servo.K_I": [200, 900], "arm.viscous": [1, 9]}


def of_graph(*overrides: str, uncertain: dict[str, Any] | None = None) -> tuple[ReferenceGain, ...]:
    diagram = Graph.read("theorem_4", overrides).diagram
    return reference_gains(diagram, intervals(diagram, uncertain or {}))


def test_a_graphs_servo_is_read_joint_by_joint() -> None:
    found = of_graph("inverse.K_c=[1, 0.28186, 0.2]", "servo.K_I=[560, 560, 1000]")
    assert [tie.joint for tie in found] == ["shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint"]
    assert {tie.block for tie in found} == {"inverse"}
    assert [float(tie.own) for tie in found] == [1, 0.28186, 0.2]
    servo = ((800, 1760, 560, 5), (800, 1760, 560, 5), (400, 880, 1000, 2))
    for tie, (K_D, K_P, K_I, B) in zip(found, servo, strict=True):
        assert 0 <= float(tie.least) - root(K_D, K_P, K_I, B, 1) <= 1e-4
        assert 0 <= float(tie.least_without_friction) - root(K_D, K_P, K_I, 0, 1) <= 1e-4
    # the second is below the rounded 0.2819, but above the root 0.281855...
    assert [tie.holds for tie in found] == [True, True, False]


def test_over_intervals_it_is_where_verifys_own_condition_turns() -> None:
    """`verify` decides M_bar with its own intervals, from the block's formula."""
    (least, *_) = {tie.least for tie in of_graph(uncertain=UNCERTAIN)}
    below = least - Fraction(1, 10**4)
    assert least == Fraction("0.852")  # root of 301 k^2 + 800 k - 900: 0.85193...
    for K_c, holds in ((least, True), (below, False)):
        diagram = Graph.read("theorem_4", [f"inverse.K_c={float(K_c)}"]).diagram
        verdict = verify(diagram, uncertain=intervals(diagram, UNCERTAIN))
        (condition,) = (item for item in verdict.conditions if "M_bar" in item.name)
        assert condition.holds is holds
        assert {tie.holds for tie in of_graph(f"inverse.K_c={float(K_c)}", uncertain=UNCERTAIN)} == {holds}


def test_a_graph_without_a_pid_inverse_has_none() -> None:
    for name in ("theorem_1", "torque_direct_pid", "ur10_fast_kinematic"):
        assert reference_gains(Graph.read(name).diagram) == ()
