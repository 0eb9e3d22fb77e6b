"""The dynamic parameters compared with Pinocchio: order, names, values, and their columns."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

from dmframe.common.errors import UnknownNameError
from dmframe.robot import parameters
from dmframe.robot.chain import SerialChain, pin_configuration
from dmframe.robot.library import load
from dmframe.robot.parameters import INERTIAL, DynamicParameters
from dmframe.robot.symbolic import SymbolicRobot

PARTS = ("inertial", "weighing", "viscous", "coulomb", "bias")


@pytest.fixture(scope="module")
def chain() -> SerialChain:
    """Two revolute joints with a prismatic one in between, and bodies with all parameters different."""
    model, parent = pin.Model(), 0
    rng = np.random.default_rng(3)
    for i, joint in enumerate((pin.JointModelRZ(), pin.JointModelPY(), pin.JointModelRX())):
        place = pin.SE3(pin.rpy.rpyToMatrix(*rng.uniform(-1, 1, 3)), rng.uniform(-1, 1, 3))
        parent = model.addJoint(parent, joint, place, f"joint_{i}")
        model.addJointFrame(parent)
        turn = pin.rpy.rpyToMatrix(*rng.uniform(-1, 1, 3))
        central = turn @ np.diag([1.0, 1.3, 1.7]) @ turn.T * rng.uniform(0.5, 2)
        model.appendBodyToJoint(
            parent, pin.Inertia(rng.uniform(1, 5), rng.uniform(-1, 1, 3), central), pin.SE3.Identity()
        )
        model.addBodyFrame(f"body_{i}", parent, pin.SE3.Identity(), -1)
    return SerialChain.from_model(model, name="mixed")


def whole(chain: SerialChain) -> DynamicParameters:
    return DynamicParameters(chain, ("coulomb", "viscous"), separate_gravity=True, bias=True)


def by_name(chain: SerialChain) -> dict[str, float]:
    """Each inertial parameter from the mass, the centre and the central inertia in Pinocchio."""
    found = {}
    for link, body in enumerate(list(chain.model.inertias)[1:], start=1):
        about = body.inertia - body.mass * pin.skew(body.lever) @ pin.skew(body.lever)
        found[f"m_{link}"] = body.mass
        for i, x in enumerate("xyz"):
            found[f"mc_{x}{link}"] = body.mass * body.lever[i]
            for j, y in enumerate("xyz"[i:], start=i):
                found[f"I_{x}{y}{link}"] = about[i, j]
    return found


def misnamed(chain: SerialChain) -> list[str]:
    """Parameters whose value, or whose column of the regressor, does not match their name."""
    a_d, expected = DynamicParameters(chain), by_name(chain)
    q, dq, ddq = np.random.default_rng(1).uniform(-1, 1, (3, chain.n))
    data = chain.model.createData()
    columns = pin.computeJointTorqueRegressor(chain.model, data, pin_configuration(chain, q), dq, ddq)
    stated = np.concatenate([body.toDynamicParameters() for body in list(chain.model.inertias)[1:]])
    order = [min(expected, key=lambda name: abs(expected[name] - value)) for value in stated]
    robot = SymbolicRobot(chain)
    symbols = [ca.SX.sym(name, chain.n) for name in ("q", "dq", "ddq")]
    constants = [constant.symbol for constant in robot.constants]
    Y = ca.Function("Y", [*symbols, *constants], [robot.regressor(symbols[0], symbols[1], symbols[1], symbols[2])])
    found = np.array(Y(q, dq, ddq, *robot.values().values()))
    return [
        name
        for place, (name, value) in enumerate(zip(a_d.names, a_d.values, strict=True))
        if not np.isclose(float(value or 0), expected[name], rtol=1e-9)
        or not np.allclose(found[:, place], columns[:, order.index(name)], atol=1e-9)
    ]


def test_names_values_and_columns_are_those_of_pinocchio(chain: SerialChain) -> None:
    assert misnamed(chain) == []


@pytest.mark.parametrize("place", range(9))
def test_two_swapped_names_are_caught(chain: SerialChain, monkeypatch: pytest.MonkeyPatch, place: int) -> None:
    names = list(INERTIAL)
    names[place : place + 2] = reversed(names[place : place + 2])
    monkeypatch.setattr(parameters, "INERTIAL", tuple(names))
    swapped = {name.replace("_", "") for name in names[place : place + 2]}
    assert {name.replace("_", "")[:-1] for name in misnamed(chain)} == swapped


@pytest.mark.parametrize("robot", ["ur10", "panda", "arm2", "pendulum"])
def test_the_values_of_a_packaged_robot_are_pinocchios_own(robot: str) -> None:
    chain = load(robot)
    rows = [body.toDynamicParameters() for body in list(chain.model.inertias)[1:]]
    assert [float(value or 0) for value in DynamicParameters(chain).values] == list(np.concatenate(rows))


def test_what_the_model_does_not_state_has_no_value(chain: SerialChain) -> None:
    a_d = whole(chain)
    known = dict(zip(a_d.names, a_d.values, strict=True))
    assert all(known[f"{name}_{i}"] is None for name in "BD" for i in (1, 2, 3))
    assert known["tau_bias2"] is None
    assert known["m_g3"] == known["m_3"]
    assert known["mc_gy1"] == known["mc_y1"]


def test_parts_follow_one_another_and_each_name_once(chain: SerialChain) -> None:
    a_d = whole(chain)
    assert a_d.parts == PARTS
    assert [a_d.names[a_d.places(part)][0] for part in PARTS] == ["m_1", "m_g1", "B_1", "D_1", "tau_bias1"]
    assert [place for part in PARTS for place in range(a_d.size)[a_d.places(part)]] == list(range(a_d.size))
    assert len(set(a_d.names)) == a_d.size == (10 + 4 + 3) * 3
    assert a_d.names[a_d.of_link(1)][:2] == ("m_2", "mc_x2")
    assert [a_d.link_of(place) for place in (0, 9, 10, 29)] == [0, 0, 1, 2]


def test_a_disabled_part_has_no_place(chain: SerialChain) -> None:
    a_d = DynamicParameters(chain, ["coulomb"])
    assert a_d.parts == ("inertial", "coulomb")
    assert a_d.names[a_d.places("viscous")] == ()
    assert a_d.in_order({"coulomb": "D", "viscous": "B", "inertial": "a"}) == ["a", "D"]
    assert DynamicParameters(chain, ("viscous", "viscous")).size == 33


def test_units_are_those_of_each_element_and_of_its_joint(chain: SerialChain) -> None:
    units = dict(whole(chain).elements)
    assert [units[name] for name in ("m_1", "mc_z2", "I_xy3", "m_g1", "mc_gx2")] == [
        "kg", "kg m", "kg m^2", "kg", "kg m",
    ]  # fmt: skip
    assert [units[f"B_{i}"] for i in (1, 2, 3)] == ["N m s/rad", "N s/m", "N m s/rad"]
    assert [units[f"D_{i}"] for i in (1, 2, 3)] == [units[f"tau_bias{i}"] for i in (1, 2, 3)] == ["N m", "N", "N m"]


def test_another_kind_of_friction_is_refused_with_the_nearest(chain: SerialChain) -> None:
    with pytest.raises(UnknownNameError, match="friction colomb: unknown kind of friction; did you mean coulomb"):
        DynamicParameters(chain, ("viscous", "colomb"))
