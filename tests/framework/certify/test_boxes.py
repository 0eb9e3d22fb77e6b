"""The boxes of a common Lyapunov function, in all forms that an author can write."""

from __future__ import annotations

from typing import ClassVar

import casadi as ca
import pytest

from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.block.certificate import Certificate, CommonLyapunov, Square
from dmframe.block.port import Access, Input, Output, Side, State
from dmframe.certify import verify
from dmframe.diagram import Diagram

SIZES = [((0, 2), (0, 2)), ((2, 2), (1, 2)), ((1, 3), (1, 3)), ((1, 1), (1, 1)), ((1, 2), (2, 2))]


class Plant(AbstractBlock):
    """dy = v."""

    side = Side.PLANT
    inputs = (Input("v"),)
    outputs = (Output("y", access=Access.MEASURED),)
    states = (State("y"),)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"y": x.y}, rates={"y": u.v})

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        return Certificate(storage=(Square(x.y),), supply=x.y * u.v)


class Law(AbstractBlock):
    """v = -y."""

    inputs = (Input("y"),)
    outputs = (Output("v", access=Access.COMMANDED),)
    boxes: ClassVar[tuple[tuple[int, int], tuple[int, int]]] = ((1, 2), (1, 2))

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"v": -u.y})

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        return Certificate(dissipation=(Square(u.y),), supply=u.y * u.y)

    def conditions(self, p: Signals, truth: Signals) -> tuple[CommonLyapunov, ...]:
        a, b = (ca.SX.ones(*size) for size in self.boxes)
        return (CommonLyapunov("a box", a, b, "a paper"),)


@pytest.mark.parametrize("sizes", SIZES)
def test_a_malformed_box_is_the_fault_of_the_block_that_states_it(
    sizes: tuple[tuple[int, int], tuple[int, int]], monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(TypeError, match="rows of 2 numbers, a lower and an upper end"):
        CommonLyapunov("a box", *(ca.SX.ones(*size) for size in sizes), "a paper")
    monkeypatch.setattr(Law, "boxes", sizes)
    verdict = verify(Diagram.build({"law": Law(), "plant": Plant()}))
    assert verdict.outcome == "not_applicable"
    assert "law" in verdict.reason
    assert "CommonLyapunov 'a box': expected" in verdict.reason


def test_a_box_of_one_row_a_joint_is_taken() -> None:
    for rows in (1, 3):
        CommonLyapunov("a box", ca.SX.ones(rows, 2), ca.SX.ones(rows, 2), "a paper")
