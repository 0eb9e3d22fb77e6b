"""From V to the last statement of the theorem: boundedness, convergence, small gain; each step with a seeded fault."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from scalar_blocks import scalar_loop

from dmframe.block.certificate import Assumption, Certificate, Consumed, Square, StableLinear
from dmframe.certify import verify
from dmframe.exact import ZeroDivision
from dmframe.graph.graph import Graph


def concluded(verdict) -> set[str]:
    return {item.signal for item in verdict.statements if item.concludes}


def reported(verdict, reports: str) -> dict[str, tuple[str, ...]]:
    return {item.signal: item.assumes for item in verdict.statements if item.says == reports}


THEOREMS = {
    "theorem_1": {"x - x_d", "d(x - x_d)/dt"},
    "theorem_2": {"x - x_d", "d(x - x_d)/dt", "x_o - x", "d(x_o - x)/dt"},
    "theorem_3": {"x - x_d", "d(x - x_d)/dt", "x_o - x", "d(x_o - x)/dt"},
    "theorem_4": {"x - x_d", "d(x - x_d)/dt"},
    "arm2_joint": {"q - q_d", "d(q - q_d)/dt"},
    "torque_direct_pi": {"q - q_d", "d(q - q_d)/dt"},
}


@pytest.mark.parametrize("graph", THEOREMS)
def test_each_theorem_ends_in_its_conclusion_with_nothing_open(graph):
    verdict = verify(Graph.read(graph, []).diagram)
    assert verdict.outcome == "proved"
    assert concluded(verdict) == THEOREMS[graph]
    assert verdict.states is not None
    assert verdict.states.open == ()
    assert verdict.stable
    uses_a_jacobian = "torque" not in graph and "joint" not in graph
    assert any("full row rank" in item.text for item in verdict.assumptions) == uses_a_jacobian


def test_the_conclusion_of_a_task_assumes_the_rank_that_it_uses():
    verdict = verify(Graph.read("theorem_3", []).diagram)
    (conclusion,) = (item for item in verdict.statements if item.signal == "x - x_d" and item.concludes)
    assert conclusion.assumes == ("J_hat keeps full row rank, uniformly",)


def test_the_servos_true_gains_bound_the_command_without_a_box_on_the_estimates():
    changes = ["inverse.w_P_box=null", "inverse.w_I_box=null", "inverse.w_box=null"]
    verdict = verify(Graph.read("theorem_4", changes).diagram)
    assert verdict.outcome == "proved"
    assert "q_c - q_tie" in reported(verdict, "is bounded")
    assert not any("exponentially stable" in item.text for item in verdict.assumptions)


@pytest.mark.parametrize("name", ["torque_indirect_pi", "ur10_slow_sampled", "ur10_posture"])
def test_a_proof_of_a_part_is_not_called_stable(name: str) -> None:
    verdict = verify(Graph.read(name, []).diagram)
    assert (verdict.outcome, verdict.stable) == ("proved", False)


def test_indirect_adaptation_does_not_call_the_robot_stable():
    verdict = verify(Graph.read("torque_indirect_pi", []).diagram)
    assert verdict.outcome == "proved"
    assert concluded(verdict) == set()
    assert verdict.states is not None
    assert {"arm.q", "arm.dq", "servo.q_c"} <= set(verdict.states.open)
    assert any("exists for all time" in item.text and "arm.dq" in item.text for item in verdict.assumptions)


def test_a_posture_task_that_reads_q_leaves_the_self_motion_open():
    verdict = verify(Graph.read("ur10_posture", []).diagram)
    assert verdict.states is not None
    assert "arm.q" in verdict.states.open


def test_states_that_v_does_not_weigh_and_that_may_escape_are_listed():
    loop = scalar_loop(
        "x w y",
        lambda x, u, p: {"x": -x.x + x.y * x.y * x.w, "w": -x.y * x.y * x.x, "y": x.y * x.y},
        lambda x, u, p: Certificate(storage=(Square(x.x), Square(x.w)), dissipation=(Square(x.x),)),
    )
    verdict = verify(loop)
    assert verdict.states is not None
    assert verdict.states.open == ("toy.y",)
    assert reported(verdict, "goes to zero") == {"x": ("the derivative of x is bounded",)}
    assert any("exists for all time" in item.text and "toy.y" in item.text for item in verdict.assumptions)


def test_a_divisor_that_holds_a_state_is_listed():
    loop = scalar_loop(
        "x w y",
        lambda x, u, p: {"x": -x.x + x.w / (1 - x.y), "w": -x.x / (1 - x.y), "y": 1},
        lambda x, u, p: Certificate(storage=(Square(x.x), Square(x.w)), dissipation=(Square(x.x),)),
    )
    assert any("stays away from zero" in item.text for item in verify(loop).assumptions)


def test_divisors_that_no_random_point_decides_leave_the_claim_open(monkeypatch):
    def vanishing(*_):
        raise ZeroDivision("a denominator vanishes")

    monkeypatch.setattr("dmframe.certify.divisors._unlisted", vanishing)
    loop = scalar_loop("x", lambda x, u, p: {"x": -x.x}, lambda x, u, p: Certificate((Square(x.x),), (Square(x.x),)))
    verdict = verify(loop)
    assert verdict.outcome == "not_applicable"
    assert "exact test of the divisors: a denominator vanishes at every random point" in verdict.reason


def test_what_turns_is_bounded_where_only_its_sine_is_felt():
    verdict = verify(
        scalar_loop(
            "x w y",
            lambda x, u, p: {"x": -x.x + ca.sin(x.y) * x.w, "w": -ca.sin(x.y) * x.x, "y": 1 + x.x},
            lambda x, u, p: Certificate(storage=(Square(x.x), Square(x.w)), dissipation=(Square(x.x),)),
        )
    )
    assert verdict.states is not None
    assert (verdict.states.unfelt, verdict.states.open) == (("toy.y",), ())
    assert reported(verdict, "goes to zero")["x"] == ()
    open_one = verify(
        scalar_loop(
            "x w y",
            lambda x, u, p: {"x": -x.x + x.y * x.w, "w": -x.y * x.x, "y": 1 + x.x},
            lambda x, u, p: Certificate(storage=(Square(x.x), Square(x.w)), dissipation=(Square(x.x),)),
        )
    )
    assert open_one.states is not None
    assert open_one.states.open == ("toy.y",)


def _driven(rate, rest, otherwise=()):
    """X' = -x is proved; z' = rest(z, x), with a StableLinear that declares the linear part `rate`."""
    return verify(
        scalar_loop(
            "x z",
            lambda x, u, p: {"x": -x.x, "z": rest(x, p)},
            lambda x, u, p: Certificate(
                storage=(Square(x.x),),
                dissipation=(Square(x.x),),
                linear=(StableLinear((x.z,), ((rate(x, p),),), (x.z,), otherwise),),
            ),
        )
    )


def test_a_stable_equation_with_a_bounded_input_bounds_its_state_and_a_vanishing_one_takes_it_to_zero():
    verdict = _driven(lambda x, p: -p.k, lambda x, p: -p.k * x.z + x.x)
    assert reported(verdict, "is bounded")["z"] == ()
    assert "z" in reported(verdict, "goes to zero")
    only_bounded = _driven(lambda x, p: -p.k, lambda x, p: -p.k * x.z + x.x + 1)
    assert "z" in reported(only_bounded, "is bounded")
    assert "z" not in reported(only_bounded, "goes to zero")


def test_a_stated_consequence_of_a_driven_signal_has_to_follow():
    verdict = verify(
        scalar_loop(
            "x z y",
            lambda x, u, p: {"x": -x.x, "z": -p.k * x.z + x.x, "y": 1.0},
            lambda x, u, p: Certificate(
                storage=(Square(x.x),), dissipation=(Square(x.x),), linear=(StableLinear((x.z,), ((-p.k,),), (x.y,)),)
            ),
        )
    )
    assert "y" not in reported(verdict, "is bounded")
    assert verdict.states is not None
    assert verdict.states.unfelt == ("toy.y",)


@pytest.mark.parametrize(
    ("rate", "rest"),
    [
        (lambda x, p: p.k, lambda x, p: p.k * x.z + x.x),  # unstable
        (lambda x, p: -p.k, lambda x, p: -p.k * x.z + x.z * x.x),  # the remainder moves with z
        (lambda x, p: -p.k, lambda x, p: p.k * x.z + x.x),  # the linear part differs
        (lambda x, p: 0 * p.k, lambda x, p: x.x),  # an integrator
        (lambda x, p: -x.z, lambda x, p: -x.z * x.z + x.x),  # a rate that is a state without a box
    ],
    ids=["unstable", "fed back", "another sign", "integrator", "moving rate"],
)
def test_a_false_claim_about_what_drives_a_state_leaves_it_open(rate, rest):
    verdict = _driven(rate, rest)
    assert "z" not in reported(verdict, "is bounded")
    assert "z" not in reported(verdict, "goes to zero")


def test_a_property_of_a_driven_signal_that_was_not_shown_requires_its_conditions():
    text = "it is known that z stays bounded"
    verdict = _driven(lambda x, p: -p.k, lambda x, p: p.k * x.z + x.x, (Assumption(text),))
    assert text in {item.text for item in verdict.assumptions}


def _cascade(weight, *, task):
    """X' = -weight x; one block declares the dissipation weight |x|^2, and another has the cross term |x|^2."""
    from typing import Any, final

    from dmframe.block import AbstractBlock, Equations
    from dmframe.block.port import Input, Output, State
    from dmframe.diagram import Diagram

    @final
    class Dominating(AbstractBlock):
        """Its state increases or decreases."""

        outputs = (Output("x"),)
        states = (State("x"),)

        def equations(self, u: Any, x: Any, p: Any) -> Equations:
            return Equations(outputs={"x": x.x}, rates={"x": (0.0 - weight) * x.x})

        def certificate(self, u: Any, x: Any, p: Any, truth: Any) -> Certificate:
            return Certificate(storage=(Square(x.x),), dissipation=(Square(x.x, weight),), dominates=(1,), task=task)

    @final
    class Taker(AbstractBlock):
        """A cascade y' = -y + x."""

        inputs = (Input("x"),)
        states = (State("y"),)

        def equations(self, u: Any, x: Any, p: Any) -> Equations:
            return Equations(rates={"y": -x.y + u.x})

        def certificate(self, u: Any, x: Any, p: Any, truth: Any) -> Certificate:
            spent = (Square(x.y, 3 / 4), Square(x.y / 2 - u.x))
            return Certificate(storage=(Square(x.y),), dissipation=spent, consumes=Consumed(u.x, 1))

    return verify(Diagram.build({"dominating": Dominating(), "taker": Taker()}))


def test_a_dissipation_whose_weight_in_v_is_one_has_no_kappa_to_dominate_with():
    assert _cascade(0.5, task=False).outcome == "proved"
    poor = _cascade(0.5, task=True)
    assert poor.outcome == "not_applicable"
    assert "with its weight 1 in V" in poor.reason
    assert _cascade(1.5, task=True).outcome == "proved"


def test_growth_is_never_proved_to_vanish():
    grown = _cascade(-1.0, task=False)
    assert grown.outcome == "not_applicable"
    assert "weight" in grown.reason


def test_two_loops_in_one_diagram_each_dominate_their_own_cross_term():
    from dmframe.diagram import Diagram

    one = Graph.read("known_tracking_pi", []).diagram
    blocks = {f"{name}_{k}": block for k in (1, 2) for name, block in one.blocks.items()}
    wires = {}
    for (name, port), source in one.sources.items():
        if hasattr(source, "port"):
            for k in (1, 2):
                wires[f"{name}_{k}.{port}"] = f"{source.block}_{k}.{source.port}"
    verdict = verify(Diagram.build(blocks, wires, one.robot))
    assert verdict.outcome == "proved", verdict.reason
    alone = verify(one)
    assert verdict.kappa is not None
    assert alone.kappa is not None
    assert verdict.kappa.least == alone.kappa.least
    assert len(concluded(verdict)) == 2 * len(concluded(alone))


def test_a_linear_combination_is_found_and_none_is_invented():
    """The computed coefficients equal those of NumPy's least squares; a product has none."""
    from dmframe.certify.claim import claim_of
    from dmframe.certify.limits import Combinations, Vanishing

    loop = scalar_loop(
        "x w",
        lambda x, u, p: {"x": -x.x, "w": -x.w},
        lambda x, u, p: Certificate(storage=(Square(x.x), Square(x.w)), dissipation=(Square(x.x), Square(x.w))),
    )
    claim = claim_of(loop)
    field = Combinations(claim, 2**127 - 1, 7)
    x, w = (part.symbol for part in loop.loop.controller)
    k = loop.loop.parameters[0].symbol
    known = [Vanishing("x", x, True), Vanishing("w", w, True)]
    assert field.made_of(3 * x - k * w, known) == ["x", "w"]
    assert field.made_of(k * x, known) == ["x"]
    assert field.made_of(x * w, known) is None
    assert field.made_of(x + 1, known) is None
    rows = np.random.default_rng(0).normal(size=(9, 2))
    solved, *_ = np.linalg.lstsq(rows, rows @ np.array([3.0, -2.0]), rcond=None)
    assert np.allclose(solved, [3.0, -2.0])
