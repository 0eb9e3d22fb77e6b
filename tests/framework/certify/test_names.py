"""Every statement about a signal uses a unique name."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar, final

import casadi as ca
import pytest
from scalar_blocks import scalar_loop

from dmframe.block import AbstractBlock, Equations
from dmframe.block.certificate import Certificate, Square
from dmframe.block.port import Side, State
from dmframe.certify import verify
from dmframe.certify.claim import claim_of
from dmframe.diagram import Diagram


def reported(verdict: Any, reports: str) -> list[str]:
    return [item.signal for item in verdict.statements if item.says == reports]


@pytest.mark.parametrize("other", ["dx", "x_dot", "y"])
def test_the_rate_of_a_state_never_takes_the_name_of_a_signal(other):
    verdict = verify(
        scalar_loop(
            f"x {other}",
            lambda x, u, p: {"x": -x.x, other: 0 * x.x},
            lambda x, u, p: Certificate(storage=(Square(x.x), Square(getattr(x, other))), dissipation=(Square(x.x),)),
        )
    )
    assert verdict.outcome == "proved"
    assert reported(verdict, "goes to zero") == ["x", "d(x)/dt" if other == "dx" else "dx"]


def test_a_signal_by_the_name_of_a_rate_in_another_block_is_not_stated_to_vanish():
    filtered = _block(
        "x", lambda x: {"x": -x.x}, lambda x: Certificate((Square(x.x),), (Square(x.x),)), Side.CONTROLLER
    )
    going = _block("dx", lambda x: {"dx": 0 * x.dx}, lambda x: Certificate((Square(x.dx),), task=True))
    verdict = verify(Diagram.build({"arm": going, "filter": filtered}))
    assert verdict.outcome == "proved"
    assert reported(verdict, "goes to zero") == ["x", "d(x)/dt"]
    assert not any(item.concludes for item in verdict.statements)


def test_two_vectors_that_nothing_prints_are_distinguished():
    def claim(x: Any, u: Any, p: Any) -> Certificate:
        e = ca.erf(x.y)
        storage = (Square(e * (x.x + x.z)), Square(x.x), Square(x.y))
        return Certificate(storage, (Square(e * ((2 * x.x + x.z) - (x.x + x.z))),))

    def rates(x: Any, u: Any, p: Any) -> dict[str, Any]:
        e = ca.erf(x.y)
        return {"x": -x.x * e * e, "y": 0 * x.y, "z": x.x * e * e}

    verdict = verify(scalar_loop("x y z", rates, claim))
    assert verdict.outcome == "proved"
    assert reported(verdict, "is bounded") == ["expression 1 of y, x, z (toy)", "x", "y"]
    assert reported(verdict, "goes to zero") == ["expression 2 of y, x, z (toy)"]


def test_of_two_vectors_that_differ_far_away_only_neither_replaces_the_other():
    def claim(x: Any, u: Any, p: Any) -> Certificate:
        near = ca.erf(x.x * x.y)
        far = near + ca.fmax(x.x * x.y - 1000, 0)
        return Certificate((Square(x.x), Square(x.y), Square(near), Square(far)), (Square(x.x),))

    loop = scalar_loop("x y", lambda x, u, p: {"x": 0 * x.x, "y": 0 * x.y}, claim)
    names = [term.of for term in claim_of(loop).parts[0].certificate.storage]
    assert names == ["x", "y", "expression 1 of x, y (toy)", "expression 2 of x, y (toy)"]


def test_plant_states_of_one_name_are_printed_with_their_blocks():
    def claim(x: Any) -> Certificate:
        return Certificate((Square(x.x),), (Square(x.x),))

    one = _block("x q", lambda x: {"x": -x.x, "q": 0 * x.q}, claim)
    two = _block("x q", lambda x: {"x": -x.x, "q": 1 + 0 * x.q}, claim)
    verdict = verify(Diagram.build({"one": one, "two": two}))
    assert verdict.outcome == "proved"
    assert reported(verdict, "is bounded") == ["x (one)", "x (two)", "q (one)"]


def _block(
    names: str, rates: Callable[[Any], Any], claim: Callable[[Any], Certificate], its: Side = Side.PLANT
) -> AbstractBlock:
    @final
    class Toy(AbstractBlock):
        """Certificate as given by the arguments."""

        side: ClassVar[Side] = its
        states: ClassVar[tuple[State, ...]] = tuple(State(name) for name in names.split())

        def equations(self, u: Any, x: Any, p: Any) -> Equations:
            return Equations(rates=rates(x))

        def certificate(self, u: Any, x: Any, p: Any, truth: Any) -> Certificate:
            return claim(x)

    return Toy()
