"""False theorems that `verify` once proved: each is a loop with a known solution."""

from __future__ import annotations

from typing import Any, final

import casadi as ca
import pytest
from scalar_blocks import scalar_loop

from dmframe.block import AbstractBlock, Equations
from dmframe.block.certificate import Assumption, Certificate, Consumed, Square, StableLinear
from dmframe.block.parameter import Box, Interval
from dmframe.block.port import TIME, Access, Input, Output, Side, State
from dmframe.certify import Verdict, verify
from dmframe.diagram import Diagram


def reports(verdict: Verdict) -> set[tuple[str, str]]:
    return {(item.signal, item.says) for item in verdict.statements if not item.assumes}


def assumed(verdict: Verdict) -> str:
    return "; ".join(item.text for item in verdict.assumptions)


@final
class Dominating(AbstractBlock):
    """v' = -v + 1.5 y."""

    side = Side.PLANT
    inputs = (Input("y"),)
    outputs = (Output("v_out", access=Access.MEASURED),)
    states = (State("v"),)

    def equations(self, u: Any, x: Any, p: Any) -> Equations:
        return Equations(outputs={"v_out": x.v}, rates={"v": -x.v + 1.5 * u.y})

    def certificate(self, u: Any, x: Any, p: Any, truth: Any) -> Certificate:
        square = (Square(x.v),)
        return Certificate(square, square, supply=1.5 * x.v * u.y, dominates=(ca.DM.ones(4, 1),), task=True)


@final
class Eater(AbstractBlock):
    """z' = -1.25 z + 1.5 v."""

    inputs = (Input("v_out"),)
    outputs = (Output("y", access=Access.COMMANDED),)
    states = (State("z"),)

    def equations(self, u: Any, x: Any, p: Any) -> Equations:
        return Equations(outputs={"y": x.z}, rates={"z": -1.25 * x.z + 1.5 * u.v_out})

    def certificate(self, u: Any, x: Any, p: Any, truth: Any) -> Certificate:
        v = u.v_out
        spent = (Square(1.5 * v - x.z), Square(x.z, 0.25))
        eaten = Consumed(ca.vertcat(v, v, v, v), 9 / 16)
        return Certificate((Square(x.z),), spent, supply=-1.5 * v * x.z, consumes=eaten)


def test_one_square_does_not_dominate_four_elements() -> None:
    """[[-1, 1.5], [1.5, -1.25]] has the eigenvalue 0.38."""
    verdict = verify(Diagram.build({"a": Dominating(), "b": Eater()}))
    assert verdict.outcome == "not_applicable"
    assert "expected the dominating squares and their factors to be of one length" in verdict.reason


def test_a_sentence_does_not_make_an_equation_stable() -> None:
    """z' = 2 z + x is unbounded."""
    sure = (Assumption("the sun rises", "an almanac"),)
    verdict = verify(
        scalar_loop(
            "x z",
            lambda x, u, p: {"x": -p.k * x.x, "z": p.k * x.z + x.x},
            lambda x, u, p: Certificate(
                (Square(x.x),), (Square(x.x, p.k),), linear=(StableLinear((x.z,), ((p.k,),), (x.z,), sure),)
            ),
        )
    )
    assert not {signal for signal, _ in reports(verdict)} & {"z"}
    assert verdict.states is not None
    assert verdict.states.open == ("toy.z",)


@final
class Pushed(AbstractBlock):
    """An estimate that t sin t drives against its box; y follows this rate, so its amplitude is t."""

    inputs = (TIME,)
    states = (State("x"), State("theta", box="theta_box"), State("y"))
    theta_box: Box = Interval()

    def equations(self, u: Any, x: Any, p: Any) -> Equations:
        push = u.t * ca.sin(u.t)
        return Equations(rates={"x": -x.x, "theta": push, "y": push - (x.y - x.theta)})

    def certificate(self, u: Any, x: Any, p: Any, truth: Any) -> Certificate:
        return Certificate((Square(x.x),), (Square(x.x),), linear=(StableLinear((x.y - x.theta,), ((-1,),), (x.y,)),))


def test_what_a_projection_takes_away_is_bounded_only_where_the_rate_is() -> None:
    verdict = verify(Diagram.build({"a": Pushed(theta_box=(-1.0, 1.0))}))
    assert ("y", "is bounded") not in reports(verdict)
    assert verdict.states is not None
    assert "a.y" in verdict.states.open


def test_a_path_that_the_proof_differentiates_late_has_to_be_smooth_too() -> None:
    """Pulses of 2 + sin t for 1/(1 + t)^2 at each whole second: x does not reach zero, and r does not vanish."""
    verdict = verify(
        scalar_loop(
            "x z",
            lambda x, u, p: {"x": -x.x * u.r * u.r, "z": u.r - x.z},
            lambda x, u, p: Certificate(
                (Square(x.x),), (Square(x.x * u.r),), linear=(StableLinear((x.z - u.r,), ((-1,),), (x.z,)),)
            ),
            r=lambda t: ((t - ca.floor(t)) * (1 + t) ** 2 < 1) * (2 + ca.sin(t)),
        )
    )
    assert not {signal for signal, what in reports(verdict) if what == "goes to zero"}


def test_a_path_that_jumps_between_constants_is_not_called_constant() -> None:
    verdict = verify(
        scalar_loop(
            "x",
            lambda x, u, p: {"x": -x.x * u.r * u.r},
            lambda x, u, p: Certificate((Square(x.x),), (Square(x.x * u.r),)),
            r=lambda t: 2 * ((t - ca.floor(t)) * (1 + t) ** 2 < 1),
        )
    )
    assert "is constant" not in assumed(verdict)
    assert not {signal for signal, what in reports(verdict) if what == "goes to zero"}


def test_a_number_of_derivatives_has_no_end() -> None:
    @final
    class Deep(AbstractBlock):
        """z' = -z + the seventh derivative of r."""

        inputs = (
            Input("r"),
            *(Input(f"r{k}", unit=f"1/s^{k}", derivative_of=f"r{k - 1}" if k > 1 else "r") for k in range(1, 8)),
        )
        states = (State("x"), State("z", unit="1/s^7"))

        def equations(self, u: Any, x: Any, p: Any) -> Equations:
            return Equations(rates={"x": -x.x, "z": -x.z + u.r7})

        def certificate(self, u: Any, x: Any, p: Any, truth: Any) -> Certificate:
            return Certificate((Square(x.x),), (Square(x.x),), linear=(StableLinear((x.z,), ((-1,),), (x.z,)),))

    @final
    class Path(AbstractBlock):
        """It is bounded with six derivatives."""

        side = Side.SOURCE
        inputs = (TIME,)
        outputs = (Output("r"),)

        def equations(self, u: Any, x: Any, p: Any) -> Equations:
            return Equations(outputs={"r": ca.sin(u.t * u.t / 2) / (1 + u.t * u.t) ** 2.5})

    verdict = verify(Diagram.build({"path": Path(), "toy": Deep()}))
    assert "path.r and its first 7 derivatives are bounded" in assumed(verdict)


@final
class Mass(AbstractBlock):
    """A mass whose speed is measured."""

    side = Side.PLANT
    inputs = (Input("f", unit="1/s^2"),)
    outputs = (
        Output("y", access=Access.MEASURED),
        Output("vel", unit="1/s", access=Access.MEASURED, derivative_of="y"),
    )
    states = (State("q"), State("v", unit="1/s"))

    def equations(self, u: Any, x: Any, p: Any) -> Equations:
        return Equations(outputs={"y": x.q, "vel": x.v}, rates={"q": x.v, "v": u.f})

    def certificate(self, u: Any, x: Any, p: Any, truth: Any) -> Certificate:
        squares = (Square(x.v + x.q), Square(x.q))
        return Certificate(squares, squares, supply=(x.v + x.q) * (u.f + 2 * x.q + 2 * x.v))


@final
class Pd(AbstractBlock):
    """It differentiates the speed, whose derivative the diagram takes from the sensor."""

    inputs = (Input("y"), Input("dy", unit="1/s", derivative_of="y"))
    outputs = (Output("f", unit="1/s^2", access=Access.COMMANDED),)

    def equations(self, u: Any, x: Any, p: Any) -> Equations:
        return Equations(outputs={"f": -2 * u.y - 2 * u.dy})

    def certificate(self, u: Any, x: Any, p: Any, truth: Any) -> Certificate:
        f = self.equations(u, x, p).outputs["f"]
        return Certificate(supply=-(u.y + u.dy) * (f + 2 * u.y + 2 * u.dy))


def test_a_measured_rate_without_a_reader_is_listed() -> None:
    verdict = verify(Diagram.build({"arm": Mass(), "pd": Pd()}))
    assert verdict.outcome == "proved"
    assert "exact and without delay: arm.vel, arm.y" in assumed(verdict)


@pytest.mark.parametrize("power", [1, 2])
def test_what_a_claim_divides_by_is_listed(power: int) -> None:
    """1/x is e^t."""
    verdict = verify(
        scalar_loop(
            "x z",
            lambda x, u, p: {"x": -x.x, "z": -x.z},
            lambda x, u, p: Certificate(
                (Square(x.x),), (Square(x.x),), linear=(StableLinear((x.z,), ((-1,),), (x.z, 1 / x.x**power)),)
            ),
        )
    )
    assert "stays away from zero" in assumed(verdict)
