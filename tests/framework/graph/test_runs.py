"""Several runs: compared, and swept over values."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dmframe as dm
from dmframe.common.errors import DmframeError, UnknownNameError

pytestmark = pytest.mark.usefixtures("without_v")


def same(one: dm.Run, other: dm.Run) -> bool:
    return all(np.array_equal(one.recording[label], other.recording[label]) for label in one)


def test_variants_compared_are_the_runs_that_the_graphs_alone_would_give() -> None:
    base = dm.load("arm2_joint").until("0.1 s")
    runs = dm.compare(base.variants({"dynamics.Gamma": [1, 10, 100]}))
    assert runs.labels == ("arm2_joint Gamma=1", "arm2_joint Gamma=10", "arm2_joint Gamma=100")
    for run, gamma in zip(runs, (1, 10, 100), strict=True):
        assert same(run, base.set({"dynamics.Gamma": gamma}).run())
    assert not same(runs[0], runs[2])


def test_variants_are_every_combination_also_of_other_things_than_numbers() -> None:
    graphs = dm.load("arm2_joint").variants({"clock": ["2 ms", "4 ms"], "dynamics.Gamma": [1, 2]})
    runs = dm.compare(graphs, until=0.05)
    assert [run.recording.clock for run in runs] == [0.002, 0.002, 0.004, 0.004]
    assert len(set(runs.labels)) == 4


def test_values_that_are_not_allowed_are_errors_before_anything_runs() -> None:
    with pytest.raises(DmframeError) as caught:
        dm.load("pendulum").variants({"dynamics.Gamma": [1, -1, 0]})
    assert "Gamma=-1" in str(caught.value)
    assert "Gamma=0" in str(caught.value)
    with pytest.raises(DmframeError, match=r"values dynamics\.Gamma: expected at least one value, found none"):
        dm.load("pendulum").variants({"dynamics.Gamma": []})


def test_what_is_compared_is_run_and_labelled_by_what_was_set() -> None:
    graph = dm.load("pendulum").set(duration=0.1)
    done = graph.run()
    runs = dm.compare([done, graph.set({"dynamics.Gamma": 1}), "pendulum"], until=0.1)
    assert runs.labels == ("pendulum duration=0.1", "pendulum duration=0.1, Gamma=1", "pendulum")
    assert runs[0].recording is done.recording
    assert runs["pendulum duration=0.1, Gamma=1"] is runs[1]
    with pytest.raises(UnknownNameError, match="did you mean pendulum"):
        runs["pendulun"]
    own = [f"estimates_{name}" for name in runs.labels]  # without V, which this file omits
    assert list(runs.plot()) == ["error", "path", "commands", "effort", *own]
    assert list(runs.plot("arm.q")) == ["signals"]
    assert str(runs).splitlines()[1].startswith("pendulum")


def test_a_table_has_a_row_a_run_with_the_error_in_each_eighth() -> None:
    runs = dm.compare(dm.load("pendulum").variants({"dynamics.Gamma": [1, 10]}), until="0.4 s")
    table = runs.table
    assert list(table.index) == list(runs.labels)
    for run in runs:
        assert run.error is not None
        assert table.loc[run.name, "rms_8"] == run.error.rms_final
        assert table.loc[run.name, "unit"] == "rad"


def test_runs_are_saved_side_by_side(tmp_path: Path) -> None:
    runs = dm.compare(dm.load("pendulum").variants({"dynamics.Gamma": [1, 10]}), until="0.1 s")
    runs.save(tmp_path / "out", plots=False)
    names = sorted(item.name for item in (tmp_path / "out").iterdir() if item.is_dir())
    assert names == ["pendulum_Gamma_1", "pendulum_Gamma_10"]
    for name, gamma in zip(names, (1.0, 10.0), strict=True):
        assert dm.load(tmp_path / "out" / name / "graph.yaml").blocks["dynamics"].Gamma == gamma  # type: ignore[attr-defined]


@pytest.mark.parametrize("labels", [["arm.qq"], ["arm.q", "nothing"]])
def test_a_signal_that_was_not_recorded_is_not_drawn(labels: Any) -> None:
    with pytest.raises(DmframeError, match=f"plot {labels[-1]}: unknown signal"):
        dm.run("pendulum", 0.1).plot(*labels)
