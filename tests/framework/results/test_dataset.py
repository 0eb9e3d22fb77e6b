from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from dmframe.block import AbstractBlock, Equations
from dmframe.block.port import Element, Output
from dmframe.catalogue import block_types
from dmframe.common.errors import BlockError
from dmframe.common.units import sliding
from dmframe.diagram import Diagram
from dmframe.graph.graph import Graph
from dmframe.results.dataset import dataset, element_labels, elements
from dmframe.robot.library import load


def test_every_variable_and_the_time_have_units_and_a_long_name(ur10, pendulum, arm2):
    for result in (ur10, pendulum, arm2):
        data = dataset(result.recording, result.graph)
        assert set(data.data_vars) == {*result.recording.states, *result.recording.outputs}
        for variable in (*data.data_vars.values(), *data.coords.values()):
            assert variable.attrs["units"]
            assert variable.attrs["long_name"]
        assert data.time.attrs["units"] == "s"


def test_dimensions_have_the_names_of_joints_axes_and_parameters(ur10):
    data = dataset(ur10.recording)
    assert data["arm.q"].dims == ("time", "joint")
    assert list(data.joint.values) == ["shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint"]
    assert list(data["arm.x"].axis.values) == ["x", "y", "z"]
    assert data["dynamics.a_d_hat"].dims == ("time", "parameter")
    assert data.parameter.size == 36
    assert list(data.parameter.values[[0, 1, 10, 30, 35]]) == ["m_1", "mc_x1", "m_2", "B_1", "D_3"]
    assert str(data.parameter_unit.sel(parameter="I_xx2").values) == "kg m^2"


@pytest.mark.parametrize(
    ("adapt", "count", "first", "last"),
    [("all", 12, "shoulder_pan_joint x", "tool z"), ("links", 9, "shoulder_pan_joint x", "elbow_joint z"),
     ("tool", 3, "tool x", "tool z")],
)  # fmt: skip
def test_adapted_translations_have_the_names_of_what_they_place(adapt, count, first, last):
    diagram = Graph.read("theorem_3", [f"geometry.adapt={adapt}"]).diagram
    labels = element_labels(diagram, "h", count)
    assert (len(labels), labels[0], labels[-1]) == (count, first, last)
    assert element_labels(Graph.read("ur10_fast").diagram, "h", 2) == ("1", "2")


def test_a_link_of_a_robot_of_one_joint_is_not_taken_for_its_tool():
    adapted = block_types()["adaptive_kinematics"](Gamma_k=1, adapt="links").elements(load("pendulum"))["h"]
    assert adapted == [("joint1 x", "m"), ("joint1 y", "m"), ("joint1 z", "m")]


@pytest.mark.parametrize(
    ("graph", "overrides", "count", "named"),
    [
        ("ur10_fast", [], 36, {"B_1": "N m s/rad", "D_3": "N m"}),
        ("torque_indirect_filtered_pi", [], 24, {"I_zz2": "kg m^2", "B_2": "N m s/rad", "tau_bias2": "N m"}),
        ("torque_indirect_pi", [], 24, {"m_1": "kg", "tau_bias1": "N m"}),
        ("arm2_joint", ["model.gravity=apart"], 30, {"mc_x2": "kg m", "m_g1": "kg", "mc_gz2": "kg m"}),
        ("pendulum", ["model.friction=[]"], 10, {"I_xx1": "kg m^2"}),
    ],
)
def test_dynamic_parameters_have_names_and_units_whatever_the_regressor_holds(graph, overrides, count, named):
    found = elements(Graph.read(graph, overrides).diagram, "p", count)
    assert len({element.name for element in found}) == count
    assert named.items() <= {element.name: element.unit for element in found}.items()


def test_the_columns_of_a_bias_have_names_and_units_in_the_data(make_result):
    data = dataset(make_result("torque_indirect_pi", 0.02).recording)
    assert list(data.parameter.values[[0, 1, 20, 22, 23]]) == ["m_1", "mc_x1", "B_1", "tau_bias1", "tau_bias2"]
    assert str(data.parameter_unit.sel(parameter="tau_bias2").values) == "N m"
    assert data["adaptation.a_d_hat"].attrs["units"] == "see parameter_unit"


class Reduced(AbstractBlock):
    """A regressor of a set of its own."""

    outputs = (Output("Y", "n p", "N m"),)
    names: tuple[str, ...] = ()

    def elements(self, robot):
        return {"p": [Element(name, "kg m^2") for name in self.names]}

    def equations(self, u, x, p):
        return Equations({"Y": ca.DM.ones(1, len(self.names) or 2)})


def test_a_block_of_a_users_own_names_what_it_binds():
    diagram = Diagram.build({"mine": Reduced(names=("beta_1", "beta_2"))}, {}, load("pendulum"))
    assert elements(diagram, "p", 2) == (("beta_1", "kg m^2"), ("beta_2", "kg m^2"))
    assert element_labels(diagram, "p", 3) == ("1", "2", "3")


def test_an_element_that_cannot_be_named_is_labelled_by_the_blocks_name(monkeypatch):
    diagram = Diagram.build({"mine": Reduced(names=("beta_1", "beta_2"))}, {}, load("pendulum"))
    monkeypatch.setattr(Reduced, "elements", lambda self, robot: {"p": ("beta_1", "beta_2")})
    with pytest.raises(BlockError, match=r"mine: elements\(\), .*'str' object has no attribute 'name'"):
        elements(diagram, "p", 2)


def test_values_are_those_of_the_run(ur10):
    data = dataset(ur10.recording)
    for label in (*ur10.recording.states, *ur10.recording.outputs):
        assert np.array_equal(data[label].values, ur10.recording[label])


def test_attributes_state_where_the_data_come_from(ur10):
    attributes = dataset(ur10.recording, ur10.graph.set(seed=3)).attrs
    assert attributes["graph"] == "ur10_fast"
    assert attributes["title"] == ur10.graph.file.title
    assert attributes["clock"] == "0.008 s"
    assert attributes["solver"].startswith("rk4, step 0.001 s")
    assert attributes["source"].startswith("dmframe ")
    assert attributes["seed"] == 3
    assert len(attributes["graph_sha256"]) == 64


@pytest.mark.parametrize(
    ("revolute", "prismatic"),
    [
        ("rad", "m"),
        ("rad/s", "m/s"),
        ("N m", "N"),
        ("N m s/rad", "N s/m"),
        ("rad/(N m s)", "m/(N s)"),
        ("N m/V", "N/V"),
        ("rad^2/(N^2 m^2 s)", "m^2/(N^2 s)"),
        ("V", "V"),
        ("1/s", "1/s"),
    ],
)
def test_a_prismatic_joint_reads_metres_for_radians_and_newtons_for_newton_metres(revolute, prismatic):
    assert sliding(revolute) == prismatic
