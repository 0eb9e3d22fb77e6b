"""Studies: the content of their files; a row and the graph of its run have exactly the same numbers."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from ruamel.yaml import YAML

from dmframe.batch.columns import joined
from dmframe.common.errors import DmframeError
from dmframe.graph.load import load
from dmframe.results.metrics import tracking_error
from dmframe.study.box import box_of
from dmframe.study.grammar import study_schema
from dmframe.study.packing import folder_files
from dmframe.study.plan import Study
from dmframe.study.read import load_study

Make = Callable[..., Study]

TEXT = """\
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


def test_the_table_has_a_column_for_all_that_varies_with_its_unit(study: Make) -> None:
    found = study(TEXT)
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


def test_a_row_is_what_the_graph_of_its_run_gives_alone(study: Make) -> None:
    found = study(TEXT)
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


def test_the_numbers_of_a_row_are_those_of_its_graph_to_the_last_bit(study: Make) -> None:
    found = study(TEXT)
    values, drawn = found.values(3, 2, 3), found.drawn(2, 3)
    graph = found.graph_of(2 * 4 + 3)

    for each in (graph, load(graph.text)):
        blocks = each.blocks
        assert tuple(values["servo.K_I"][0]) == blocks["servo"].K_I  # type: ignore[attr-defined]
        assert (60 * drawn["servo.K_P"][0], 30 * drawn["servo.K_P"][0]) == blocks["servo"].K_P  # type: ignore[attr-defined]
        assert blocks["arm"].viscous == drawn["arm.viscous"][0]  # type: ignore[attr-defined]
        assert blocks["dynamics"].Gamma == 10  # type: ignore[attr-defined]
        assert each.clock == 0.002


def test_chunks_make_no_difference_and_points_share_their_samples(study: Make) -> None:
    found = study(TEXT)
    whole, parts = found.rows(1, 0, 6), [found.rows(1, *each) for each in ((0, 1), (1, 5), (5, 6))]
    for name, column in whole.items():
        assert list(column) == pytest.approx([item for part in parts for item in part[name]], abs=0, nan_ok=True), name
    assert whole["servo.K_P"].tolist() == found.rows(0, 0, 6)["servo.K_P"].tolist()


def test_a_pickled_study_is_small_and_gives_the_same_rows(study: Make) -> None:
    found = study(TEXT)
    _ = found.measures
    data = pickle.dumps(found)
    assert len(data) < 50_000
    again = pickle.loads(data)
    assert (again.key, again.runs) == (found.key, found.runs)
    assert pickle.loads(data) is again, "a worker would build its closed loops again"
    assert again.rows(0, 0, 2)["rms_final"].tolist() == found.rows(0, 0, 2)["rms_final"].tolist()


def test_the_key_covers_what_decides_a_row_and_not_how_many_there_are(study: Make, arm: Path) -> None:
    key = study(TEXT).key
    assert study(TEXT, runs=50).key == key
    assert study(TEXT.replace("seed: 3", "seed: 4")).key != key
    assert study(TEXT.replace("0.2 s", "0.3 s")).key != key
    assert study(TEXT.replace("1.25", "1.26")).key != key
    assert study(TEXT.replace("[1, 10]", "[1, 11]")).key != key
    assert study(TEXT.replace("1 mm", "2 mm")).key != key
    latin = TEXT.replace("runs: 6", "runs: 6\n  method: latin_hypercube")
    assert study(latin).key != study(latin, runs=50).key
    arm.write_text(arm.read_text(encoding="utf-8").replace("gamma: 0.8", "gamma: 0.9"), encoding="utf-8")
    assert study(TEXT).key != key


def test_whole_blocks_and_named_cases_are_points(study: Make) -> None:
    text = """\
set: {duration: 0.1 s}
grid:
  controller:
    adaptive: {}
    kinematic: {blocks.inverse: {type: kinematic_command}, blocks.model: null, blocks.dynamics: null}
  servo: {scale: [1, 2], of: [servo.K_P, servo.K_I]}
"""
    found = study(text)
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


def test_what_shapes_the_loop_is_run_graph_by_graph(study: Make) -> None:
    text = """\
set: {duration: 0.1 s, start: {q: [0.5, 0.5]}}
sample:
  runs: 2
  clock: {uniform: [2 ms, 6 ms]}
  start.q: {shift: [-1 deg, 1 deg], per: joint}
"""
    found = study(text)
    rows = found.rows(0, 0, 2)
    for run in range(2):
        graph = found.graph_of(run)
        assert graph.clock == rows["clock"][run]
        assert graph.start["q"] == [0.5 + rows["start.q[0]"][run], 0.5 + rows["start.q[1]"][run]]
        alone = graph.run(engine="compiled").error
        assert alone is not None
        assert rows["rms_final"][run] == pytest.approx(alone.rms_final, rel=1e-12)


def test_a_run_that_cannot_be_prepared_is_a_row_with_its_fault(study: Make) -> None:
    text = """\
set: {duration: 0.1 s, start: {near: [0.5, 0.5]}}
sample: {runs: 4, path.radius: {uniform: [100 mm, 700 mm]}}
"""
    rows = study(text).rows(0, 0, 4)
    far = np.hypot(0.5, 0.3 + rows["path.radius"]) > 0.85  # the length of the stretched arm
    assert far.any()
    assert not far.all()
    assert [fault is not None for fault in rows["fault"]] == far.tolist()
    assert np.isnan(rows["rms_final"]).tolist() == far.tolist()
    assert not rows["diverged"].any()


def test_the_schema_takes_what_the_grammar_takes_and_refuses_a_wrong_key() -> None:
    validator = jsonschema.Draft202012Validator(study_schema())
    data = {"dmframe-study": 1, "graph": "arm.yaml", **YAML(typ="safe", pure=True).load(TEXT)}
    assert list(validator.iter_errors(data)) == []
    for wrong in (
        {"sample": {"servo.K_P": {"scale": [1, 2], "pre": "joint"}}},
        {"sample": {"runs": "many"}},
        {"grid": {"clock": 3}},
        {"measure": {"signal": []}},
    ):
        assert list(validator.iter_errors({**data, **wrong})), wrong


def test_points_that_differ_in_numbers_run_together_and_give_the_same_rows(study: Make) -> None:
    found = study(f"""\
set: {{duration: 0.2 s}}
sample: {{runs: 2, servo.K_P: {{scale: [0.8, 1.25]}}, servo.K_I: {{scale: {{log: [0.5, 2]}}, per: joint}}}}
grid:
  dynamics.Gamma: [1, {[*range(1, 23)]}, 3]
  servo: {{scale: [0.5, 1], of: [servo.K_P, servo.K_I]}}
  case:
    slow: {{clock: 4 ms, inverse.w_box: [0, 0.1]}}
    fast: {{clock: 2 ms, arm.viscous: [2, 0], inverse.w_box: [0, 0.2]}}
""")
    assert len(found.points) == 12
    together = found.band(1, 12, 0, 2)
    alone = joined([found.rows(point, 0, 2) for point in range(1, 12)])
    assert together.keys() == alone.keys()
    for name, column in alone.items():
        assert np.array_equal(together[name], column, equal_nan=isinstance(column[0], float)), name
    assert len(set(together["rms_final"])) == 22


def test_points_of_unlike_stiffness_run_together_as_each_of_them_alone(study: Make) -> None:
    found = study("""\
set: {duration: 0.2 s, solver.share: 0.5}
grid:
  servo: {scale: [1, 30, 3, 10, 0.3], of: [servo.K_P, servo.K_I]}
  dynamics.Gamma: [1, 10]
""")
    rows, steps = found.band(0, 10, 0, 1), set[float]()
    for run in range(10):
        alone = found.graph_of(run).run(engine="compiled")
        steps.add(alone.recording.solver.step or 0.0)
        assert alone.error is not None
        assert rows["rms_final"][run] == pytest.approx(alone.error.rms_final, rel=1e-12)
    assert len(steps) > 2


def test_a_signal_that_no_closed_loop_has_is_refused_with_a_grid_too(study: Make) -> None:
    measure = "measure: {signals: [servo.nope, error], limits: {servo.u: 1 V, servo.v: 1}}"
    for grid in ("", "grid: {dynamics.Gamma: [1, 10]}\n"):
        with pytest.raises(DmframeError) as caught:
            study(f"{grid}{measure}\n").check()
        faults = [str(fault) for fault in caught.value.faults]
        places = ["servo.nope", "error", "servo.v"]
        assert len(faults) == len(places)
        assert all("unknown signal" in fault and "study.yaml:" in fault for fault in faults)


def test_a_signal_that_one_of_the_closed_loops_has_is_measured_there(study: Make) -> None:
    cases = "known: {blocks.dynamics: {type: dynamic_compensator, Gamma: 1}}, other: {dynamics.Gamma: 2}"
    study(f"grid: {{dynamics: {{{cases}}}}}\nmeasure: {{signals: [dynamics.tau_dc]}}\n").check()


UNCERTAIN = "uncertain: {servo.K_P: [[50, 30], [70, 31]], servo.K_I: [200, 300], arm.viscous: [[1, 0.4], [1, 0.6]]}\n"


def test_a_study_that_names_nothing_draws_what_the_graph_leaves_uncertain(study: Make, arm: Path) -> None:
    arm.write_text(arm.read_text().replace("K_I: [240, 120]", "K_I: [240, 220]") + UNCERTAIN)
    found = study("set: {arm.viscous: [1, 0.45]}\nsample: {runs: 400, seed: 2}\n")
    assert [column.name for column in found.varied] == [
        f"{label}[{k}]" for label in ("servo.K_P", "servo.K_I") for k in (0, 1)
    ]
    drawn = found.drawn(0, 400)
    ends = {"servo.K_P[0]": (50, 70), "servo.K_P[1]": (30, 31), "servo.K_I[0]": (200, 300), "servo.K_I[1]": (200, 300)}
    for name, (low, high) in ends.items():
        assert low <= drawn[name].min() < low + 0.1 * (high - low)
        assert high - 0.1 * (high - low) < drawn[name].max() <= high
    assert abs(np.corrcoef(drawn["servo.K_I[0]"], drawn["servo.K_I[1]"])[0, 1]) < 0.2
    box = box_of(found.points[0].graph.diagram, found.factors)
    assert {label: [end.tolist() for end in pair] for label, pair in box.ends.items()} == {
        "servo.K_P": [[50, 30], [70, 31]],
        "servo.K_I": [[200, 200], [300, 300]],
    }
    arm.with_name("kept.yaml").write_text(found.text)  # as in a folder of results
    assert load_study(arm.with_name("kept.yaml")).key == found.key
    other = study("sample: {runs: 400, seed: 2, servo.K_P: {scale: [0.9, 1.1]}}\n")
    assert [column.name for column in other.varied] == ["servo.K_P"]


def test_what_the_study_sets_itself_is_not_drawn(study: Make, arm: Path) -> None:
    arm.write_text(arm.read_text().replace("K_I: [240, 120]", "K_I: [240, 220]") + UNCERTAIN)
    found = study("set: {servo.K_P: [60, 30.5]}\nsample: {runs: 3}\ngrid: {servo.K_I: [210, 220]}\n")
    assert [column.name for column in found.varied] == ["servo.K_I", "arm.viscous[0]", "arm.viscous[1]"]
    assert np.all(found.drawn(0, 3)["arm.viscous[0]"] == 1)
    assert np.allclose(found.graph_of(3).blocks["servo"].K_P, [60, 30.5])


def test_a_graph_with_intervals_is_a_study_of_them(arm: Path, tmp_path: Path) -> None:
    arm.write_text(arm.read_text() + "uncertain: {servo.K_P: [[50, 30], [70, 31]]}\n")
    found = load_study(arm, runs=5)
    assert (found.name, found.samples, load_study(arm).samples) == ("arm", 5, 100)
    kept = folder_files(found)
    for name, content in kept.items():
        (tmp_path / "kept").mkdir(exist_ok=True)
        (tmp_path / "kept" / name).write_bytes(content)
    again = load_study(tmp_path / "kept" / "study.yaml")
    assert again.key == found.key
    assert again.drawn(0, 5).keys() == {"servo.K_P[0]", "servo.K_P[1]"}
