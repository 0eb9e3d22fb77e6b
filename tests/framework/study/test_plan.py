"""Studies: what their files say, and that a row and the graph of its run have the very same numbers."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dmframe.results.metrics import tracking_error
from dmframe.study.plan import Study, load_study

TEXT = """\
dmframe-study: 1
graph: arm.yaml
set: {duration: 0.2 s}
sample:
  runs: 6
  seed: 3
  servo.K_P: {scale: [0.8, 1.25]}
  servo.K_I: {scale: {log: [0.5, 2]}, per: joint}
  arm.viscous: {normal: [1 N m s/rad, 0.5 N m s/rad], clip: [0.1 N m s/rad, 3 N m s/rad]}
grid:
  dynamics.Gamma: [1, 10]
  clock: [4 ms, 2 ms]
measure: {signals: [servo.u], limits: {error: 1 mm, servo.u: 0.005 kV}}
"""

ARM = """\
dmframe: 1
title: A planar arm
robot: arm2
clock: 4 ms
duration: 1 s
start: {q: [0.5, 0.5]}
blocks:
  path:     {type: circle, center: [0.5, 0.3], radius: 0.1, rate: 1 rad/s}
  geometry: {type: kinematics}
  task:     {type: task_tracking, gamma: 0.8}
  model:    {type: regressor, friction: [viscous]}
  dynamics: {type: dynamic_compensator, Gamma: 1}
  inverse:  {type: pi_inverse, Lambda: 0.01, Lambda_I: 1, w_I: 2}
  servo:    {type: pi_servo, K_P: [60, 30], K_I: [240, 120]}
  arm:      {type: manipulator, viscous: [1, 0.5]}
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "arm.yaml").write_text(ARM, encoding="utf-8")
    return tmp_path


def study(folder: Path, text: str = TEXT, **options: Any) -> Study:
    (folder / "study.yaml").write_text(text, encoding="utf-8")
    return load_study(folder / "study.yaml", **options)


def test_the_table_has_a_column_for_all_that_varies_with_its_unit(folder: Path) -> None:
    found = study(folder)
    assert (len(found.points), found.samples, found.runs) == (4, 6, 24)
    assert [(column.name, column.unit, column.kind, column.how) for column in found.varied] == [
        ("dynamics.Gamma", "", "grid", "value"),
        ("clock", "s", "grid", "value"),
        ("servo.K_P", "", "sampled", "scale"),
        ("servo.K_I[0]", "", "sampled", "scale"),
        ("servo.K_I[1]", "", "sampled", "scale"),
        ("arm.viscous", "N m s/rad", "sampled", "value"),
    ]
    assert [dict(point.values) for point in found.points] == [
        {"dynamics.Gamma": Gamma, "clock": clock} for Gamma in (1.0, 10.0) for clock in (0.004, 0.002)
    ]


def test_a_row_is_what_the_graph_of_its_run_gives_alone(folder: Path) -> None:
    found = study(folder)
    rows = found.rows(2, 1, 4)
    assert rows["run"].tolist() == [6, 10, 14]
    for k, run in enumerate(rows["run"].tolist()):
        recording = found.graph_of(run).run(engine="compiled").recording
        error = tracking_error(recording)
        assert error is not None
        assert [rows[f"rms_{k_ + 1}"][k] for k_ in range(8)] == pytest.approx(error.rms_by_eighth, rel=1e-12)
        assert rows["error_most"][k] == pytest.approx(error.norm.max(), rel=1e-12)
        assert rows["servo.u[1].least"][k] == recording["servo.u"][:, 1].min()
        beyond = np.abs(recording["servo.u"][:, 0]) > 5.0
        crossed = recording.time[beyond.argmax()] if beyond.any() else np.nan
        assert rows["servo.u[0].crossed"][k] == pytest.approx(crossed, nan_ok=True)
    assert rows["fault"] == [None] * 3


def test_the_numbers_of_a_row_are_those_of_its_graph_to_the_last_bit(folder: Path) -> None:
    found = study(folder)
    values, drawn = found.values(3, 2, 3), found.drawn(2, 3)
    graph = found.graph_of(2 * 4 + 3)

    for each in (graph, load(graph.text)):
        blocks = each.experiment.blocks
        assert tuple(values["servo.K_I"][0]) == blocks["servo"].K_I  # type: ignore[attr-defined]
        assert (60 * drawn["servo.K_P"][0], 30 * drawn["servo.K_P"][0]) == blocks["servo"].K_P  # type: ignore[attr-defined]
        assert blocks["arm"].viscous == drawn["arm.viscous"][0]  # type: ignore[attr-defined]
        assert blocks["dynamics"].Gamma == 10  # type: ignore[attr-defined]
        assert each.clock == 0.002


def test_chunks_make_no_difference_and_points_share_their_samples(folder: Path) -> None:
    found = study(folder)
    whole, parts = found.rows(1, 0, 6), [found.rows(1, *each) for each in ((0, 1), (1, 5), (5, 6))]
    for name, column in whole.items():
        assert list(column) == pytest.approx([item for part in parts for item in part[name]], abs=0, nan_ok=True), name
    assert whole["servo.K_P"].tolist() == found.rows(0, 0, 6)["servo.K_P"].tolist()


def test_a_pickled_study_is_small_and_gives_the_same_rows(folder: Path) -> None:
    found = study(folder)
    _ = found.measures
    data = pickle.dumps(found)
    assert len(data) < 50_000
    again = pickle.loads(data)
    assert (again.key, again.runs) == (found.key, found.runs)
    assert pickle.loads(data) is again, "a worker would build its closed loops again"
    assert again.rows(0, 0, 2)["rms_final"].tolist() == found.rows(0, 0, 2)["rms_final"].tolist()


def test_the_key_covers_what_decides_a_row_and_not_how_many_there_are(folder: Path) -> None:
    key = study(folder).key
    assert study(folder, runs=50).key == key
    assert study(folder, TEXT.replace("seed: 3", "seed: 4")).key != key
    assert study(folder, TEXT.replace("0.2 s", "0.3 s")).key != key
    assert study(folder, TEXT.replace("1.25", "1.26")).key != key
    assert study(folder, TEXT.replace("[1, 10]", "[1, 11]")).key != key
    assert study(folder, TEXT.replace("1 mm", "2 mm")).key != key
    latin = TEXT.replace("runs: 6", "runs: 6\n  method: latin_hypercube")
    assert study(folder, latin).key != study(folder, latin, runs=50).key
    (folder / "arm.yaml").write_text(ARM.replace("gamma: 0.8", "gamma: 0.9"), encoding="utf-8")
    assert study(folder).key != key


def test_whole_blocks_and_named_cases_are_points(folder: Path) -> None:
    text = """\
dmframe-study: 1
graph: arm.yaml
set: {duration: 0.1 s}
grid:
  controller:
    adaptive: {}
    kinematic: {blocks.inverse: {type: kinematic_command}, blocks.model: null, blocks.dynamics: null}
  servo: {scale: [1, 2], of: [servo.K_P, servo.K_I]}
"""
    found = study(folder, text)
    assert [tuple(point.values.values()) for point in found.points] == [
        ("adaptive", 1.0),
        ("adaptive", 2.0),
        ("kinematic", 1.0),
        ("kinematic", 2.0),
    ]
    last = found.points[3].graph
    assert "dynamics" not in last.blocks
    assert last.blocks["servo"].K_I == (480.0, 240.0)  # type: ignore[attr-defined]
    for point in (0, 3):
        rows, alone = found.rows(point, 0, 1), found.graph_of(point).run(engine="compiled").error
        assert alone is not None
        assert rows["rms_final"][0] == pytest.approx(alone.rms_final, rel=1e-12)


def test_what_shapes_the_loop_is_run_graph_by_graph(folder: Path) -> None:
    text = """\
dmframe-study: 1
graph: arm.yaml
set: {duration: 0.1 s}
sample:
  runs: 2
  clock: {uniform: [2 ms, 6 ms]}
  start.q: {shift: [-1 deg, 1 deg], per: joint}
"""
    found = study(folder, text)
    rows = found.rows(0, 0, 2)
    for run in range(2):
        graph = found.graph_of(run)
        assert graph.clock == rows["clock"][run]
        assert graph.experiment.start["q"] == [0.5 + rows["start.q[0]"][run], 0.5 + rows["start.q[1]"][run]]
        alone = graph.run(engine="compiled").error
        assert alone is not None
        assert rows["rms_final"][run] == pytest.approx(alone.rms_final, rel=1e-12)


def test_a_run_that_cannot_be_made_is_a_row_with_its_fault(folder: Path) -> None:
    text = """\
dmframe-study: 1
graph: arm.yaml
set: {duration: 0.1 s, start: {near: [0.5, 0.5]}}
sample: {runs: 4, path.radius: {uniform: [100 mm, 700 mm]}}
"""
    rows = study(folder, text).rows(0, 0, 4)
    far = np.hypot(0.5, 0.3 + rows["path.radius"]) > 0.85  # the length of the stretched arm
    assert far.any()
    assert not far.all()
    assert [fault is not None for fault in rows["fault"]] == far.tolist()
    assert np.isnan(rows["rms_final"]).tolist() == far.tolist()
    assert not rows["diverged"].any()
