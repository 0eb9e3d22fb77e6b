"""Functions allowed in V and in a trajectory: every fault is seeded into a loop of one line."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scalar_blocks import scalar_loop

from dmframe.block.certificate import (
    Barrier,
    Certificate,
    InformationSquare,
    NormSquare,
    Square,
    StableLinear,
)
from dmframe.certify import claim_of, verify
from dmframe.certify.claim import flow_part
from dmframe.certify.sampler import BLOCK, Sampler
from dmframe.certify.smoothness import Smoothness, is_smooth_over, smoothness
from dmframe.common.text import Text
from dmframe.diagram import Diagram
from dmframe.exact import Tape
from dmframe.graph.graph import Graph
from dmframe.program import KINKS

ONE = ca.SX(1)


def stored(value: Callable[[Any], Any]) -> Diagram:
    return scalar_loop(
        "y",
        lambda x, u, p: {"y": -x.y},
        lambda x, u, p: Certificate(storage=(Square(value(x.y), ONE),), dissipation=(Square(x.y, ONE),)),
    )


def following(path: Callable[[Any], Any], order: int = 0) -> Diagram:
    """y follows a path, or a time derivative of it, that V contains."""
    return scalar_loop(
        "y",
        lambda x, u, p: {"y": -(x.y - u.r)},
        lambda x, u, p: Certificate(storage=(Square(x.y - u.r, ONE),), dissipation=(Square(x.y - u.r, ONE),)),
        r=lambda t: _times_differentiated(path(t), t, order),
    )


def _times_differentiated(e: Any, t: Any, order: int) -> Any:
    for _ in range(order):
        e = ca.jtimes(e, t, ca.SX(1))
    return e


def look(diagram: Diagram) -> Smoothness:
    return smoothness(diagram, claim_of(diagram))


SMOOTH = {
    "a state": lambda y: y,
    "an absolute value, squared": ca.fabs,
    "its half, squared": lambda y: ca.fmax(y, 0) / 3,
    "a state times its absolute value": lambda y: y * ca.fabs(y),
    "a root squared": lambda y: ca.sqrt(1 + y * y),
}
JUMPS = {
    "sign": ca.sign,
    "floor": lambda y: y + ca.floor(y),
    "ceil": ca.ceil,
    "fmod": lambda y: ca.fmod(y, 2),
    "if_else": lambda y: ca.if_else(y > 0, y, 2 * y),
    "copysign": lambda y: ca.copysign(1, y),
    "atan2": lambda y: ca.atan2(y, y - 1),
    "==": lambda y: y + (y == 0),
}
KINKED = {
    "fmin": lambda y: ca.fmin(y, 1),
    "fmax": lambda y: y + ca.fmax(y, -y),
    "fabs": lambda y: 1 + ca.fabs(y),
}


@pytest.mark.parametrize("name", SMOOTH)
def test_a_smooth_storage_passes(name: str) -> None:
    assert look(stored(SMOOTH[name])).faults == ()


@pytest.mark.parametrize("name", JUMPS)
def test_a_storage_that_jumps_is_refused_by_block_term_and_operation(name: str) -> None:
    faults = smoothness(diagram := stored(JUMPS[name]), claim_of(diagram)).faults
    assert any(f.startswith("toy: the storage of ") and f"holds {name}, which jumps" in f for f in faults)
    assert verify(diagram).outcome == "not_applicable"


@pytest.mark.parametrize("name", KINKED)
def test_a_storage_with_a_kink_is_refused(name: str) -> None:
    (fault,) = look(stored(KINKED[name])).faults
    assert f"holds {name}, which has no derivative where it switches" in fault


# Differentiable or not, decided by CasADi's own numbers on both sides of each switch.
KINK_CASES = [
    lambda x, y: x * ca.fabs(x),
    lambda x, y: ca.fabs(x) ** 2,
    lambda x, y: y * ca.fabs(x),
    lambda x, y: ca.fmax(x, 0) ** 2 * y,
    lambda x, y: ca.fmax(x, 1) ** 2,
    lambda x, y: ca.fmin(x, 0) * x / (2 + y),
    lambda x, y: ca.fabs(x) + x,
    lambda x, y: ca.sin(ca.fabs(x)) * ca.fabs(x),
    lambda x, y: ca.fmax(x, y) * x,
]


@pytest.mark.parametrize("case", range(len(KINK_CASES)))
def test_a_kink_that_passes_as_smooth_has_one_slope(case: int) -> None:
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    e = KINK_CASES[case](x, y)
    f, slope = ca.Function("f", [x, y], [e]), ca.Function("s", [x, y], [ca.jacobian(e, x)])
    tape = Tape.from_function(f)
    kinks = [k for k, node in enumerate(tape.nodes) if node.code in KINKS]
    smooth = all(is_smooth_over(tape, k) for k in kinks)
    switch = {4: 1.0, 8: 0.7}.get(case, 0.0)
    step = abs(float(slope(switch + 1e-9, 0.7)) - float(slope(switch - 1e-9, 0.7)))
    assert smooth == (case in (0, 1, 3, 5))
    if smooth:
        assert step < 1e-8


def test_a_correction_of_a_projection_in_v_is_refused() -> None:
    loop = Graph.read("arm2_joint").diagram
    claim = claim_of(loop)
    (projection, *_) = [item for item in claim.loop.projections if item.block == "inverse"]
    held = Square(projection.correction, ONE, Text("a correction"))
    part = next(part for part in claim.parts if part.block == "inverse")
    flow_part(claim.flow, "inverse", replace(part.certificate, storage=(*part.certificate.storage, held)))
    found = smoothness(loop, claim).faults
    assert (
        f"inverse: the storage of a correction holds the correction of the projection of {projection.name}" in found[0]
    )


def test_a_symbol_of_nowhere_in_v_is_refused() -> None:
    loop = stored(lambda y: y)
    claim = claim_of(loop)
    held = Square(ca.SX.sym("ghost"), ONE, Text("a ghost"))
    flow_part(claim.flow, "toy", replace(claim.parts[0].certificate, storage=(held,)))
    (fault,) = smoothness(loop, claim).faults
    assert fault.startswith("toy: the storage of a ghost holds ghost, which is no state, trajectory or parameter")


def triangle(t: Any) -> Any:
    return ca.fabs(ca.fmod(t, 2) - 1)


def test_a_path_that_jumps_is_refused_with_the_instant() -> None:
    for path, instant in ((lambda t: ca.floor(t / 3), "t = 3 s"), (lambda t: ca.sign(ca.sin(t)), "t = 0 s")):
        (fault,) = look(following(path)).faults
        assert fault.startswith("path_r.r[0] jumps from ")
        assert instant in fault
        assert verify(following(path)).outcome == "not_applicable"


def test_a_path_may_have_corners_while_only_its_velocity_is_used() -> None:
    assert look(following(triangle)).faults == ()
    (fault,) = look(following(triangle, order=1)).faults
    assert "jumps from -1 to 1 at t = 1 s" in fault


def test_a_hidden_jump_is_found_by_looking() -> None:
    hidden = look(following(lambda t: ca.asin(ca.sin(t)), order=1))
    assert "at t = 1.5708 s" in hidden.faults[0]
    assert "no jump was seen" in look(following(lambda t: ca.asin(ca.sin(t)))).assumptions[0].text


def test_waypoints_are_continuous_at_all_their_instants() -> None:
    found = look(Graph.read("pendulum").diagram)
    assert found.faults == ()
    assert found.assumptions == ()
    assert "path.q_d is continuous at its 4 switching instants, and smooth between" in found.notes


def test_a_path_made_of_a_state_is_refused() -> None:
    diagram = following(lambda t: t)
    (leaf, *_) = diagram.resolver.trajectories.values()
    object.__setattr__(leaf, "expression", leaf.expression + ca.SX.sym("s"))
    (fault, *_) = look(diagram).faults
    assert "path_r.r moves with s; a desired trajectory is a function of time and parameters alone" in fault


def test_a_rate_that_jumps_is_listed_as_an_assumption() -> None:
    diagram = scalar_loop(
        "y",
        lambda x, u, p: {"y": -ca.sign(x.y)},
        lambda x, u, p: Certificate(storage=(Square(x.y, ONE),), dissipation=()),
    )
    assert [item.text for item in look(diagram).assumptions] == [
        "d toy.y/dt holds sign: where it jumps, the motion is Filippov's solution"
    ]


def kept_in(position: Callable[[Any, Any], Any]) -> Diagram:
    """A position between -1 and 1 whose rate is a barrier's reference plus s; z is a further state."""

    def barrier(x: Any, u: Any) -> Barrier:
        low, high, speed, rate, width = map(ca.SX, (-1.0, 1.0, 50.0, 3.0, 0.02))
        return Barrier(position(x, u), ca.SX(0), low, high, speed, rate, width)

    return scalar_loop(
        "q s z",
        lambda x, u, p: {"q": barrier(x, u).reference + x.s, "s": -x.s, "z": -x.z},
        lambda x, u, p: Certificate(
            (Square(x.s), Square(x.z)), (Square(x.s), Square(x.z)), dominates=(ca.SX(1),), barriers=(barrier(x, u),)
        ),
    )


POSITIONS = {
    "sign": lambda x, u: x.q + 100 * ca.sign(x.z),
    "floor": lambda x, u: x.q + ca.floor(x.z),
    "fmod": lambda x, u: x.q + ca.floor(ca.fmod(x.z, 1)),
    "if_else": lambda x, u: x.q + ca.if_else(u.t > 1, 100, 0),
    "<": lambda x, u: x.q + 3 * (u.t < 5),
    "fabs": lambda x, u: x.q + 0 * x.z + ca.fabs(x.z) - x.z,
}


@pytest.mark.parametrize("name", POSITIONS)
def test_a_position_that_jumps_is_not_kept_between_limits(name: str) -> None:
    verdict = verify(kept_in(POSITIONS[name]))
    assert verdict.outcome == "not_applicable"
    assert verdict.reason.startswith("toy: the position of its barrier holds ")
    assert not any(item.says.startswith("stays between") for item in verdict.statements)


def test_a_position_that_moves_smoothly_is_kept_between_limits() -> None:
    verdict = verify(kept_in(lambda x, u: x.q))
    assert verdict.outcome == "proved"
    assert any(item.says.startswith("stays between -1 and 1") for item in verdict.statements)


def test_a_residual_that_jumps_is_not_taken_for_a_constant() -> None:
    def excess(x: Any) -> NormSquare:
        return NormSquare(ca.floor(x.z), ca.SX(1), x.y)

    verdict = verify(
        scalar_loop(
            "y z",
            lambda x, u, p: {"y": -x.y + excess(x).value / x.y, "z": x.z},
            lambda x, u, p: Certificate((Square(x.y),), (Square(x.y),), residual=(excess(x),)),
        )
    )
    assert verdict.outcome == "not_applicable"
    assert "the bounded residual of " in verdict.reason
    assert "holds floor, which jumps" in verdict.reason


def test_a_memory_that_jumps_is_refused_where_only_the_dissipation_holds_it() -> None:
    def memory(x: Any) -> Any:
        return x.g + ca.floor(x.z)

    def loop(memory: Callable[[Any], Any]) -> Diagram:
        return scalar_loop(
            "y z g",
            lambda x, u, p: {
                "y": -x.y - memory(x) * x.y,
                "z": -x.z,
                "g": -memory(x) + x.y**2,
            },
            lambda x, u, p: Certificate(
                (Square(x.y), Square(x.z)),
                (Square(x.y), Square(x.z), InformationSquare(x.y, ca.SX(1), memory(x), x.y, ca.SX(1), ca.SX(1))),
            ),
        )

    assert verify(loop(lambda x: x.g)).outcome == "proved"
    verdict = verify(loop(memory))
    assert verdict.outcome == "not_applicable"
    assert "holds floor, which jumps" in verdict.reason


def test_what_is_driven_may_not_jump_nor_may_a_path_that_it_holds() -> None:
    def loop(vector: Callable[[Any, Any], Any], path: Callable[[Any], Any]) -> Diagram:
        return scalar_loop(
            "y v",
            lambda x, u, p: {"y": -x.y, "v": -vector(x, u) + x.y},
            lambda x, u, p: Certificate(
                (Square(x.y),),
                (Square(x.y),),
                linear=(StableLinear((vector(x, u),), ((ca.SX(-1),),), (vector(x, u),)),),
            ),
            r=path,
        )

    still = verify(loop(lambda x, u: x.v - u.r, ca.sin))
    assert still.outcome == "proved"
    stepping = verify(loop(lambda x, u: x.v - u.r, ca.floor))
    assert stepping.outcome == "not_applicable"
    assert "path_r.r[0] jumps from 0 to 1 at t = 1 s" in stepping.reason
    broken = verify(loop(lambda x, u: x.v + ca.floor(x.y), ca.sin))
    assert "toy: what drives" in broken.reason


def test_a_dissipated_vector_that_jumps_does_not_go_to_zero() -> None:
    def loop(spent: Callable[[Any], Any]) -> Diagram:
        return scalar_loop(
            "y z",
            lambda x, u, p: {"y": -(spent(x) ** 2) / x.y, "z": -x.z},
            lambda x, u, p: Certificate((Square(x.y), Square(x.z)), (Square(spent(x)), Square(x.z))),
        )

    def vanish(spent: Callable[[Any], Any]) -> list[str]:
        verdict = verify(loop(spent))
        assert verdict.outcome == "proved"
        proved = [item for item in verdict.statements if item.says == "goes to zero" and not item.assumes]
        return [item.signal for item in proved]

    assert vanish(lambda x: x.y) == ["y", "z", "dy", "dz"]
    assert vanish(lambda x: x.y * ca.sign(x.z)) == ["z", "dz"]


def test_the_steps_that_are_looked_for_are_those_of_numbers() -> None:
    diagram = following(lambda t: ca.tanh(50 * ca.sin(t)) + ca.fmin(ca.sin(t), 0.5))
    assert look(diagram).faults == ()
    values = diagram.resolver.trajectories["path_r", "r", 0].expression
    f = ca.Function("r", [diagram.loop.time], [values])
    assert np.max(np.abs(np.diff([float(f(k * 1e-3)) for k in range(1000)]))) < 0.1


@pytest.mark.parametrize("count", [0, 1, BLOCK - 1, BLOCK, 2 * BLOCK + 3])
def test_samples_of_many_instants_are_those_of_one_after_the_other(count: int) -> None:
    t, p, given = ca.SX.sym("t"), ca.SX.sym("p", 2), np.array([1.1, 0.3])
    function = ca.Function("f", [t, p], [ca.vertcat(ca.sin(p[0] * t), ca.sqrt(t - 5) / p[1])])
    times = np.linspace(0.0, 10.0, count)
    alone = np.array([function(x, given).full().ravel() for x in times]).reshape(count, 2).T
    assert np.array_equal(Sampler(function, given).over(times), alone, equal_nan=True)
