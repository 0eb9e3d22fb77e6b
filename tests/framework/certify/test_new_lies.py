"""False statements about limits, assumed inputs, errors, loads and filters, which must not be proved, and true ones."""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping
from typing import Any, final

import casadi as ca
import numpy as np
import pytest
import scipy
from scalar_blocks import scalar_loop

import dmframe as dm
from dmframe.block import AbstractBlock, Equations
from dmframe.block.certificate import Assumption, Barrier, Certificate, Potential, Square, StableLinear
from dmframe.block.port import TIME, Input, Output, Side, State
from dmframe.certify import Verdict, claim_of, verify
from dmframe.certify.smoothness import smoothness
from dmframe.diagram import Diagram
from dmframe.exact import random_prime, zero_test


def reports(verdict: Verdict, what: str) -> list[str]:
    return [item.signal for item in verdict.statements if item.says.startswith(what)]


# The width of a tube follows from V(0), which is enclosed.

WIDE = 1e9


def limited(stored: Callable[[Any], Any], start: float, slow: float, **uncertain: Any) -> Verdict:
    """A position q with a distance s from a reference; V contains a potential of s, and dV/dt dissipates a square."""

    def barrier(x: Any) -> Barrier:
        low, high, speed, rate, width = map(ca.SX, (-1.0, 1.0, 50.0, 3.0, 0.02))
        return Barrier(x.q, ca.SX(100), low, high, speed, rate, width)

    def rates(x: Any, u: Any, p: Any) -> Mapping[str, Any]:
        return {"q": barrier(x).reference + x.s, "s": -slow * x.s * ca.sqrt(1 + (x.s / WIDE) ** 2)}

    def claim(x: Any, u: Any, p: Any) -> Certificate:
        return Certificate((stored(x),), (Square(x.s, slow),), dominates=(ca.SX(1),), barriers=(barrier(x),))

    return verify(scalar_loop("q s", rates, claim), start={"toy.s": start}, **uncertain)


def test_a_potential_that_rounding_takes_for_zero_has_its_tube_all_the_same() -> None:
    def stored(x: Any) -> Potential:
        return Potential(x.s, ca.SX(WIDE), ca.SX(1))

    assert reports(limited(stored, 5.0, 1e-3), "stays between") == []  # V(0) = 12.5, for which the tube is too wide
    verdict = limited(stored, 0.5, 1.0)
    (reported,) = (item for item in verdict.statements if item.says.startswith("stays between"))
    assert reported.says == "stays between -1 and 1, but for at most 0.1444 beyond"  # sqrt(0.125 / 6)

    def moved(t: float, state: Any) -> list[float]:
        q, s = state
        return [float(min(50.0, 3 * (1 - q)) + s), -s]

    run = scipy.integrate.solve_ivp(moved, (0, 5), [0.0, 0.5], max_step=0.01)
    assert 1.03 < np.max(run.y[0]) < 1.1444


def test_no_tube_is_reported_where_a_source_steps_since_v_begins_again_there() -> None:
    made = {
        "dmframe": 1,
        "robot": "arm2",
        "clock": "continuous",
        "duration": "4 s",
        "start": {"q": [0.8, 0.5], "dq": [0.0, 0.0]},
        "blocks": {
            "path": {"type": "sinusoid", "center": [1.5, 0.5], "amplitude": [0, 0.2], "rate": [1, 1]},
            "task": {"type": "joint_tracking", "alpha_bar": 2},
            "safe": {"type": "safe_reference", "lower": -2, "upper": [1.2, 2], "speed": 2, "approach": 4},
            "model": {"type": "payload_regressor"},
            "dynamics": {"type": "dynamic_compensator", "Gamma": 10},
            "inverse": {"type": "pi_inverse", "Lambda": 0.1, "Lambda_I": 10, "w_I": 2},
            "servo": {"type": "pi_servo", "K_P": [60, 30], "K_I": [240, 120]},
            "arm": {"type": "loaded_manipulator", "viscous": [1, 0.5]},
            "load": {"type": "payload", "mass": [20.0], "at": [2.0]},
        },
        "wires": {"safe.dq_wish": "task.dq_r", "inverse.dq_r": "safe.dq_r"},
    }
    stepping = dm.load(made, name="stepping").verify().verdict
    assert stepping.outcome == "proved"
    assert reports(stepping, "stays between") == []
    del made["blocks"]["load"]  # type: ignore[attr-defined]
    assert reports(dm.load(made, name="still").verify().verdict, "stays between") == ["arm.q"]


# The text of a block's assumption about an input is not the block's own.


def driven(inputs: Callable[[Any], Any], growth: float, sources: Any = None) -> Verdict:
    def claim(x: Any, u: Any, p: Any) -> Certificate:
        otherwise = (Assumption("the sky is blue", "a poem"),)
        item = StableLinear((x.w,), ((ca.SX(-1),),), (x.w,), otherwise=otherwise, inputs=(inputs(x),))
        return Certificate((Square(x.y),), (Square(x.y),), linear=(item,))

    def rates(x: Any, u: Any, p: Any) -> Mapping[str, Any]:
        return {"y": -x.y, "v": growth * x.v, "w": -x.w + 2 * (x.w if sources is None else x.v)}

    return verify(scalar_loop("y v w", rates, claim))


def test_an_input_that_is_what_it_drives_bounds_nothing() -> None:
    verdict = driven(lambda x: 2 * x.w, 0.0)  # w grows like exp(t)
    assert "w" not in reports(verdict, "is bounded")
    assert verdict.states is not None
    assert "toy.w" in verdict.states.open


def test_what_is_assumed_of_an_input_is_that_it_stays_bounded_and_what_it_is_made_of() -> None:
    verdict = driven(lambda x: 2 * x.v, 1.0, sources=True)
    assert "w" in reports(verdict, "is bounded")
    text = "the input of the linear equation that drives w, which is made of toy.v, stays bounded"
    assert text in {item.text for item in verdict.assumptions}


def mixed(inputs: Callable[[Any], Any]) -> Verdict:
    """The linear subsystem of the sum w + v shares a state with its input 3 v; w' = -w + v and v' = v."""

    def claim(x: Any, u: Any, p: Any) -> Certificate:
        otherwise = (Assumption("v stays bounded", "a test"),)
        vectors = (x.w + x.v,)
        item = StableLinear(vectors, ((ca.SX(-1),),), vectors, otherwise=otherwise, inputs=(inputs(x),))
        return Certificate((Square(x.y),), (Square(x.y),), linear=(item,))

    return verify(scalar_loop("y v w", lambda x, u, p: {"y": -x.y, "v": x.v, "w": -x.w + x.v}, claim))


def test_an_input_may_read_a_state_of_what_it_drives_if_it_alone_does_not_bound_that() -> None:
    verdict = mixed(lambda x: 3 * x.v)
    assert "w + v" in reports(verdict, "is bounded")
    assert verdict.states is not None
    assert verdict.states.open == ()


@pytest.mark.parametrize("power", [1, 3])
def test_an_input_whose_states_bound_what_it_drives_bounds_nothing(power: int) -> None:
    """The same input, containing w: assuming it bounded would assume the conclusion."""
    verdict = mixed(lambda x: 3 * x.v + (x.w + x.v) ** power)
    assert "w + v" not in reports(verdict, "is bounded")
    assert verdict.states is not None
    assert {"toy.v", "toy.w"} <= set(verdict.states.open)


# A matrix that can never have full row rank does not make an error converge.


def ranked(R: Callable[[Any], Any]) -> Verdict:
    @final
    class Toy(AbstractBlock):
        """Only the first element of z vanishes."""

        outputs = (Output("R", "2 2", full_rank=True),)
        states = (State("y"), State("z", "2"))

        def equations(self, u: Any, x: Any, p: Any) -> Equations:
            return Equations({"R": R(x)}, {"y": -x.y, "z": ca.vertcat(-x.z[0], 0)})

        def certificate(self, u: Any, x: Any, p: Any, truth: Any) -> Certificate:
            return Certificate((Square(x.y), Square(x.z)), (Square(x.y), Square(x.z[0])), errors=(Square(x.z),))

    return verify(Diagram.build({"toy": Toy()}))


@pytest.mark.parametrize(
    "R",
    [
        lambda x: ca.blockcat([[1 + x.y**2, 1], [0, 0]]),
        lambda x: ca.blockcat([[1 + x.y**2 - x.y**2, 0], [0 * x.y, x.y - x.y]]),
    ],
    ids=["a row of zeros", "a difference that is zero"],
)
def test_a_matrix_that_cannot_have_full_rank_concludes_nothing(R: Callable[[Any], Any]) -> None:
    verdict = ranked(R)
    assert "z_1" in reports(verdict, "goes to zero")
    assert "z" not in reports(verdict, "goes to zero")


def test_an_error_that_is_identically_zero_is_none() -> None:
    def claim(x: Any, u: Any, p: Any) -> Certificate:
        return Certificate((Square(x.y),), (Square(x.y),), errors=(Square(x.y - x.y),))

    verdict = verify(scalar_loop("y", lambda x, u, p: {"y": -x.y}, claim))
    assert verdict.outcome == "not_applicable"
    assert "identically zero" in verdict.reason


# Loads that are not physically consistent.


def carrying(load: Callable[[Any], Any]) -> Verdict:
    @final
    class Load(AbstractBlock):
        """Ten parameters."""

        side = Side.SOURCE
        inputs = (TIME,)
        outputs = (Output("a_load", "10", steps=True),)

        def equations(self, u: Any, x: Any, p: Any) -> Equations:
            return Equations({"a_load": ca.densify(load(u.t))})

    made = {
        "dmframe": 1,
        "robot": "arm2",
        "clock": "continuous",
        "duration": "4 s",
        "blocks": {
            "path": {"type": "sinusoid", "center": [1.5, 0.5], "amplitude": [0, 0.2], "rate": [1, 1]},
            "task": {"type": "joint_tracking", "alpha_bar": 2},
            "model": {"type": "payload_regressor"},
            "dynamics": {"type": "dynamic_compensator", "Gamma": 10},
            "inverse": {"type": "pi_inverse", "Lambda": 0.1, "Lambda_I": 10, "w_I": 2},
            "servo": {"type": "pi_servo", "K_P": [60, 30], "K_I": [240, 120]},
            "arm": {"type": "loaded_manipulator", "viscous": [1, 0.5]},
        },
    }
    graph = dm.load(made, name="carrying")
    return verify(Diagram.build({**graph.diagram.blocks, "load": Load()}, robot=graph.robot))


def point(mass: float) -> Any:
    """A point mass at 0.1 m along x."""
    return ca.DM([mass, 0.1 * mass, 0, 0, 0, 0, 0.01 * mass, 0, 0, 0.01 * mass])


def test_a_negative_mass_fails_its_condition() -> None:
    assert carrying(lambda t: point(3.0) * (t >= 1)).outcome == "proved"
    lying = carrying(lambda t: point(3.0) - point(60.0) * (t >= 20))
    assert lying.outcome == "not_applicable"
    assert "load.a_load is the inertia of a rigid body" in lying.reason
    assert any("at t = 20" in item.expression for item in lying.conditions if not item.holds)


# Filters.


def test_what_is_named_as_filtered_has_to_be_an_input() -> None:
    def claim(x: Any, u: Any, p: Any) -> Certificate:
        return Certificate((Square(x.y),), (Square(x.y),), filters=("dq_wich",))

    verdict = verify(scalar_loop("y", lambda x, u, p: {"y": -x.y}, claim))
    assert verdict.outcome == "not_applicable"
    assert "filters names dq_wich, no input of it" in verdict.reason


def test_a_generator_that_names_errors_may_be_filtered() -> None:
    @final
    class Wishing(AbstractBlock):
        """A reference."""

        outputs = (Output("wish"),)
        states = (State("z"),)

        def equations(self, u: Any, x: Any, p: Any) -> Equations:
            return Equations({"wish": x.z}, {"z": -x.z})

        def certificate(self, u: Any, x: Any, p: Any, truth: Any) -> Certificate:
            return Certificate((Square(x.z),), (Square(x.z),), errors=(Square(2 * x.z),))

    @final
    class Following(AbstractBlock):
        """Reads the reference."""

        inputs = (Input("wish"),)
        states = (State("y"),)

        def equations(self, u: Any, x: Any, p: Any) -> Equations:
            return Equations(rates={"y": -x.y})

        def certificate(self, u: Any, x: Any, p: Any, truth: Any) -> Certificate:
            return Certificate((Square(x.y),), (Square(x.y),), filters=("wish",))

    verdict = verify(Diagram.build({"wishing": Wishing(), "following": Following()}))
    assert verdict.outcome == "proved"
    assert reports(verdict, "goes to zero") == ["y", "dy"]


# The primes are not known in advance, and a positive function may have an edge there.


def test_what_vanishes_modulo_primes_that_are_known_is_not_zero() -> None:
    x = ca.SX.sym("x")
    prime = random_prime(random.Random(0), 127)
    parts = [float((prime >> shift) & (2**24 - 1)) * 2.0**shift for shift in range(0, 127, 24)]  # read exactly
    lie = ca.Function("lie", [x], [sum((part * x for part in parts), ca.SX(0)) * 1e-38])
    assert zero_test(lie, trials=1, seed=0).zero
    assert not zero_test(lie, trials=1).zero


@pytest.mark.parametrize(("function", "edge"), [(ca.asin, True), (ca.tan, True), (ca.sqrt, False), (ca.log, False)])
def test_of_what_is_above_zero_a_root_is_smooth_and_an_arcsine_is_not(function: Any, edge: bool) -> None:
    def claim(x: Any, u: Any, p: Any) -> Certificate:
        return Certificate((Square(function(x.y**2 + 0.5) * x.z), Square(x.y)), (Square(x.y),))

    diagram = scalar_loop("y z", lambda x, u, p: {"y": -x.y, "z": x.z}, claim)
    texts = {item.text for item in smoothness(diagram, claim_of(diagram)).assumptions}
    assert any("stays inside the region where it has a derivative" in text for text in texts) is edge
