"""The configured delay of a sampled law, compared with the plant's states between its commands and measurements."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import pytest
from sampled_arm2 import sampled_arm2

import dmframe as dm
from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.block.parameter import Positive, Scalar
from dmframe.block.port import Input, Output, Side, State
from dmframe.certify import Verdict, verify
from dmframe.certify.claim import claim_of
from dmframe.certify.delays import decided_delays
from dmframe.diagram import Diagram
from dmframe_blocks.sampled_inverse import SampledInverse


def verdict(delay: int = 0, **between: dict[str, Any]) -> Verdict:
    graph = sampled_arm2(servo="pid", replay=2, delay=delay)
    graph["blocks"] |= between
    return verify(dm.load(graph).diagram, trials=1)


def line(samples: int = 1, **options: Any) -> dict[str, Any]:
    return {"type": "transport_delay", "samples": samples, **options}


def late(samples: int = 1, **options: Any) -> dict[str, Any]:
    return {"type": "measurement_delay", "samples": samples, **options}


STEPS = {"type": "encoder", "step": 0.001}

RIGHT: list[tuple[int, dict[str, Any]]] = [
    (0, {}),
    (1, {"line": line()}),
    (1, {"line": line(share=0)}),
    (1, {"line": line(), "encoder": STEPS}),
    (1, {"tool": late()}),
    (2, {"line": line(), "tool": late()}),
    (2, {"line": line(2)}),
]
WRONG: list[tuple[int, dict[str, Any], str, str]] = [
    (0, {"line": line()}, "1 (line)", "0"),
    (1, {}, "0", "0"),
    (2, {"line": line()}, "1 (line)", "0"),
    (0, {"tool": late()}, "0", "1 (tool)"),
    (1, {"line": line(), "tool": late()}, "1 (line)", "1 (tool)"),
    (1, {"line": line(share=0.5)}, "1 and 2 (line)", "0"),
    (1, {"line": line(late=0.1)}, "1 and 2 (line)", "0"),
    (1, {"line": line(lost=0.1)}, "1 to 9 (line)", "0"),
    (1, {"tool": late(share=0.5)}, "0", "1 and 2 (tool)"),
]


@pytest.mark.parametrize("case", range(len(RIGHT)))
def test_a_delay_that_is_the_plants_is_a_condition_that_holds(case: int) -> None:
    delay, between = RIGHT[case]
    found = verdict(delay, **between)
    assert found.outcome == "proved", found.reason
    assert not any("delay" in item.text for item in found.assumptions if item.text.startswith("inverse"))
    (reported,) = [item for item in found.conditions if "delays commands by" in item.name]
    assert reported.holds
    assert reported.value == 0


@pytest.mark.parametrize("case", range(len(WRONG)))
def test_a_delay_that_is_not_the_plants_fails_with_both_numbers(case: int) -> None:
    delay, between, there, back = WRONG[case]
    found = verdict(delay, **between)
    assert found.outcome == "not_applicable"
    numbers = f"a delay of {delay} samples, and the plant delays commands by {there} and measurements by {back}"
    assert found.reason.startswith(f"the identity holds, but a condition fails: inverse: its rows use {numbers}")


def test_a_command_that_is_none_of_the_blocks_own_is_left_to_an_assumption(monkeypatch: pytest.MonkeyPatch) -> None:
    honest = SampledInverse.certificate

    def other(self: Any, u: Signals, x: Signals, p: Signals, truth: Signals) -> Any:
        stated = honest(self, u, x, p, truth)
        return replace(stated, acted=tuple(replace(item, held=x.q_before) for item in stated.acted))

    monkeypatch.setattr(SampledInverse, "certificate", other)
    found = verdict()
    assert found.outcome == "proved"
    assert not any("delays commands by" in item.name for item in found.conditions)
    assert any("a delay is as configured, or reported by the robot" in item.text for item in found.assumptions)


class Changed(AbstractBlock):
    """Outputs a signal of the plant as another signal."""

    side = Side.PLANT
    inputs = (Input("dq_c", "n", "rad/s"),)
    outputs = (Output("dq_c_other", "n", "rad/s", instead_of="dq_c"),)
    states = (State("lag", "n", "rad/s"), State("old", "n", "rad/s", sampled=True))
    way: str = ""
    k: Scalar = Positive("", "1/s", default=20.0)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        c, ways = u.dq_c, {
            "as it is": u.dq_c,
            "late": x.old,
            "half of it late": (u.dq_c + x.lag) / 2,
            "joints exchanged": ca.vertcat(u.dq_c[1], u.dq_c[0]),
            "exchanged and late": ca.vertcat(x.old[1], x.old[0]),
            "larger": 1.1 * u.dq_c,
        }  # fmt: skip
        rates, later = {"lag": p.k * (c - x.lag)}, {"old": c}
        return Equations(outputs={"dq_c_other": ways[self.way]}, rates=rates, next=later)


@pytest.mark.parametrize(
    ("way", "delay", "copied"),
    [
        ("as it is", 0, True),
        ("late", 1, True),
        ("half of it late", 0, False),
        ("joints exchanged", 0, False),
        ("exchanged and late", 1, False),
        ("larger", 0, False),
    ],
)
def test_another_signal_with_the_same_delay_is_left_to_an_assumption(way: str, delay: int, copied: bool) -> None:
    graph = dm.load(sampled_arm2(servo="pid", replay=2, delay=delay))
    blocks = {**graph.blocks, "changed": Changed(way=way)}
    claim = claim_of(Diagram.build(blocks, graph.file.wires, graph.robot))
    assert [decided_delays(claim, part) for part in claim.parts if part.certificate.acted] == [copied]
