"""The folder of a study: incomplete, foreign or changed files are detected."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from fake_study import FakeStudy
from study_processes import environment, frame, written

from dmframe.common.errors import OutputError, ValueFault
from dmframe.study import executor, journal
from dmframe.study.chunks import Chunk
from dmframe.study.execute import run_study
from dmframe.study.executor import Computed, compute
from dmframe.study.store import opened


@pytest.fixture
def out(tmp_path: Path) -> Path:
    """A folder of a whole study, written in this process."""
    folder = tmp_path / "out"
    fill(folder, FakeStudy())
    return folder


def fill(folder: Path, study: FakeStudy) -> None:
    from dmframe.study.chunks import Extent

    with opened(folder, study, {"study.yaml": study.text.encode()}) as kept:
        kept.cut([Extent(0, 3, 0, study.samples, 1, 8)], (1, 8))
        for chunk in kept.extents[0]:
            made = compute(study, chunk)
            assert isinstance(made, Computed)
            kept.write(chunk, made)


def first(folder: Path) -> Path:
    return min((folder / "runs").iterdir())


def truncated(file: Path) -> None:
    os.truncate(file, file.stat().st_size // 2)


def emptied(file: Path) -> None:
    file.write_bytes(b"")


def another(file: Path) -> None:
    shutil.copyfile(max(file.parent.iterdir()), file)


def one_bit(file: Path) -> None:
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    file.write_bytes(content)


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize("harm", [truncated, emptied, another, one_bit])
def test_a_damaged_file_is_noticed_and_computed_again(out: Path, harm: Callable[[Path], None]) -> None:
    before = frame(out)
    harm(first(out))
    state = run_study(FakeStudy(), out, workers=1)
    assert state.computed == 8
    (notice,) = state.notices
    assert "not written by this study" in notice
    assert frame(out).rows() == before.rows()


def test_an_unknown_file_is_renamed_and_a_partial_one_is_deleted(out: Path) -> None:
    shutil.copyfile(first(out), out / "runs" / "mine.parquet")
    (out / "runs" / "x.parquet.tmp").write_bytes(b"half")
    with opened(out, FakeStudy(), {}) as kept:
        assert kept.runs_done == 120
        assert len(kept.notices) == 1
    assert not list((out / "runs").glob("*.tmp"))
    assert (out / "runs" / "mine.refused").exists()
    assert len(frame(out)) == 120


def test_a_folder_whose_first_process_was_ended_as_it_began_can_be_used(tmp_path: Path) -> None:
    for name in ("study.yaml", "study.lock.json.tmp", "study.yaml.tmp"):
        (tmp_path / name).write_text("half")
    fill(tmp_path, FakeStudy())
    assert len(frame(tmp_path)) == 120


@pytest.mark.usefixtures("here")
def test_a_line_that_was_cut_off_loses_its_chunk_alone(out: Path) -> None:
    lines = (out / "chunks.jsonl").read_text()
    (out / "chunks.jsonl").write_text(lines[:-30])
    assert run_study(FakeStudy(), out, workers=1).computed == 8
    assert len(written(out)) == 15


def test_a_changed_study_is_refused_with_what_has_changed(out: Path) -> None:
    with (
        pytest.raises(ValueFault, match='study: meaning was "one", now "two"; name another folder, or use --force'),
        opened(out, FakeStudy(meaning="two"), {}),
    ):
        pass
    assert len(frame(out)) == 120


def test_with_force_a_changed_study_begins_again(out: Path) -> None:
    changed = FakeStudy(meaning="two")
    with opened(out, changed, {"study.yaml": changed.text.encode()}, force=True) as kept:
        assert kept.runs_done == 0
    assert (out / "study.yaml").read_text() == changed.text
    assert not list((out / "runs").iterdir())


def test_another_version_is_named(out: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(journal, "versions", lambda: {**executor.versions(), "numpy": "1.0"})
    changed = FakeStudy()
    with pytest.raises(ValueFault, match=r'versions.numpy was "[\d.]+", now "1.0"'), opened(out, changed, {}):
        pass


def test_a_study_of_fewer_runs_is_refused(out: Path) -> None:
    with (
        pytest.raises(ValueFault, match="40 runs a point, found 39; it can grow, not shrink"),
        opened(out, FakeStudy(samples=39), {}),
    ):
        pass


def test_the_second_of_two_clients_is_refused(out: Path) -> None:
    with (
        opened(out, FakeStudy(), {}),
        pytest.raises(OutputError, match="another study or race runs there; wait until it has ended"),
        opened(out, FakeStudy(), {}),
    ):
        pass
    with opened(out, FakeStudy(), {}):  # the first has ended
        pass


@pytest.mark.parametrize(("name", "content"), [("thesis.tex", ""), ("study.lock.json", "{"), ("study.lock.json", "[]")])
def test_a_folder_of_something_else_is_refused(tmp_path: Path, name: str, content: str) -> None:
    (tmp_path / name).write_text(content)
    with (
        pytest.raises(OutputError, match=f"{name}|expected the record of a study"),
        opened(tmp_path, FakeStudy(), {}),
    ):
        pass
    assert [item.name for item in tmp_path.iterdir() if not item.name.startswith(".")] == [name]


@pytest.mark.parametrize(
    "wrong",
    [
        {"run": [1, 0]},
        {"sample": [0, 2]},
        {"rms_final": [0.0]},
        {"extra": [1.0, 2.0]},
    ],
)
def test_rows_that_are_not_those_of_their_chunk_are_refused(out: Path, wrong: dict[str, list[float]]) -> None:
    study, chunk = FakeStudy(samples=42), Chunk(0, 1, 40, 42)
    with opened(out, study, {}) as kept, pytest.raises(ValueFault, match="point 0, samples 40 to 41: expected"):
        kept.write(chunk, Computed({**study.rows(0, 40, 42), **wrong}, 0.0, {}))
    assert len(frame(out)) == 120


FULL = """
import resource, signal, sys
from fake_study import FakeStudy
from dmframe.common.errors import OutputError
from dmframe.study.execute import run_study
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (12000, resource.RLIM_INFINITY))
try:
    run_study(FakeStudy(samples=3000), sys.argv[1], workers=1, chunk=8)
except OutputError as error:
    print(error)
"""


def test_a_full_disk_is_one_message_and_written_rows_remain(tmp_path: Path) -> None:
    out = tmp_path / "out"
    done = subprocess.run(
        [sys.executable, "-c", FULL, str(out)], capture_output=True, text=True, env=environment(), check=True
    )
    assert done.stdout.strip().endswith("free some space, or choose a folder on another disk")
    assert len(done.stdout.splitlines()) == 1
    before = len(written(out))
    assert before > 5
    with opened(out, FakeStudy(samples=3000), {}) as kept:
        assert before - 1 <= len(kept.done) <= before
        assert kept.notices == []


@pytest.mark.parametrize(
    ("part", "value"),
    [
        ("extents", [[1]]),
        ("extents", [[0, 1, 0, 1, 0, 0]]),
        ("each", 5),
        ("samples", "x"),
        ("identity", 5),
        ("types", []),
    ],
)
def test_a_lock_with_an_invalid_part_is_refused(out: Path, part: str, value: object) -> None:
    held = json.loads((out / journal.LOCK).read_text())
    (out / journal.LOCK).write_text(json.dumps(held | {part: value}))
    with pytest.raises(OutputError, match="expected the record of a study"), opened(out, FakeStudy(), {}):
        pass
