from __future__ import annotations

import numpy as np
import pytest

from dmframe.config.experiment import load_experiment
from dmframe.results.dataset import dataset, element_labels, sliding


def test_every_variable_and_the_time_have_units_and_a_long_name(ur10, pendulum, arm2):
    for result in (ur10, pendulum, arm2):
        data = dataset(result.recording, result.experiment)
        assert set(data.data_vars) == {*result.recording.states, *result.recording.outputs}
        for variable in (*data.data_vars.values(), *data.coords.values()):
            assert variable.attrs["units"]
            assert variable.attrs["long_name"]
        assert data.time.attrs["units"] == "s"


def test_dimensions_bear_the_names_of_joints_axes_and_parameters(ur10):
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
def test_adapted_translations_bear_the_names_of_what_they_place(adapt, count, first, last):
    diagram = load_experiment("theorem_3", [f"geometry.adapt={adapt}"]).diagram()
    labels = element_labels(diagram, "h", count)
    assert (len(labels), labels[0], labels[-1]) == (count, first, last)
    assert element_labels(load_experiment("ur10_fast").diagram(), "h", 2) == ("1", "2")


def test_values_are_those_of_the_run(ur10):
    data = dataset(ur10.recording)
    for label in (*ur10.recording.states, *ur10.recording.outputs):
        assert np.array_equal(data[label].values, ur10.recording[label])


def test_attributes_say_where_the_data_come_from(ur10):
    attributes = dataset(ur10.recording, ur10.experiment, seed=3).attrs
    assert attributes["graph"] == "ur10_fast"
    assert attributes["title"] == ur10.experiment.file.title
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
