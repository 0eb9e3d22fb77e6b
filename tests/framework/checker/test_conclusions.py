"""What the checkers conclude of random flows agrees with their simulation."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from tests.framework.checker.certificates import checker, in_node, node_path, result
from tests.framework.checker.flows import Flow, behaviour, random_flow


def contradicted(flow: Flow, found: dict[str, Any], counts: Counter[str]) -> Iterator[str]:
    """Conclusions that a simulation contradicts; counts what the signals do and what is concluded."""
    values = flow.simulated(np.random.default_rng(0))
    if values is None:
        return
    for k in range(values.shape[1]):
        seen = behaviour(values[:, k])
        shown = [text for text in found["conclusions"] if text.startswith(f"s{k} ")]
        counts.update([seen, *(text.partition(" ")[2] for text in shown)])
        wrong = {"grows": ("is bounded", "goes to zero"), "stays": ("goes to zero",), "vanishes": ()}[seen]
        yield from (text for text in shown if text.endswith(wrong))


@pytest.mark.parametrize(("first", "count"), [(1, 6), (100, 300)], ids=["6", "300"])
def test_no_conclusion_contradicts_a_simulation(first: int, count: int) -> None:
    node_path()
    flows, counts = [random_flow(seed) for seed in range(first, first + count)], Counter[str]()
    for k, (flow, other) in enumerate(zip(flows, in_node([flow.data for flow in flows]), strict=True)):
        found = result(flow.data)
        assert found["status"] == other["status"] == "re-proved"
        assert found["conclusions"] == other["conclusions"], first + k
        assert [*contradicted(flow, found, counts)] == [], first + k
    assert min(counts[text] for text in ("grows", "stays", "is bounded", "goes to zero")) > count


@pytest.mark.parametrize("rule", ["bounded", "among", "vanish"])
def test_a_rule_that_always_holds_is_contradicted(rule: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checker().Conclusions, rule, lambda self, *nodes: True)
    flows = [random_flow(seed) for seed in (1, 2, 3)]
    assert [text for flow in flows for text in contradicted(flow, result(flow.data), Counter())]
