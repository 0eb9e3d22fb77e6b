"""`dmframe study`: its output, its files, and its end."""

from __future__ import annotations

import contextlib
import io
import json
import pickle
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from study_processes import PATIENCE, environment

from dmframe.cli import main
from dmframe.graph.load import load
from dmframe.results.metrics import tracking_error
from dmframe.study.execute import State
from dmframe.study.packing import packed, unpacked
from dmframe.study.read import load_study

pytestmark = pytest.mark.usefixtures("without_v")

STUDY = """\
dmframe-study: 1
graph: mine/arm.yaml
set: {duration: 0.1 s}
sample:
  runs: 9
  seed: 3
  servo.K_P: {scale: [0.8, 1.25]}
grid:
  dynamics.Gamma: [1, 10]
"""

ARM = """\
dmframe: 1
title: A pendulum with a block of its own
robot: pendulum
clock: 4 ms
duration: 1 s
start: {q: [0.5]}
blocks:
  path:     {type: "own.py:Mine", center: [0.8], amplitude: 0.5, rate: 1 rad/s}
  task:     {type: joint_tracking, alpha_bar: 2}
  model:    {type: regressor, friction: [viscous]}
  dynamics: {type: dynamic_compensator, Gamma: 1}
  inverse:  {type: pi_inverse, Lambda: 0.01, Lambda_I: 1, w_I: 2}
  servo:    {type: pi_servo, K_P: 60, K_I: 240}
  arm:      {type: manipulator, viscous: 1}
"""

Dmframe = Callable[..., Any]


@pytest.fixture
def mine(tmp_path: Path) -> Path:
    """A study, its graph in a subfolder, and a block next to the graph."""
    folder = tmp_path / "there"
    (folder / "mine").mkdir(parents=True)
    (folder / "study.yaml").write_text(STUDY, encoding="utf-8")
    (folder / "mine" / "arm.yaml").write_text(ARM, encoding="utf-8")
    source = Path(__file__).parents[3] / "blocks" / "dmframe_blocks" / "sinusoid.py"
    text = source.read_text(encoding="utf-8").replace("class Sinusoid(", "class Mine(")
    (folder / "mine" / "own.py").write_text(text, encoding="utf-8")
    return folder / "study.yaml"


@pytest.fixture
def dmframe(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Dmframe:
    """``dmframe study words...`` through its entry point, in this process, so that it is fast."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")

    def call(*words: str) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["dmframe", "study", *words])
        out, err = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), pytest.raises(SystemExit) as stopped:
            main()
        assert "Traceback" not in out.getvalue() + err.getvalue()
        return int(stopped.value.code or 0), out.getvalue(), err.getvalue()

    return call


def started(folder: Path, *words: str) -> subprocess.Popen[str]:
    start = [sys.executable, "-c", "from dmframe.cli import main; main()", "study", *words]
    return subprocess.Popen(
        start, cwd=folder, env=environment(), text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )


@pytest.mark.usefixtures("here")
def test_a_study_runs_grows_reruns_and_moves(mine: Path, tmp_path: Path, dmframe: Dmframe) -> None:
    """One study with all functions of the command, since each loop takes seconds to build."""
    import polars

    status, out, err = dmframe("there/study.yaml", "--dry-run", "--json", "--workers", "1")
    assert status == 0, err
    found = json.loads(out)
    assert (found["points"], found["samples"], found["runs"], found["kept"]) == (2, 9, 18, 0)
    assert found["chunks"] >= 2
    assert found["seconds"] > 0
    assert not (tmp_path / "studies").exists()

    status, out, err = dmframe("there/study.yaml", "--workers", "1")
    assert (status, err) == (0, "")
    assert out.startswith("study: 18 of 18 runs; 18 computed in ")
    assert (
        "\nProved over the sampled box; none of 9 robots diverged at 2 of 2 settings: Gamma = 1 and Gamma = 10; " in out
    )
    assert out.endswith(
        "diverged: 0, not run for a fault: 0\nresults: studies/study\nreport: studies/study/report.html\n"
    )
    page = re.sub(r"<[^>]+>", "", (tmp_path / "studies/study/report.html").read_text("utf-8"))
    assert "Proved over the sampled box; none of 9 robots diverged at 2 of 2 settings" in page

    folder = tmp_path / "studies" / "study"
    moved = tmp_path / "moved"
    shutil.move(folder, moved)
    shutil.rmtree(mine.parent)  # the folder contains the study, its graph and its block
    begun = json.loads((moved / "study.lock.json").read_text("utf-8"))
    (moved / "study.lock.json").write_text(json.dumps(begun | {"study": "arms"}), encoding="utf-8")  # of arms.yaml
    status, out, _ = dmframe("moved", "--json", "--no-report")
    assert json.loads(out)["study"] == "arms"
    assert json.loads((moved / "study.lock.json").read_text("utf-8"))["study"] == "arms"
    assert (status, json.loads(out)["computed"], json.loads(out)["kept"]) == (0, 0, 18)
    assert json.loads(out)["report"] is None
    (moved / "report.html").unlink()
    status, out, err = dmframe("report", "moved")
    assert (status, err) == (0, "")
    assert out.startswith("Proved over the sampled box; none of 9 robots diverged at 2 of 2 settings: ")
    assert out.endswith("\nwrote moved/report.html\n")
    assert "`" not in out
    page = (moved / "report.html").read_text("utf-8")
    assert "dmframe study report moved" in page
    assert "Graph " in page

    status, out, err = dmframe("moved", "--rerun", "7", "--json")
    assert status == 0, err
    found = json.loads(out)
    assert (found["point"], found["sample"], found["alike"]) == (1, 3, True)
    row = polars.read_parquet(moved / "runs" / "*.parquet").filter(polars.col("run") == 7).row(0, named=True)
    error = tracking_error(load(tmp_path / found["graph"]).run().recording)
    assert error is not None
    assert row["rms_final"] == pytest.approx(error.rms_final, rel=1e-9)

    kept = next(iter(moved.glob("runs/*.parquet")))
    frame = polars.read_parquet(kept)
    (moved / "study.yaml").write_text(STUDY.replace("[1, 10]", "[1, 20]"), encoding="utf-8")
    status, out, err = dmframe("moved")
    assert (status, out) == (2, "")
    assert err.startswith("dmframe: moved: holds another study: grid.dynamics.Gamma was ")
    assert polars.read_parquet(kept).equals(frame)


def test_a_study_whose_row_is_another_in_anything_that_is_measured_is_reported(
    tmp_path: Path, finish: Callable[..., State], dmframe: Dmframe
) -> None:
    import polars

    measured = "measure: {signals: [servo.u, arm.q], limits: {servo.u: 1 V}}\n"
    (tmp_path / "small.yaml").write_text(SMALL + measured, encoding="utf-8")
    finish(load_study(tmp_path / "small.yaml"), tmp_path / "studies" / "small")
    status, out, err = dmframe("small.yaml", "--rerun", "1")
    assert (status, err) == (0, "")
    (file,) = (tmp_path / "studies" / "small" / "runs").iterdir()
    rows = polars.read_parquet(file)
    for figure, apart in (("arm.q.most", ""), ("rms_3", "1.0e-06 of a figure")):
        rows.with_columns(polars.col(figure) * (1 + 1e-6)).write_parquet(file)
        status, out, _ = dmframe("small.yaml", "--rerun", "1")
        assert status == 1
        assert f"differs from its row, by up to {apart}" in out


SMALL = """\
dmframe-study: 1
graph: pendulum
set: {duration: 0.2 s}
sample: {runs: 3, servo.K_P: {scale: [0.8, 1.25]}}
"""


def test_a_worker_elsewhere_has_the_study_and_all_its_files(mine: Path) -> None:
    study = load_study(mine)
    parcel, key = packed(study), study.key
    expected = study.rows(1, 4, 6)
    shutil.rmtree(mine.parent)
    script = (
        "import sys, pickle; from dmframe.study.packing import unpacked; study = unpacked(sys.stdin.buffer.read()); "
        "sys.stdout.buffer.write(pickle.dumps((study.key, study.rows(1, 4, 6))))"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], input=parcel, capture_output=True, env=environment(), cwd="/", check=True
    )
    there, rows = pickle.loads(done.stdout)
    assert there == key
    assert rows["rms_final"].tolist() == expected["rms_final"].tolist()
    assert len(parcel) < 200_000


def test_ctrl_c_ends_with_130_and_the_same_command_continues(tmp_path: Path) -> None:
    (tmp_path / "long.yaml").write_text(SMALL.replace("0.2 s", "20 s").replace("runs: 3", "runs: 100000"))
    process = started(tmp_path, "long.yaml", "--workers", "1")
    lines = tmp_path / "studies" / "long" / "chunks.jsonl"
    while process.poll() is None and not lines.exists():  # until some rows are stored
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(0.05)
    process.send_signal(signal.SIGTERM)
    out, err = process.communicate(timeout=PATIENCE)
    assert process.returncode == 130, err
    assert out == ""
    assert "runs are kept in studies/long; the same command continues" in err
    assert err.endswith("dmframe: stopped\n")


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("nosuch.yaml",), "expected a study file, found none"),
        ((".",), "expected a study's file, or the folder of its results, found neither"),
        (("small.yaml", "--workers", "0"), "workers: expected at least 1, found 0"),
        (("small.yaml", "--workers", "two"), "--workers two: expected a whole number"),
        (("small.yaml", "--workers", "1", "--scheduler", "x"), "not with a scheduler"),
        (("small.yaml", "--rerun", "3"), "run: expected one from 0 to 2, found 3"),
        (("small.yaml", "--rerun", "1", "--dry-run"), "--rerun: it has no effect with --dry-run"),
        (("small.yaml", "--scheduler", "x", "--dry-run"), "--scheduler: it has no effect with --dry-run"),
        (("small.yaml", "other.yaml"), "study: expected one file, found 2"),
    ],
)
def test_a_wrong_call_is_an_error_of_one_line(
    words: tuple[str, ...], text: str, tmp_path: Path, dmframe: Dmframe
) -> None:
    (tmp_path / "small.yaml").write_text(SMALL, encoding="utf-8")
    status, out, err = dmframe(*words)
    assert (status, out) == (2, "")
    assert text in err
    assert len(err.splitlines()) == 1


def test_from_python_a_study_runs_in_an_unguarded_script_and_gives_its_results(tmp_path: Path) -> None:
    (tmp_path / "small.yaml").write_text(SMALL, encoding="utf-8")
    (tmp_path / "script.py").write_text(
        "import dmframe as dm\n"
        "results = dm.load_study('small.yaml').run(workers=1)\n"
        "print(results.folder, results.frame.collect().height)\n",
        encoding="utf-8",
    )
    done = subprocess.run(
        [sys.executable, "script.py"], cwd=tmp_path, env=environment(), capture_output=True, text=True, check=True
    )
    assert done.stdout == "studies/small 3\n"


def test_what_is_packed_is_what_is_unpacked(tmp_path: Path) -> None:
    study = load_study({"dmframe-study": 1, "graph": "pendulum", "set": {"duration": "0.1 s"}})
    assert unpacked(packed(study)).key == study.key


@pytest.mark.parametrize(
    ("words", "reported"),
    [
        (["report", "nowhere"], "nowhere: expected the folder of a study; run it first"),
        (["report", "nowhere", "--out", "x"], "--out: it has no effect with report; leave one out"),
        (["report", "one", "two"], "expected one file, found 2"),
    ],
)
def test_an_empty_report_states_this(words: list[str], reported: str, tmp_path: Path, dmframe: Dmframe) -> None:
    status, out, err = dmframe(*words)
    assert (status, out) == (2, "")
    assert reported in err
