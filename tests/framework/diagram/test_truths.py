"""The owner of each true value in a proof: one per name, or by the wires of a diagram with several."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np
import pytest

from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.block.certificate import Certificate, Condition, Inequality, Square
from dmframe.block.parameter import Positive, Scalar
from dmframe.block.port import TIME, Access, Input, Output, Side, State
from dmframe.certify import claim_of, verify
from dmframe.certify.claim import NotApplicableError
from dmframe.common.errors import BlockError
from dmframe.diagram import Diagram
from dmframe.diagram.truths import distances
from dmframe.diagram.view import view


class Store(AbstractBlock):
    """dy = -y; k is a hidden true number."""

    side = Side.PLANT
    inputs = (Input("v", optional=True),)
    outputs = (Output("k"), Output("y", "", "", Access.MEASURED))
    states = (State("y"),)
    k: Scalar = Positive(default=5.0)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"k": p.k, "y": x.y}, rates={"y": -x.y})

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        return Certificate(storage=(Square(x.y, ca.SX(1)),), dissipation=(Square(x.y, ca.SX(1)),))


class Needs(AbstractBlock):
    """Its proof needs k < 1."""

    inputs = (Input("y"),)
    outputs = (Output("v", "", "", Access.COMMANDED),)
    truth = (Input("k"),)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"v": u.y})

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        return Certificate()

    def conditions(self, p: Signals, truth: Signals) -> Sequence[Condition]:
        return (Inequality("k < 1", 1 - truth.k, "its theorem"),)


class States(AbstractBlock):
    """Its certificate states a true value with a name chosen by the test."""

    inputs = (Input("y"),)
    outputs = (Output("z"),)
    name: str = "k"
    value: Scalar = Positive(default=0.1)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"z": u.y})

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        return Certificate(truth={self.name: p.value})


class Reads(AbstractBlock):
    """Stores its input of b, so that a test can identify the source of b."""

    inputs = (Input("z"),)
    truth = (Input("b"),)
    states = (State("s"),)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(rates={"s": -x.s})

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        return Certificate(storage=(Square(x.s, truth.b),), dissipation=(Square(x.s, truth.b),))


def pairs(order: Sequence[str], k: Mapping[str, float]) -> Diagram:
    """Two loops of a store and a block that needs its k, in any order of the file."""
    blocks = {name: Store(k=k[name]) if name.startswith("store") else Needs() for name in order}
    wires = {f"needs{i}.y": f"store{i}.y" for i in (1, 2)} | {f"store{i}.v": f"needs{i}.v" for i in (1, 2)}
    return Diagram.build(blocks, wires)


def test_the_certificate_of_another_block_cannot_replace_a_number_of_the_plant() -> None:
    honest = Diagram.build({"plant": Store(k=5), "needs": Needs()})
    assert "needs: k < 1" in verify(honest).reason
    verdict = verify(Diagram.build({"plant": Store(k=5), "needs": Needs(), "other": States()}))
    assert verdict.outcome == "not_applicable"
    assert "the certificate of other states it, and plant has an output plant.k" in verdict.reason


@pytest.mark.parametrize("seed", range(6))
def test_each_of_two_loops_gets_the_truth_of_its_own_plant_in_any_order(seed: int) -> None:
    order = list(np.random.default_rng(seed).permutation(["store1", "needs1", "store2", "needs2"]))
    for k, fails in (({"store1": 0.5, "store2": 5}, "needs2"), ({"store1": 5, "store2": 0.5}, "needs1")):
        verdict = verify(pairs(order, k))
        assert [item.name for item in verdict.conditions if not item.holds] == [f"{fails}: k < 1"]
    assert verify(pairs(order, {"store1": 0.5, "store2": 0.5})).outcome == "proved"


def test_a_truth_that_two_blocks_have_as_near_is_an_error_that_names_them() -> None:
    class Both(Needs):
        inputs = (Input("y"), Input("other"))

        def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
            return Equations(outputs={"v": u.y + u.other})

    blocks = {"store1": Store(k=0.5), "store2": Store(k=5), "needs": Both()}
    diagram = Diagram.build(blocks, {"needs.y": "store1.y", "needs.other": "store2.y"})
    with pytest.raises(BlockError, match=r"its wires are equally close to store1\.k, store2\.k"):
        view(diagram, "needs")
    assert verify(diagram).outcome == "not_applicable"


def test_equally_near_blocks_with_one_value_are_no_conflict() -> None:
    blocks = {"plant": Store(), "one": States(name="b"), "reads": Reads()}
    assert claim_of(Diagram.build(blocks)).truths["one"]["b"].name() == "one.value"


@pytest.mark.parametrize("late", ["first", "last"])
def test_two_certificates_of_one_loop_may_not_state_one_name_with_two_values(late: str) -> None:
    blocks = {"plant": Store(), "one": States(name="b"), "two": States(name="b", value=7), "reads": Reads()}
    if late == "first":
        blocks = dict(reversed(blocks.items()))
    diagram = Diagram.build(blocks, {"reads.z": "one.z"})
    with pytest.raises(NotApplicableError, match=r"the certificates of (one and two|two and one) state different"):
        claim_of(diagram)


@pytest.mark.parametrize("seed", range(6))
def test_statements_of_certificates_in_two_loops_are_distinguished_in_any_order(seed: int) -> None:
    names = ["plant1", "one1", "reads1", "plant2", "one2", "reads2"]
    kinds: dict[str, Any] = {"plant": Store, "one": lambda: States(name="b"), "reads": Reads}
    order = np.random.default_rng(seed).permutation(names)
    blocks = {str(name): kinds[name[:-1]]() for name in order}
    wires = {f"one{i}.y": f"plant{i}.y" for i in (1, 2)} | {f"reads{i}.z": f"one{i}.z" for i in (1, 2)}
    claim = claim_of(Diagram.build(blocks, wires))
    read = {part.block: str(part.certificate.storage[0].weight) for part in claim.parts if part.block[:5] == "reads"}
    assert read == {"reads1": "one1.value", "reads2": "one2.value"}


def test_a_stated_truth_may_not_have_the_name_of_a_controllers_output() -> None:
    blocks = {"plant": Store(), "one": States(name="z"), "two": States(name="c")}
    text = "the certificate of one states it, and two has an output two.z"
    assert text in verify(Diagram.build(blocks)).reason


def test_a_source_is_no_way_from_one_loop_to_another() -> None:
    class Clock(AbstractBlock):
        side = Side.SOURCE
        inputs = (TIME,)
        outputs = (Output("y"),)

        def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
            return Equations(outputs={"y": u.t})

    diagram = Diagram.build({"clock": Clock(), "one": States(), "two": States()})
    assert distances(diagram, "one") == {"one": 0}


def test_a_condition_that_a_source_states_counts() -> None:
    class Goal(AbstractBlock):
        side = Side.SOURCE
        outputs = (Output("g"),)
        height: Scalar = Positive(default=2.0)

        def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
            return Equations(outputs={"g": p.height})

        def conditions(self, p: Signals, truth: Signals) -> Sequence[Condition]:
            return (Inequality("height < 1", 1 - p.height, "the goal can be reached"),)

    verdict = verify(Diagram.build({"plant": Store(), "goal": Goal()}))
    assert [item.name for item in verdict.conditions if not item.holds] == ["goal: height < 1"]
    assert verify(Diagram.build({"plant": Store(), "goal": Goal(height=0.5)})).outcome == "proved"
