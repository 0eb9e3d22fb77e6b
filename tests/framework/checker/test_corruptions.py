"""A certificate with one entry changed at random is refused, refuted, or states something else that is true."""

from __future__ import annotations

from collections import Counter

import pytest

from tests.framework.checker.certificates import certificate, node_path, result
from tests.framework.checker.corruptions import NAMES, holds, judged


@pytest.mark.parametrize(("names", "count"), [(NAMES[:3], 16), (NAMES, 60)], ids=["small", "all"])
def test_no_changed_file_proves_something_false(names: tuple[str, ...], count: int) -> None:
    node_path()
    found = judged([(name, seed) for name in names for seed in range(count)])
    counts = Counter(outcome for outcome, _ in found)
    assert not counts["FALSE"], [where for outcome, where in found if outcome == "FALSE"]
    assert min(counts["refuted"], counts["refused"], counts["another true statement"]) > 0


def test_what_a_file_states_is_judged_without_the_checker() -> None:
    data, other = certificate("pendulum"), certificate("pendulum")
    found = result(data)
    assert holds(data, found) == ""
    other["rates"]["arm.dq"] = other["rates"]["arm.q"]
    assert "dV/dt" in holds(other, found)
    other = certificate("pendulum")
    term = next(term for term in other["terms"] if term["role"] == "stored")
    term["role"] = "dissipated"
    assert holds(other, found)
