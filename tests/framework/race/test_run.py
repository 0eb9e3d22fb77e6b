"""Races that run: resuming, held-out cells, new laws, saved graphs, the page and the command."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from dmframe.cli import main
from dmframe.common.errors import DmframeError
from dmframe.graph.load import load
from dmframe.race import compute
from dmframe.race.compute import JOURNAL, Heat
from dmframe.race.plan import Race
from dmframe.race.run import CHOICES, PAGE, Finished, run_race
from dmframe.study.executor import Answer, InProcess

Make = Callable[..., Race]
CUT = '{"key": "cut o'


def finished(race: Race, out: Path, executor: Callable[[Heat], Any] = InProcess) -> Finished:
    return run_race(race, out, executor=executor)


def lines(folder: Path) -> list[dict[str, Any]]:
    text = (folder / JOURNAL).read_text(encoding="utf-8")
    return [json.loads(line) for line in text.splitlines() if line != CUT]


class _Stopped(InProcess):
    """Is interrupted after its first chunk."""

    answers = 0

    def ended(self, timeout: float) -> Answer | None:
        self.answers += 1
        if self.answers > 1:
            raise KeyboardInterrupt
        return super().ended(timeout)


def test_an_interrupted_race_keeps_its_runs_and_continues_to_the_same_result(
    race: Make, done: Finished, tmp_path: Path
) -> None:
    found, out = race(), tmp_path / "begun"
    with pytest.raises(KeyboardInterrupt):
        finished(found, out, _Stopped)
    begun = lines(out)
    assert 0 < len(begun) < 16
    with (out / JOURNAL).open("a", encoding="utf-8") as file:
        file.write(CUT)  # a process that was stopped while it wrote
    whole = finished(found, out)
    assert lines(out)[: len(begun)] == begun
    keys = [line["key"] for line in lines(out)]
    assert len(keys) == len(set(keys)) == 18  # 2 laws, 4 candidates, with and without margins, and 2 held-out runs
    assert whole.rows == done.rows
    assert finished(found, out, _refused).rows == done.rows


def _refused(heat: Heat) -> Any:
    raise AssertionError("nothing is left to compute")


def test_held_out_plants_and_paths_do_not_influence_the_tuning(race: Make, done: Finished, out: Path) -> None:
    count = len(lines(out))
    after = finished(
        race(("[90, 45], K_I: [360, 180]", "[600, 300], K_I: [900, 900]"), ("rate: [-3]", "rate: [1]")), out
    )
    assert len(lines(out)) == count + 2  # no run of the tuning reads them
    assert after.choices == done.choices
    assert (out / CHOICES).read_text() == (done.folder / CHOICES).read_text()
    assert after.rows[0].errors["tuned"] != done.rows[0].errors["tuned"]


def test_a_training_plant_decides_the_tuning(race: Make, done: Finished, tmp_path: Path) -> None:
    softer = race(("K_P: [60, 30], K_I: [240, 120]", "K_P: [6, 3], K_I: [240, 120]"), ("budget: 4", "budget: 2"))
    assert finished(softer, tmp_path / "softer").choices[0].tried != done.choices[0].tried[:2]


def test_a_law_that_joins_computes_its_own_runs_alone(race: Make, done: Finished, out: Path) -> None:
    count = len(lines(out))
    joined = "  third: {graph: law.yaml, tune: {task.gamma: [30, 50]}}\ntraining:"
    after = finished(race(("training:", joined)), out)
    assert len(lines(out)) == count + 2 * 4 + 1  # four candidates with and without margins, and a held-out run
    for old, new in zip(done.rows, after.rows, strict=True):
        assert {law: new.errors[law] for law in old.errors} == old.errors


def test_the_worst_cells_are_graphs_that_run_again_with_the_error_of_the_table(done: Finished) -> None:
    ((row, files),) = done.worst
    for law, file in files.items():
        graph = load(done.folder / file)
        for each in (graph, graph.set({"blocks.transport_delay": None, "blocks.command_gain": None})):  # without effect
            assert 1000 * each.run(progress=False).error.rms_final == pytest.approx(row.errors[law], rel=1e-9)
    page = (done.folder / PAGE).read_text(encoding="utf-8")
    again = f"dmframe race {done.race.document.name} --out {done.folder}"
    for text in ("20 ms, other, second, ideal", f"{row.ratio:.3g}", "dmframe run worst_1.yaml", "Halton", again):
        assert text in page
    assert "dmframe run worst_1.yaml</code></td>" in page  # each command in a cell of its own
    assert "By clock" not in page  # one clock: a table by clock would repeat the first one


def test_a_plant_without_an_arm_and_an_error_in_radians_are_reported_with_law_and_cell(
    race: Make, tmp_path: Path
) -> None:
    with pytest.raises(DmframeError) as caught:
        finished(
            race((", arm: {type: manipulator}}\n  second", "}\n  second"), ("budget: 4", "budget: 1")), tmp_path / "a"
        )
    assert "tuned in 20 ms, circle, first, ideal: " in str(caught.value)
    assert "expected an output of that name in another block, found none" in str(caught.value)
    circle = "{type: epicycles, center: [0.5, 0.3], radius: [0.1], rate: [2], phase: [0]}"
    other = "{type: epicycles, center: [0.5, 0.3], radius: [0.08], rate: [-3], phase: [1]}"
    swing = "{type: sinusoid, center: [1, 1], amplitude: 0.1, rate: 1}"
    gains = [("task.gamma: {per_clock: [0.02, 2]}", "task.alpha_bar: [1, 2]"), ("task.gamma: [1", "task.alpha_bar: [1")]
    file = tmp_path / "law.yaml"
    law = file.read_text(encoding="utf-8").replace("known_tracking, gamma: 4", "joint_tracking, alpha_bar: 4")
    file.write_text(law.replace("  geometry: {type: kinematics}\n", ""), encoding="utf-8")
    with pytest.raises(DmframeError) as caught:
        finished(race((circle, swing), (other, swing), ("budget: 4", "budget: 1"), *gains), tmp_path / "b")
    text = "the error of this race is that of the tool in mm, and the graph follows a path in rad; see the key error"
    assert str(caught.value) == f"tuned in 20 ms, circle, first, ideal and 3 more runs: {text}"


def test_different_faults_of_runs_are_different_errors(race: Make, tmp_path: Path) -> None:
    far = ("center: [0.5, 0.3], radius: [0.08]", "center: [5, 3], radius: [0.08]")
    with pytest.raises(DmframeError) as caught:
        finished(race(far, ("start: {near: [0.5, 0.5]}", "start: {}"), ("budget: 4", "budget: 1")), tmp_path / "a")
    (fault,) = caught.value.faults
    assert str(fault).startswith("tuned in 20 ms, other, second, ideal and 1 more runs: start: arm.x cannot reach")


FOREIGN = ("", "[1]", "null", '{"key": 1, "error": 1.0}', '{"key": "a"}', '{"key": "a", "error": true}', "[" * 9999)
WRONG = ("NaN", "Infinity", "-1.0", '"1.0"', "1" * 400, "{}")


def test_lines_of_the_journal_that_no_race_has_written_are_left_out(tmp_path: Path) -> None:
    wrong = [f'{{"key": "b", "error": {value}}}' for value in WRONG]
    text = "\n".join(
        [*FOREIGN, *wrong, '{"key": "good", "error": 0.5}', '{"key": "lost", "error": null}', "\udcff", CUT]
    )
    (tmp_path / JOURNAL).write_bytes(text.encode("utf-8", "surrogateescape"))
    assert compute.Kept(tmp_path).errors == {"good": 0.5, "lost": math.inf}


@pytest.mark.parametrize("make", [Path.mkdir, lambda path: path.symlink_to("/dev/full")])
def test_a_journal_that_is_not_a_file_is_refused(make: Callable[[Path], None], tmp_path: Path) -> None:
    make(tmp_path / JOURNAL)
    with pytest.raises(DmframeError, match="expected the journal of a race, found no regular file"):
        compute.Kept(tmp_path)


def test_a_folder_with_other_files_is_refused_and_keeps_them(race: Make, tmp_path: Path) -> None:
    (tmp_path / "worst_1.yaml").write_text("mine", encoding="utf-8")
    found = race()
    with pytest.raises(DmframeError, match="expected an empty or a new folder, or that of a race, found law"):
        finished(found, tmp_path)
    assert (tmp_path / "worst_1.yaml").read_text(encoding="utf-8") == "mine"


def test_an_error_above_the_limit_counts_as_diverged(race: Make, tmp_path: Path) -> None:
    limit = "budget: 1\nlimit: 0.001 mm"
    found = finished(race(("budget: 4", limit)), tmp_path / "out")
    assert all(choice.best is None for choice in found.choices)
    assert {line["error"] for line in lines(tmp_path / "out")} == {None}


def test_the_command_prints_the_table_as_json_and_how_to_continue(
    race: Make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    race()
    command = ["dmframe", "race", str(tmp_path / "small.yaml"), "--out", str(tmp_path / "out")]

    def ended(executor: Callable[[Heat], Any], *options: str) -> tuple[object, str, str]:
        monkeypatch.setattr(compute, "Pool", lambda heat, workers: executor(heat))
        monkeypatch.setattr(sys, "argv", [*command, *options])
        with pytest.raises(SystemExit) as stopped:
            main()
        return stopped.value.code, *capsys.readouterr()

    status, out, err = ended(_Stopped, "--json")
    assert (status, out) == (130, "")
    assert f"the finished runs are kept in {tmp_path / 'out'}, the same command continues" in err
    status, out, err = ended(InProcess, "--json")
    (row,) = json.loads(out)
    assert not status
    assert list(row) == ["cell", "law", "error", "best_rival", "rival_error", "ratio"]
    assert row["ratio"] == pytest.approx(row["error"] / row["rival_error"])
    assert err.count("tuning: 16 of 16 runs") == 1
    assert "median ratio" in ended(InProcess)[1]
    assert "no C compiler" not in err
    monkeypatch.setattr("dmframe.build.compiler.find_compiler", lambda: None)
    assert "notice: there is no C compiler" in ended(InProcess)[2]
    assert ended(InProcess, "--workers", "0")[0] == 2
