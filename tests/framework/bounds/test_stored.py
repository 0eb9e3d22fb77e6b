"""Bounds from an error that V stores: the position feedback of the reference, by hand and in runs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import dmframe as dm
from dmframe.block import Square
from dmframe.bounds.stored import StoredErrors
from dmframe_blocks.pi_inverse import PiInverse
from tests.framework.bounds.test_error_bounds import LEAK, PI, bounds, found, joint_values, verdict_of

NEAR = LEAK | {"uncertain": {}, "inverse.w_I": 2.2, "inverse.Lambda_I": 100, "model.nominal": 1}
"""No intervals, and estimates of the links that are right: the rest of V at the start is known by hand."""


def boxes(graph: dm.Graph, room: float) -> dict[str, Any]:
    """Boxes of the estimates that contain the true values and the start, `room` wide on each side."""
    p = joint_values(graph)
    chain, q = graph.diagram.robot, np.array(graph.start["q"])
    a_d = np.concatenate([chain.model.inertias[k + 1].toDynamicParameters() for k in range(3)])
    bias = -pin.computeGeneralizedGravity(chain.model, chain.model.createData(), q)
    friction = np.concatenate([p["arm.viscous"], p["arm.coulomb"]])
    true = np.concatenate([a_d, friction, bias])
    return {"dynamics.a_d_hat_box": [(np.minimum(true, 0) - room).tolist(), (np.maximum(true, 0) + room).tolist()]}


def largest_by_hand(graph: dm.Graph, over: float, D: float) -> tuple[float, float]:
    """Both bounds on the largest error, from V at the start and from the boxes, with Pinocchio's M and g."""
    p, chain, q = joint_values(graph), graph.diagram.robot, np.array(graph.start["q"])
    K_P, K_I, B = p["servo.K_P"], p["servo.K_I"], p["arm.viscous"]
    M = pin.crba(chain.model, chain.model.createData(), q)
    M = np.triu(M) + np.triu(M, 1).T
    sigma = -p["path.amplitude"] * p["path.rate"]
    moving = sigma @ M @ sigma / 2
    friction = np.concatenate([B, p["arm.coulomb"]])
    Gamma, gain = (
        graph.diagram.models["dynamics"].values["Gamma"].flat[0],
        {k: p[f"inverse.{k}"][0] for k in ("Lambda", "Lambda_I")},
    )
    start = moving + np.sum(friction**2) / 2 / Gamma + np.sum(K_P * K_P**-2.0) / 2 / gain["Lambda"]
    start += np.sum(K_P * (p["inverse.w_I"] - K_I / K_P) ** 2) / 2 / gain["Lambda_I"]
    delta, rho = np.sum(D**2 / (K_P + B)), max(2 / K_I)
    first = np.sqrt(rho * (start + over * delta / 4))
    box = graph.diagram.models["dynamics"].values.get("a_d_hat_box")
    if box is None:
        return float(first), np.inf
    low, high = box.T
    a_d = np.concatenate([chain.model.inertias[k + 1].toDynamicParameters() for k in range(3)])
    true = np.concatenate([a_d, friction, -pin.computeGeneralizedGravity(chain.model, chain.model.createData(), q)])
    c = np.sum(np.maximum(abs(low - true), abs(high - true)) ** 2) / 2 / Gamma
    for name, truth in (("w", 1 / K_P), ("w_I", K_I / K_P)):
        ends = graph.diagram.models["inverse"].values[f"{name}_box"].reshape(-1, 2)
        most = np.maximum(abs(ends[0, 0] - truth), abs(ends[0, 1] - truth))
        c += np.sum(K_P * most**2) / 2 / gain["Lambda" + name.removeprefix("w")]
    rate = 2 * min(p["inverse.K_c"])
    return float(first), float(np.sqrt(rho * (c + max(moving, delta / (4 * rate)))))


@pytest.mark.parametrize("torque", [0.0, 5.0])
def test_the_largest_error_is_bounded_by_v_at_the_start_as_by_hand(torque: float) -> None:
    graph = dm.load(PI).set(NEAR | {"dynamics.Gamma": 1000})
    here = found(graph, kind="sup", over=60.0, disturbance=torque)
    assert here.value == pytest.approx(largest_by_hand(graph, 60.0, torque)[0], rel=1e-6)


def test_boxes_bound_the_largest_error_for_all_times() -> None:
    """Theta is not in the formula by hand: it is 1 without inertia, and at least 0.8 here."""
    graph = dm.load(PI).set(NEAR | {"dynamics.Gamma": 1000})
    graph = graph.set(boxes(graph, 0.5))
    long = [found(graph, kind="sup", over=over, disturbance=5.0) for over in (1e5, 1e7)]
    _, least = largest_by_hand(graph, 1e5, 5.0)
    assert long[0].value == pytest.approx(long[1].value, rel=1e-12)
    assert least < long[0].value < 1.02 * least
    assert str(long[0].dominated_by.of).startswith("the box of ")
    assert found(graph, kind="sup", over=1.0).value < long[0].value


def test_the_trace_bounds_the_inertia_at_all_positions() -> None:
    graph = dm.load(PI).set(NEAR)
    graph = graph.set(boxes(graph, 0.5))
    kept: list[float] = []
    original = StoredErrors._largest
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(StoredErrors, "_largest", lambda *given: kept.append(original(*given)) or kept[-1])
        found(graph, kind="sup", disturbance=5.0)
    p, chain, rng = joint_values(graph), graph.diagram.robot, np.random.default_rng(0)
    scale = 1 / np.sqrt(p["servo.K_P"] + p["arm.viscous"])
    sizes = []
    for q in rng.uniform(-np.pi, np.pi, (300, 3)):
        M = np.triu(pin.crba(chain.model, chain.model.createData(), q))
        M = M + np.triu(M, 1).T
        sizes.append(np.linalg.eigvalsh(scale[:, None] * M * scale)[-1])
    assert max(sizes) < max(kept) < 30 * max(sizes)


def test_with_equal_rates_the_reference_position_is_the_desired_one() -> None:
    run = dm.load(PI).set(LEAK | {"clock": "continuous"}).run(until=1.0)
    assert np.max(np.abs(run["inverse.q_tie"] - run["path.q_d"])) < 1e-6
    assert np.max(np.abs(run["arm.q"] - run["path.q_d"])) > 1e-4


@pytest.mark.parametrize("name", ["weight", "sign", "bias"])
def test_a_leak_that_is_stated_wrongly_is_refuted(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    graph = dm.load(PI).set(LEAK)
    if name == "bias":
        graph = graph.set({"model.bias": False})
    elif name == "weight":
        honest = PiInverse.certificate

        def wrong(*given: Any) -> Any:
            stated = honest(*given)
            (first, second) = stated.dissipation
            return replace(stated, dissipation=(first, Square(second.vector, 1.5 * second.weight)))

        monkeypatch.setattr(PiInverse, "certificate", wrong)
    else:
        equations = PiInverse.equations

        def backward(self: Any, u: Any, x: Any, p: Any) -> Any:
            stated = equations(self, u, x, p)
            return replace(stated, rates={"q_tie": 2 * u.dq_r - stated.rates["q_tie"]})

        monkeypatch.setattr(PiInverse, "equations", backward)
    assert verdict_of(graph).outcome == "refuted"


@pytest.mark.parametrize(("room", "outcome"), [(0.5, "proved"), (-0.5, "not_applicable")])
def test_a_true_value_that_the_start_decides_lies_in_its_box_there(room: float, outcome: str) -> None:
    """The offset of the servo's integrator is the gravity torque at the start, 187 and 34 N m here."""
    graph = dm.load(PI).set(LEAK | {"uncertain": {}})
    (low, high) = boxes(graph, 0.5)["dynamics.a_d_hat_box"]
    low[-3:] = [min(x + 0.5 - room, 0.0) for x in low[-3:]]
    high[-3:] = [max(x - 0.5 + room, 0.0) for x in high[-3:]]
    verdict = verdict_of(graph.set({"dynamics.a_d_hat_box": [low, high]}))
    assert verdict.outcome == outcome
    (checked,) = [x for x in verdict.conditions if "true value inside the box at the start" in str(x.name)]
    assert checked.holds == (outcome == "proved")


def test_a_start_that_is_not_stated_leaves_an_assumption() -> None:
    graph = dm.load(PI).set(LEAK | {"start": None, "dynamics.a_d_hat_box": [-8, 15]})
    verdict = verdict_of(graph)
    assert not [x for x in verdict.conditions if "at the start" in str(x.name)]
    assert any("where the plant starts" in str(x.text) for x in verdict.assumptions)


@pytest.mark.parametrize(
    ("more", "kind"),
    [({"dynamics.a_d_hat_box": None}, "largest"), ({"inverse.K_c": 0.5}, "slow")],
)
def test_a_leak_never_raises_a_bound(more: Mapping[str, Any], kind: str) -> None:
    graph = dm.load("joint_tracking_bounded").set(
        {"model.nominal": 1, "dynamics.Gamma": 1000, "inverse.Lambda_I": 1000}
    )
    plain = {(x.kind, x.unit): x.value for x in bounds(graph, disturbance=5.0).found}
    with_leak = bounds(graph.set(LEAK | more), disturbance=5.0)
    factor = {"largest": 0.6, "slow": 1.05}[kind]
    for each in with_leak.found:
        assert each.value < factor * plain[each.kind, each.unit]


def decay_rates(graph: dm.Graph) -> list[float]:
    """The rates mu at which S decays to what the boxes allow, as used in bounds."""
    rates: list[float] = []
    original = StoredErrors.boxed.func

    def seen(self: Any) -> Any:
        found = original(self)
        rates.append(found.rate)
        return found

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(StoredErrors, "boxed", property(seen))
        bounds(graph, verdict_of(graph), over=1e6, disturbance=5.0)
    return rates


def test_dissipation_is_counted_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two halves of a stored square share its dissipation; one on which a torque acts is needed against the torque."""
    graph = dm.load(PI).set(NEAR | {"dynamics.Gamma": 1000})
    graph = graph.set(boxes(graph, 0.5))
    (whole,) = decay_rates(graph)
    assert 3.9 < whole <= 4.0  # twice K_c, at most
    honest = PiInverse.certificate

    def in_halves(*given: Any) -> Any:
        stated = honest(*given)
        (square,) = stated.storage
        return replace(stated, storage=(half := Square(square.vector, square.weight / 2), half))

    with monkeypatch.context() as patch:
        patch.setattr(PiInverse, "certificate", in_halves)
        assert decay_rates(graph) == pytest.approx([whole, whole], rel=1e-9)
    monkeypatch.setattr(PiInverse, "certificate", lambda *given: replace(honest(*given), disturbed=(1, 1e-9)))
    assert decay_rates(graph) == []
