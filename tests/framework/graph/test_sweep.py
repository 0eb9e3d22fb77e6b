"""`dm.sweep`: figures of one graph with many values, compared with separate runs of the graphs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dmframe as dm
from dmframe.common.errors import DmframeError
from dmframe.study.objective import statistic
from dmframe.study.read import load_study


def test_a_grid_has_a_dimension_a_name_and_the_figures_of_the_runs_alone() -> None:
    values = {"dynamics.Gamma": [1, 10, 100], "servo.K_P": ["30 V s/rad", 50]}
    found = dm.sweep("arm2_joint", values, until="0.4 s", signals=["arm.q"], limits={"error": 1e-3})
    assert found["rms_final"].dims == ("dynamics.Gamma", "servo.K_P")
    assert found["rms_by_eighth"].shape == (3, 2, 8)
    assert found["servo.K_P"].values.tolist() == [30, 50]
    assert (found["servo.K_P"].units, found["rms_final"].units, found["arm.q_most"].units) == ("V s/rad", "rad", "rad")
    run = dm.load("arm2_joint").set({"dynamics.Gamma": 10, "servo.K_P": 50}).run("0.4 s")
    assert run.error is not None
    mine = found.sel({"dynamics.Gamma": 10, "servo.K_P": 50})
    np.testing.assert_allclose(mine["rms_by_eighth"], run.error.rms_by_eighth, rtol=1e-9)
    np.testing.assert_allclose(mine["error_most"], run.error.norm.max(), rtol=1e-9)
    for name, instead, values in (
        ("rms_by_eighth", "rms_1", mine["rms_by_eighth"][0]),
        ("arm.q_most", "arm.q.most", mine["arm.q_most"]),
    ):  # by the names of a study's table, and by the former names, whose attributes name the new ones
        assert found[name].attrs["instead"] == instead
        np.testing.assert_array_equal(mine[instead], values)
    assert "instead" not in found["rms_final"].attrs
    np.testing.assert_allclose(mine["arm.q_last"], run["arm.q"].values[-1], rtol=1e-9)
    first = run.error.times[np.argmax(run.error.norm > 1e-3)]
    assert mine["error_crossed"] == first
    assert not found["diverged"].any()
    assert np.isnan(found["diverged_at"]).all()


def test_a_list_takes_its_values_side_by_side_also_those_that_shape_the_loop() -> None:
    values = {"clock": ["2 ms", "4 ms", "2 ms"], "dynamics.Gamma": [1, 2, 1e6]}
    free = dm.load("arm2_joint").set({"dynamics.a_d_hat_box": None})  # its box bounds each estimate
    found = dm.sweep(free, values, until=0.4, design="list")
    assert found["rms_final"].dims == ("run",)
    assert found["clock"].values.tolist() == ["2 ms", "4 ms", "2 ms"]
    np.testing.assert_array_equal(found["diverged"], [False, False, True])
    assert np.isnan(found["rms_final"][2])
    for place, gamma in enumerate((1, 2)):
        run = free.set({"clock": values["clock"][place], "dynamics.Gamma": gamma}).run(0.4)
        assert run.error is not None
        np.testing.assert_allclose(found["rms_final"][place], run.error.rms_final, rtol=1e-9)


def test_parameters_that_are_lists_and_blocks_that_change_are_texts_on_their_axis() -> None:
    found = dm.sweep("arm2_joint", {"servo.K_P": [[30, 20], [60, 40]]}, until=0.1)
    assert found["servo.K_P"].values.tolist() == ["[30, 20]", "[60, 40]"]
    runs = [dm.load("arm2_joint").set({"servo.K_P": gain}).run(0.1) for gain in ([30, 20], [60, 40])]
    finals = [run.error.rms_final for run in runs if run.error is not None]
    np.testing.assert_allclose(found["rms_final"], finals, rtol=1e-9)


SWINGING = """\
dmframe: 1
robot: {model: ur10, tool: ee_link}
clock: 8 ms
duration: 0.4 s
start: {q: [0.637139, -1.494124, 2.14183, -2.218502, -1.570796, 0.637139]}
blocks:
  path:        {type: circle, center: [0.4, 0.45, 0.3], radius: 0.05, rate: 0.5 rad/s}
  attitude:    {type: turning, orientation: [0, 90 deg, 0], axis: [0, 0, 1], amplitude: 20 deg, rate: 10 rad/s}
  geometry:    {type: kinematics}
  orientation: {type: tool_orientation, lever: 0.5}
  task:        {type: pose_tracking, gamma: 1}
  inverse:     {type: kinematic_command}
  servo:       {type: pi_servo, K_P: [800, 800, 400, 16, 8, 0.8], K_I: [1760, 1760, 880, 35.2, 17.6, 1.76]}
  arm:         {type: manipulator}
"""


@pytest.mark.parametrize("engine", ["compiled", "interpreted"])
def test_of_a_pose_the_turn_has_figures_of_its_own_in_degrees(engine: Any) -> None:
    gains, options = {"task.gamma": [1, 5]}, {"engine": engine, "limits": {"error": "2 mm", "turn": "0.5 deg"}}
    found = dm.sweep(SWINGING, gains, **options)
    assert (found["turn_rms_final"].units, found["turn_most"].units, found["rms_final"].units) == ("deg", "deg", "m")
    run = dm.load(SWINGING).set({"task.gamma": 5}).run()
    assert run.turn is not None
    mine = found.sel({"task.gamma": 5})
    np.testing.assert_allclose(mine["turn_rms_by_eighth"], run.turn.rms_by_eighth, rtol=1e-6)
    np.testing.assert_allclose(mine["turn_rms_final"], run.turn.rms_final, rtol=1e-6)
    np.testing.assert_allclose(mine["turn_most"], run.turn.angle.max(), rtol=1e-6)
    assert mine["turn_crossed"] == run.turn.times[np.argmax(run.turn.angle > 0.5)]
    assert np.max(np.abs(found["turn_most"] - found["error_most"])) > 0.5, "an angle, not a distance"


def test_a_study_has_them_as_columns_too(tmp_path: Path) -> None:
    (tmp_path / "swinging.yaml").write_text(SWINGING, encoding="utf-8")
    (tmp_path / "study.yaml").write_text(
        "dmframe-study: 1\ngraph: swinging.yaml\ngrid: {task.gamma: [1, 5]}\nmeasure: {limits: {turn: 0.5 deg}}\n",
        encoding="utf-8",
    )
    study = load_study(tmp_path / "study.yaml")
    units = {column.name: column.unit for column in study.measures}
    assert (units["turn_final"], units["turn_8"], units["turn_most"], units["turn_crossed"]) == (
        "deg",
        "deg",
        "deg",
        "s",
    )
    rows = study.rows(1, 0, 1)
    run = dm.load(SWINGING).set({"task.gamma": 5}).run()
    assert run.turn is not None
    assert rows["turn_final"][0] == pytest.approx(run.turn.rms_final, rel=1e-6)
    assert rows["turn_most"][0] == pytest.approx(run.turn.angle.max(), rel=1e-6)
    assert rows["turn_crossed"][0] == run.turn.times[np.argmax(run.turn.angle > 0.5)]
    assert statistic("worst turn_final", study.measures, dm.load(SWINGING).diagram).unit == "deg"


@pytest.mark.parametrize(("design", "shape"), [("list", (1,)), ("grid", ())])
def test_a_sweep_of_nothing_is_one_run(design: Any, shape: tuple[int, ...]) -> None:
    found = dm.sweep("pendulum", {}, until=0.1, design=design)
    assert found["rms_final"].shape == shape


def test_limits_may_have_units_and_one_signal_may_be_alone() -> None:
    one = dm.sweep("pendulum", {"dynamics.Gamma": [1]}, until=0.1, signals="servo.u", limits={"error": "1 mrad"})
    two = dm.sweep("pendulum", {"dynamics.Gamma": [1]}, until=0.1, signals=["servo.u"], limits={"error": 1e-3})
    assert one.identical(two)


@pytest.mark.parametrize(
    ("values", "options", "text"),
    [
        ({"dynamics.Gamma": [1, -1, 0]}, {}, "dynamics.Gamma: expected a number > 0, found -1.0"),
        ({"dynamics.Gama": [1]}, {}, "unknown parameter of dynamic_compensator; did you mean Gamma?"),
        ({"dynamics.Gamma": []}, {}, "values dynamics.Gamma: expected at least one value, found none"),
        ({"dynamics.Gamma": [1, 2], "servo.K_P": [3]}, {"design": "list"}, "dynamics.Gamma 2, servo.K_P 1"),
        ({"dynamics.Gamma": [1]}, {"design": "cube"}, "design: expected grid or list, found 'cube'"),
        ({"dynamics.Gamma": [1]}, {"signals": ["arm.w"]}, "signals: unknown signal"),
        ({"dynamics.Gamma": ["fast"]}, {}, "Gamma"),
        ({"dynamics.Gamma": np.array(3)}, {}, "values dynamics.Gamma: expected a list of values"),
        ({5: [1]}, {}, "values: expected values by name"),
        ({"dynamics.Gamma": [1], "blocks.dynamics.Gamma": [2]}, {}, "are the same parameter; remove one"),
        ({"dynamics.Gamma": range(1, 10**5), "servo.K_P": range(1, 10**5)}, {}, "found 9999800001; take fewer"),
        ({"dynamics.Gamma": [1]}, {"signals": 5}, 'signals: expected names such as ["servo.u"], found 5'),
        ({"dynamics.Gamma": [1]}, {"signals": [["servo.u"]]}, "signals: expected names"),
        ({"dynamics.Gamma": [1]}, {"limits": [1]}, "limits: expected numbers by name"),
        ({"dynamics.Gamma": [1]}, {"limits": {"error": "5 kg"}}, "limits.error: expected a quantity in rad"),
        ({"dynamics.Gamma": [1]}, {"limits": {"error": float("nan")}}, "limits.error: expected"),
        ({"dynamics.Gamma": [1]}, {"limits": {"error": -1}}, "limits.error: expected a number of at least 0"),
        ({"dynamics.Gamma": [1]}, {"limits": {"eror": "1 mm"}}, "limits: unknown measured signal"),
    ],
)
def test_a_sweep_that_is_not_possible_is_an_error(values: Any, options: Any, text: str) -> None:
    with pytest.raises(DmframeError) as caught:
        dm.sweep("pendulum", values, until=0.1, **options)
    assert text in str(caught.value)


def test_a_swept_duration_is_a_coordinate_only() -> None:
    found = dm.sweep("pendulum", {"duration": ["0.02 s", "0.04 s"]})
    assert "duration" not in found.attrs
    assert list(found["duration"].values) == ["0.02 s", "0.04 s"]


def test_a_parameter_that_the_graph_leaves_out_can_be_swept() -> None:
    found = dm.sweep("ur10_fast", {"inverse.w_I_box": [[0.1, 30], [0.2, 30]]}, until="0.02 s")
    assert found.sizes["inverse.w_I_box"] == 2
