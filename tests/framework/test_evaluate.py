"""Blocks at numbers, compared with the formulas of their papers and with Pinocchio."""

from __future__ import annotations

import gc
from dataclasses import replace
from typing import Any, final

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

import dmframe as dm
from dmframe.block import AbstractBlock, Equations, Signals, evaluate
from dmframe.block.model import model_block
from dmframe.block.port import Output
from dmframe.common.errors import DmframeError
from dmframe.robot.library import load


def block(kind: str, **parameters: Any) -> Any:
    return dm.blocks()[kind](**parameters)


def test_the_compensator_gives_its_torque_and_the_rate_of_its_estimate() -> None:
    Y, sigma, a = np.arange(6.0).reshape(2, 3), np.array([1.0, -2.0]), np.array([0.5, 1.0, 2.0])
    found = block("dynamic_compensator", Gamma=10).evaluate({"Y_d": Y, "sigma": sigma}, {"a_d_hat": a})
    assert np.allclose(found.outputs["tau_dc"], Y @ a)
    assert np.allclose(found.rates["a_d_hat"], -10 * Y.T @ sigma)


def test_a_full_gain_is_taken_whole() -> None:
    Y, sigma, gain = np.eye(2), np.array([1.0, 2.0]), [[2.0, 1.0], [1.0, 3.0]]
    found = block("dynamic_compensator", Gamma=gain).evaluate({"Y_d": Y, "sigma": sigma})
    assert np.allclose(found.rates["a_d_hat"], -np.array(gain) @ sigma)
    assert np.allclose(found.outputs["tau_dc"], 0)  # the estimate starts at zero


def test_a_block_that_uses_a_robot_has_pinocchios_jacobian() -> None:
    chain, q, dq = load("ur5"), np.linspace(-1, 1, 6), np.linspace(1, 2, 6)
    found = block("kinematics").evaluate({"q": q, "dq": dq, "x": [0, 0, 0]}, robot="ur5")
    data = chain.model.createData()
    pin.computeJointJacobians(chain.model, data, q)
    pin.updateFramePlacements(chain.model, data)
    frame = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    J = pin.getFrameJacobian(chain.model, data, chain.model_tool, frame)[:3]
    assert np.allclose(found.outputs["J_hat"], J, atol=1e-9)


def test_a_state_begins_where_its_parameter_states_and_a_scalar_is_a_number() -> None:
    found = block("circle", center=[0, 0, 1], radius=2, rate=1).evaluate({"t": 0})
    assert np.allclose(np.linalg.norm(found.outputs["x_d"] - [0, 0, 1]), 2)
    found = block("pid_inverse", K_c=1, Lambda=1, Lambda_P=1, Lambda_I=1, w=3, w_P=2, w_I=1).evaluate(
        {"dq_r": [1.0], "q": [0.0], "dq": [0.0], "q_c": [0.0], "tau_dc": [1.0]}
    )
    assert all(np.all(np.isfinite(value)) for value in found.outputs.values())


@pytest.mark.parametrize(
    ("inputs", "states", "text"),
    [
        ({"Y_d": np.eye(2)}, {}, "dynamic_compensator: evaluate needs the inputs sigma"),
        (
            {"Y_d": np.eye(2), "sigma": [1, 2, 3]},
            {},
            "sigma: expected n = 2 (bound by",
        ),
        ({"Y_d": [1, 2], "sigma": [1, 2]}, {}, "Y_d: expected the shape (n p), found 2"),
        ({"Y_d": np.eye(2), "sgma": [1, 2]}, {}, "dynamic_compensator.sgma: unknown input; did you mean sigma?"),
        ({"Y_d": np.eye(2), "sigma": "x"}, {}, "dynamic_compensator.sigma: expected numbers, found 'x'"),
        ({"Y_d": np.eye(2), "sigma": [1, 2]}, {"a": 1}, "dynamic_compensator.a: unknown state"),
    ],
)
def test_a_value_of_the_wrong_shape_or_name_is_refused(inputs: Any, states: Any, text: str) -> None:
    with pytest.raises(DmframeError) as caught:
        block("dynamic_compensator", Gamma=1).evaluate(inputs, states)
    assert text in str(caught.value)


def test_a_missing_robot_is_reported() -> None:
    with pytest.raises(DmframeError, match="this block needs a robot"):
        block("kinematics").evaluate({"q": [0], "dq": [0], "x": [0]})


def test_a_loop_over_samples_writes_the_equations_once(monkeypatch: pytest.MonkeyPatch) -> None:
    written = []

    def counted(*given: Any) -> Any:
        written.append(given[0])
        return model_block(*given)

    monkeypatch.setattr("dmframe.block.evaluate.model_block", counted)
    kind, sigma = dm.blocks()["dynamic_compensator"], [1.0, -2.0]
    made = kind(Gamma=3.5)
    for k in range(4):
        Y = np.array([[k, 1.0], [2.0, k]])
        found = made.evaluate({"Y_d": Y, "sigma": sigma}, {"a_d_hat": [k, 1.0]})
        assert np.allclose(found.rates["a_d_hat"], -3.5 * Y.T @ sigma)
        assert np.allclose(found.outputs["tau_dc"], Y @ [k, 1.0])
    assert len(written) == 1
    assert np.allclose(kind(Gamma=7).evaluate({"Y_d": np.eye(2), "sigma": sigma}).rates["a_d_hat"], [-7, 14])
    assert len(made.evaluate({"Y_d": np.ones((2, 3)), "sigma": sigma}).rates["a_d_hat"]) == 3
    assert len(written) == 3  # other numbers, another size

    def reversed_torque(self: Any, u: Any, x: Any, p: Any) -> Any:
        stated = before(self, u, x, p)
        return replace(stated, outputs={**stated.outputs, "tau_dc": -stated.outputs["tau_dc"]})

    before = type(made).equations
    monkeypatch.setattr(type(made), "equations", reversed_torque)
    found = made.evaluate({"Y_d": np.eye(2), "sigma": sigma}, {"a_d_hat": [5.0, 6.0]})
    assert np.allclose(found.outputs["tau_dc"], [-5, -6])


def test_a_block_is_of_the_robot_that_is_given() -> None:
    made = block("kinematics")
    one, other = (
        made.evaluate({"q": np.zeros(6), "dq": np.zeros(6), "x": [0, 0, 0]}, robot=r) for r in ("ur5", "ur10")
    )
    assert not np.allclose(one.outputs["J_hat"], other.outputs["J_hat"])


factor = 2.0


@final
class Listed(AbstractBlock):
    """A block with mutable values, and a global variable."""

    outputs = (Output("y", "", ""),)
    numbers: list[float] | tuple[float, ...]

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"y": ca.SX(factor * sum(self.numbers))})


def test_a_value_that_can_change_is_read_at_each_call() -> None:
    made = Listed(numbers=[1.0])
    assert made.evaluate().outputs["y"] == 2.0
    made.numbers.append(3.0)  # type: ignore[union-attr]
    assert made.evaluate().outputs["y"] == 8.0


def test_a_new_block_states_its_equations_again(monkeypatch: pytest.MonkeyPatch) -> None:
    one = Listed(numbers=(1.0,))
    assert one.evaluate().outputs["y"] == 2.0
    monkeypatch.setitem(globals(), "factor", 5.0)
    other = Listed(numbers=(1.0,))
    assert one == other
    assert other.evaluate().outputs["y"] == 5.0


def test_no_cache_entry_remains_of_a_deleted_block() -> None:
    kept = evaluate._KEPT
    before, made = len(kept), block("kinematics")
    for robot in ("ur5", "ur10", "ur5"):
        made.evaluate({"q": np.zeros(6), "dq": np.zeros(6), "x": [0, 0, 0]}, robot=robot)
    assert len(kept) == before + 1
    del made
    gc.collect()
    assert len(kept) <= before
