"""Outputs that replace a signal between controller and plant."""

from __future__ import annotations

from typing import Any

import pytest

from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.block.port import Access, Input, Output, Side, State
from dmframe.common.errors import DmframeError
from dmframe.diagram import Diagram
from dmframe.diagram.wiring import Wire

PLANT: Any = Side.PLANT


class Law(AbstractBlock):
    """v = -y."""

    inputs = (Input("y"),)
    outputs = (Output("v", access=Access.COMMANDED),)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations({"v": -u.y})


class Cart(AbstractBlock):
    """dy = v."""

    side = PLANT
    inputs = (Input("v"),)
    outputs = (Output("y", access=Access.MEASURED),)
    states = (State("y"),)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations({"y": x.y}, {"y": u.v})


class Watch(AbstractBlock):
    """Reads the true y, on the plant's side."""

    side = PLANT
    inputs = (Input("y"),)
    outputs = (Output("seen"),)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations({"seen": u.y})


class Sensor(AbstractBlock):
    """y_m = 2 y."""

    side = PLANT
    inputs = (Input("y"),)
    outputs = (Output("y_m", access=Access.MEASURED, instead_of="y"),)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations({"y_m": 2 * u.y})


class Line(AbstractBlock):
    """Halves a command, and replaces one without a source."""

    side = PLANT
    inputs = (Input("v"), Input("w", optional=True))
    outputs = (Output("half", instead_of="v"), Output("w_half", instead_of="w"))

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations({"half": u.v / 2, "w_half": u.w / 2})


def wired(wires: dict[str, str] | None = None, **blocks: AbstractBlock) -> dict[str, str]:
    diagram = Diagram.build({"law": Law(), "cart": Cart(), "watch": Watch(), **blocks}, wires)
    return {
        f"{block}.{port}": f"{source.block}.{source.port}"
        for (block, port), source in diagram.sources.items()
        if isinstance(source, Wire)
    }


PLAIN = {"law.y": "cart.y", "cart.v": "law.v", "watch.y": "cart.y"}


def test_without_one_all_signals_are_unchanged() -> None:
    assert wired() == PLAIN


def test_a_measured_one_replaces_the_signal_for_controllers_and_not_for_the_plant() -> None:
    assert wired(sensor=Sensor()) == {**PLAIN, "law.y": "sensor.y_m", "sensor.y": "cart.y"}


def test_any_other_replaces_the_signal_for_the_plant() -> None:
    assert wired(line=Line()) == {**PLAIN, "cart.v": "line.half", "line.v": "law.v"}


def test_several_are_a_chain_in_the_order_of_the_file() -> None:
    found = wired(b=Sensor(), a=Sensor(), two=Line(), one=Line())
    chain = {"b.y": "cart.y", "a.y": "b.y_m", "law.y": "a.y_m", "two.v": "law.v", "one.v": "two.half"}
    assert found == {**PLAIN, **chain, "cart.v": "one.half"}


def test_a_wire_to_the_signal_leads_through_them_and_one_to_a_replacement_is_kept_as_written() -> None:
    through = wired({"law.y": "cart.y", "sensor.y": "cart.y"}, sensor=Sensor())
    assert through["law.y"] == "sensor.y_m"
    word = wired({"watch.y": "sensor.y_m"}, sensor=Sensor())
    assert word["watch.y"] == "sensor.y_m"
    first = wired({"law.y": "b.y_m"}, b=Sensor(), a=Sensor())
    assert (first["law.y"], first["a.y"]) == ("b.y_m", "b.y_m")


def test_each_replaces_the_signal_that_drives_it_not_all_of_that_name() -> None:
    two = {"other": Law(), "wheel": Cart(), "sensor": Sensor()}
    wires = {"law.y": "cart.y", "other.y": "wheel.y", "cart.v": "law.v", "wheel.v": "other.v", "watch.y": "cart.y"}
    found = wired({**wires, "sensor.y": "wheel.y"}, **two)
    assert (found["law.y"], found["other.y"]) == ("cart.y", "sensor.y_m")


def test_a_diagram_states_the_direction_of_signals() -> None:
    diagram = Diagram.build({"law": Law(), "cart": Cart(), "b": Sensor(), "a": Sensor(), "line": Line()})
    reported = {f"{way.origin.block}.{way.origin.port}": [wire.block for wire in way.through] for way in diagram.ways}
    assert reported == {"cart.y": ["b", "a"], "law.v": ["line"]}
    assert [way.readers for way in diagram.ways] == [(("law", "y"),), (("cart", "v"),)]


def broken(**members: Any) -> type[AbstractBlock]:
    return type("Broken", (Sensor,), {"__module__": __name__, **members})


@pytest.mark.parametrize(
    ("members", "text"),
    [
        ({"outputs": (Output("y_m", instead_of="z"),)}, "the output y_m replaces z, which is not an input; choose"),
        (
            {"outputs": (Output("y_m", "3", instead_of="y"),)},
            "the output y_m replaces y, and has another shape or",
        ),
        ({"outputs": (Output("y_m", "", "m", instead_of="y"),)}, "replaces y, and has another shape or unit"),
        ({"side": Side.CONTROLLER}, "the output y_m replaces y, but the block is not a plant; declare it as one"),
        ({"inputs": (Output("y"),)}, "expected each of its inputs to be an Input, found Output(name='y'"),
        (
            {"outputs": (Output("y_m", notice=3),)},
            "expected the notice of the output 'y_m' in outputs to be a text, found 3",
        ),
    ],
)
def test_what_a_block_declares_of_it_has_to_fit(members: dict[str, Any], text: str) -> None:
    with pytest.raises(DmframeError) as caught:
        Diagram.build({"law": Law(), "cart": Cart(), "own": broken(**members)()})
    assert text in str(caught.value)


class Late(AbstractBlock):
    """v_late = v of the previous sample."""

    side = PLANT
    inputs = (Input("v"),)
    outputs = (Output("v_late", instead_of="v"),)
    states = (State("line", sampled=True),)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations({"v_late": x.line}, next={"line": u.v})


class Mean(AbstractBlock):
    """sent = v / 2: another command than the one with the plant's name for it."""

    inputs = (Input("v"),)
    outputs = (Output("sent", access=Access.COMMANDED),)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations({"sent": u.v / 2})


def test_a_channel_acts_on_the_command_that_the_wires_give_the_plant() -> None:
    blocks = {"law": Law(), "mean": Mean(), "cart": Cart(), "late": Late()}
    found = Diagram.build(blocks, {"cart.v": "mean.sent"})
    assert found.sources["late", "v"] == Wire("mean", "sent")
    assert found.sources["cart", "v"] == Wire("late", "v_late")
    assert found.sources["mean", "v"] == Wire("law", "v")


def test_a_channel_that_the_plant_bypasses_is_refused() -> None:
    blocks = {"law": Law(), "mean": Mean(), "cart": Cart(), "late": Late()}
    with pytest.raises(
        DmframeError, match=r"late\.v: expected a command that the plant reads, found law\.v.*late\.v: mean\.sent"
    ):
        Diagram.build(blocks, {"cart.v": "mean.sent", "late.v": "law.v"})
