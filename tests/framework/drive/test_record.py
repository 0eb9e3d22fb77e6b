"""The record of a drive has the form of a run's record, and can be replayed."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import h5netcdf
import numpy as np
import pytest

import dmframe as dm
from dmframe.common.errors import DriveError, MissingError
from dmframe.results.run import Run

pytestmark = pytest.mark.usefixtures("without_v")


@cache
def graph() -> dm.Graph:
    return dm.load("ur10_fast")


@cache
def drive() -> Run:
    return graph().drive(until="0.4 s", engine="interpreted")


def test_its_signals_are_those_of_the_run_bit_by_bit() -> None:
    run, found = graph().run("0.4 s", engine="interpreted", progress=False).recording, drive().recording
    assert found.duration == run.duration
    assert found.time.tobytes() == run.time.tobytes()
    assert set(found.states) == {label for label in run.states if not label.startswith(("arm", "servo"))}
    own = set(run.outputs) & set(found.outputs)
    assert {"path.x_d", "task.dq_r", "dynamics.tau_dc", "inverse.dq_c", "inverse.sigma", "arm.x"} <= own
    for label in (*own, *found.states):
        assert found[label].tobytes() == np.ascontiguousarray(run[label]).tobytes(), label
    for label in ("arm.q", "arm.dq", "servo.q_c"):
        assert found[label].tobytes() == np.ascontiguousarray(run[label]).tobytes(), label
    assert not any(label in found.outputs for label in ("servo.u", "arm.ddq", "arm.g"))  # not measured by robots
    error, other = drive().error, Run(graph(), run).error
    assert error is not None
    assert other is not None
    assert error.rms_by_eighth == other.rms_by_eighth


def test_the_signals_of_a_robot_that_is_slowed_down_are_those_that_its_controller_had() -> None:
    found = graph().drive(until="0.2 s", ramp="0.1 s", engine="interpreted").recording
    assert 0 < found["robot.scale"][0, 0] < 1
    scaled = found["inverse.dq_c"] * found["robot.scale"]
    np.testing.assert_allclose(found["robot.sent"], scaled, rtol=1e-12)
    assert found["robot.time"][-1, 0] > found.time[-1]
    around = found["path.x_d"][:, :2] - [-0.07, 0.67]
    np.testing.assert_allclose(around @ around[0] / 0.15**2, np.cos(found.time), atol=1e-9)


def test_its_files_have_the_sent_commands_with_units(tmp_path: Path) -> None:
    drive().save(tmp_path / "out", plots=False)
    with h5netcdf.File(tmp_path / "out" / "signals.nc", "r") as file:
        for name, unit in (("sent", "rad/s"), ("answer", "s"), ("age", "s"), ("missed", "1"), ("scale", "1")):
            assert file.variables[f"robot.{name}"].attrs["units"] == unit
        assert file.variables["robot.sent"].dimensions == ("time", "joint")
        assert file.variables["robot.scale"].dimensions == ("time",)
    message = " ".join(drive().notices)
    assert "robot: sim" in message
    assert "measured latency" in message


def test_every_figure_is_drawn_that_needs_no_hidden_signal() -> None:
    assert {"error", "path", "commands", "estimates"} <= set(drive().plot())


def test_where_the_controller_waited_its_signals_are_no_numbers_and_figures_leave_them_out() -> None:
    found = graph().drive(until="0.1 s", ramp="4 s", engine="interpreted")
    waited = found.recording["robot.scale"][:, 0] == 0
    assert 0 < waited.sum() < len(waited)
    velocity = found.recording["geometry.dx"]
    assert np.isnan(velocity[waited]).all()
    assert np.isfinite(velocity[~waited]).all()
    assert not np.isinf(found.recording["dynamics.tau_dc"]).any()  # of a slow joint at a pace of zero
    drawn = found.plot()["effort"]
    for axes in drawn.axes:
        assert np.isfinite(axes.get_ylim()).all()
        assert np.abs(axes.get_ylim()).max() < 1e6
        assert all(np.isfinite(line.get_ydata()).all() for line in axes.lines)


def test_a_slow_robots_record_has_the_sent_commands() -> None:
    found = graph().drive(until="0.1 s", ramp="4 s", engine="interpreted")
    axes = found.plot()["commands"].axes[0]
    _, commanded = (line.get_ydata() for line in axes.lines)
    np.testing.assert_allclose(commanded, found.recording["robot.sent"][:, 0])
    assert np.abs(commanded).max() < 0.3 * np.abs(found.recording["inverse.dq_c"][:, 0]).max()


def test_in_shadow_no_latency_is_reported() -> None:
    found = graph().drive(until="0.1 s", shadow=True, engine="interpreted")
    assert any("no command was sent" in notice for notice in found.notices)
    assert not any("latency" in notice for notice in found.notices)


def test_what_the_graph_takes_for_true_is_not_called_true_of_a_robot_that_was_driven() -> None:
    texts = [text.get_text() for axes in drive().plot()["estimates"].axes for text in axes.get_legend().texts]
    assert any("(in the graph " in text for text in texts)
    assert not any("(true " in text for text in texts)


def test_a_record_played_again_is_identical_and_with_another_gain_it_is_not(tmp_path: Path) -> None:
    late = graph().drive("sim:1", until="0.4 s", ramp="0.1 s", engine="interpreted")
    late.save(tmp_path / "log", plots=False)
    same = graph().replay(tmp_path / "log", engine="interpreted")
    assert same.identical
    assert str(same).startswith("ur10_fast: inverse.dq_c, robot.sent and ")
    assert str(same).endswith(
        f"of {len(late.time)} samples of {tmp_path / 'log'}, recomputed by the interpreted engine: "
        "identical, bit by bit"
    )
    other = graph().set({"inverse.K_c": 0.9}).replay(tmp_path / "log" / "signals.nc", engine="interpreted")
    assert other.differs is not None
    assert "different\n  inverse.dq_c: first difference at t = " in str(other)
    apart = np.nanmax(np.abs(other.now - other.then))
    assert other.summary["largest_difference"] == apart > 1e-6


def test_one_wrong_number_of_a_measurement_is_found_where_it_is(tmp_path: Path) -> None:
    run = drive()
    measured = {label: values.copy() for label, values in run.recording.outputs.items()}
    measured["arm.q"][30, 1] = measured["arm.q"][30, 1] + 1e-12
    Run(run.graph, replace(run.recording, outputs=measured)).save(tmp_path / "log", plots=False)
    assert graph().replay(tmp_path / "log", engine="interpreted").differs == 30


def test_a_run_is_played_again_too(tmp_path: Path) -> None:
    graph().run("0.4 s", engine="interpreted", progress=False).save(tmp_path / "log", plots=False)
    assert graph().replay(tmp_path / "log", engine="interpreted").identical


def test_what_is_not_a_record_or_lacks_a_signal_is_reported(tmp_path: Path) -> None:
    with pytest.raises(MissingError, match=r"expected a folder of results, or its signals.nc, found none"):
        graph().replay(tmp_path / "none")
    (tmp_path / "other.nc").write_text("nothing")
    with pytest.raises(MissingError, match="expected a record of dmframe, found another file"):
        graph().replay(tmp_path / "other.nc")
    graph().drive(until="0.02 s", engine="interpreted").save(tmp_path / "arm", plots=False)
    with pytest.raises(
        MissingError, match=r"expected a record with encoder.dq_m, which this controller needs, found none"
    ):
        graph().reality({"encoder": {"step": 5e-5}}).replay(tmp_path / "arm", engine="interpreted")


def test_a_record_of_another_robot_clock_or_of_some_samples_is_reported(tmp_path: Path) -> None:
    each = "expected a sample each 8 ms, the graph's clock, found"
    for k, (name, changed, message) in enumerate(
        (
            (
                "arm2_joint",
                {"clock": "8 ms"},
                "expected 6 x 3 numbers, as this controller has, found 6 x 2; the record is",
            ),
            ("ur10_fast", {"clock": "4 ms"}, f"{each} 4 ms after t = 0 s; the record has another clock"),
            ("ur10_fast", {"log.every": "16 ms"}, f"{each} 16 ms after t = 0 s; the record has another clock, or log"),
        )
    ):
        run = dm.load(name).set(changed).run(5 * 0.008, engine="interpreted", progress=False)
        run.save(tmp_path / str(k), plots=False)
        with pytest.raises(MissingError, match=message):
            graph().replay(tmp_path / str(k), engine="interpreted")


def test_a_damaged_record_is_reported(tmp_path: Path) -> None:
    drive().save(tmp_path / "whole", plots=False)
    content = (tmp_path / "whole" / "signals.nc").read_bytes()
    file = tmp_path / "signals.nc"
    damaged = [content[: len(content) // share] for share in (2, 10, 100)]
    # in the names of the signals: HDF5 detects a wrong checksum
    place = content.index(b"inverse.dq_c")
    damaged.append(content[:place] + b"#" + content[place + 1 :])
    for held in damaged:
        file.write_bytes(held)
        with pytest.raises(MissingError, match="expected a record of dmframe, found another file"):
            graph().replay(file)


def test_a_robot_that_is_not_ready_gives_no_record() -> None:
    with pytest.raises(DriveError, match="the robot was stopped before its first command: deviation: "):
        graph().set({"start": {"arm.q": [1.4, -1.0, 1.0], "servo.q_c": [1.4, -0.7, 1.0]}}).drive(
            until="0.1 s", engine="interpreted"
        )
