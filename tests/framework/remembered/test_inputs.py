"""The recorded inputs of a proof, how a change is detected, and why some verdicts are not stored."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import platformdirs
import pytest

from dmframe.build.cache import cache_folder
from dmframe.common.copies import shared
from dmframe.common.files import probed
from dmframe.remembered import recorder, store
from dmframe.remembered.front import Call, call_of, found, page_of
from dmframe.remembered.inputs import states_of, unchanged

CALL = Call("verify", ("pendulum",), as_json=False, fresh=False)
OLD = 1_700_000_000


@pytest.fixture
def begun(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[recorder.Recorder]:
    monkeypatch.setenv("DMFRAME_CACHE", str(tmp_path / "cache"))
    begun = recorder.begin(CALL)
    assert begun is not None
    begun._began = sys.maxsize  # files of this test are new
    yield begun
    recorder.end()


@pytest.mark.parametrize(
    ("kind", "change"),
    [
        ("content", lambda place: (place / "file").write_text("other")),
        ("content", lambda place: (place / "file").unlink()),
        ("library", lambda place: os.utime(place / "file", (OLD, OLD))),
        ("library", lambda place: (place / "file").write_text("longer than before")),
        ("names", lambda place: (place / "more").touch()),
        ("modules", lambda place: (place / "more.py").touch()),
        ("packages", lambda place: (place / "more.dist-info").mkdir()),
        ("probe", lambda place: (place / "file").unlink()),
    ],
)
def test_an_input_of_each_kind_shows_its_change(tmp_path: Path, kind: str, change: Callable[[Path], object]) -> None:
    (tmp_path / "file").write_text("text")
    name = str(tmp_path if kind in ("names", "modules", "packages") else tmp_path / "file")
    before = states_of([(kind, name)])
    assert unchanged(before)
    change(tmp_path)
    assert not unchanged(before)


def test_a_variable_shows_its_change_and_all_of_them_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("A_GAIN", raising=False)
    one, every = states_of([("variable", "A_GAIN")]), states_of([("variable", "")])
    assert unchanged(one)
    monkeypatch.setenv("A_GAIN", "2")
    assert not unchanged(one)
    assert not unchanged(every)


def test_bytecode_and_results_do_not_change_what_an_import_finds(tmp_path: Path) -> None:
    before = states_of([("modules", str(tmp_path)), ("packages", str(tmp_path))])
    (tmp_path / "__pycache__").mkdir()
    (tmp_path / "results").mkdir()
    (tmp_path / "signals.nc").touch()
    assert unchanged(before)


def test_files_folders_variables_and_looks_are_recorded(
    begun: recorder.Recorder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("data").write_text("1")
    Path("made").write_text("1")
    assert Path("data").read_text() == Path("made").read_text()
    os.environ.get("A_GAIN")
    os.getenvb(b"OTHER_GAIN") if hasattr(os, "getenvb") else os.getenv("OTHER_GAIN")
    list(tmp_path.iterdir())
    probed(tmp_path / "absent.yaml")
    entry = begun.entry()
    assert entry is not None
    inputs = entry["inputs"]
    assert str(tmp_path / "data") not in inputs["content"]  # it was written here, so it is not an input
    assert inputs["variable"]["A_GAIN"] == inputs["variable"]["OTHER_GAIN"] == "absent"
    assert str(tmp_path) in inputs["names"]
    assert inputs["probe"][str(tmp_path / "absent.yaml")] == "no file"
    assert str(Path(recorder.__file__)) in inputs["content"]
    assert any(name.endswith("casadi.py") or "/casadi/" in name for name in inputs["library"])


def test_a_file_that_is_read_is_recorded_and_one_that_is_looked_for_in_vain(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DMFRAME_CACHE", str(tmp_path / "cache"))
    (tmp_path / "data").write_text("1")
    begun = recorder.begin(CALL)
    assert begun is not None
    begun._began = sys.maxsize
    try:
        assert (tmp_path / "data").read_text() == "1"
        with pytest.raises(FileNotFoundError):
            (tmp_path / "none").read_text()
        entry = begun.entry()
    finally:
        recorder.end()
    assert entry is not None
    assert unchanged(entry["inputs"])
    assert entry["inputs"]["content"][str(tmp_path / "none")] == "absent"
    (tmp_path / "data").write_text("2")
    assert not unchanged(entry["inputs"])


def run_a_program(place: Path) -> None:
    subprocess.run([sys.executable, "-c", ""], check=True)


def read_a_pipe(place: Path) -> None:
    os.mkfifo(place / "pipe")
    os.close(os.open(place / "pipe", os.O_RDONLY | os.O_NONBLOCK))


@pytest.mark.parametrize(("act", "why"), [(run_a_program, "called subprocess.Popen"), (read_a_pipe, "no regular file")])
def test_what_cannot_be_recorded_is_not_kept(
    begun: recorder.Recorder, tmp_path: Path, act: Callable[[Path], None], why: str
) -> None:
    act(tmp_path)
    assert begun.entry() is None
    assert why in begun.refused


@pytest.mark.skipif(sys.platform != "linux", reason="no copies elsewhere")
def test_what_a_forked_process_reads_is_recorded(
    begun: recorder.Recorder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def read() -> tuple[int, str]:
        return os.getpid(), (tmp_path / "data").read_text()

    monkeypatch.setattr("dmframe.common.copies.threading.active_count", lambda: 1)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1}, raising=False)
    (tmp_path / "data").write_text("1")
    begun._written.clear()
    with shared([read], busy=True) as finished:
        os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOWAIT)  # the forked process has ended
        ((process, text),) = finished()
    assert (process == os.getpid(), text) == (False, "1")
    entry = begun.entry()
    assert entry is not None
    assert unchanged(entry["inputs"])
    (tmp_path / "data").write_text("2")
    assert not unchanged(entry["inputs"])


@pytest.mark.skipif(sys.platform != "linux", reason="no copies elsewhere")
def test_a_forked_process_that_starts_a_program_leaves_nothing_to_keep(
    begun: recorder.Recorder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("dmframe.common.copies.threading.active_count", lambda: 1)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1}, raising=False)
    with shared([lambda: run_a_program(tmp_path)], busy=True) as finished:
        os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOWAIT)
        finished()
    assert begun.entry() is None
    assert "called subprocess.Popen" in begun.refused


def test_a_file_that_changed_after_the_proof_began_is_not_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DMFRAME_CACHE", str(tmp_path / "cache"))
    (tmp_path / "data").write_text("1")
    begun = recorder.begin(CALL)
    assert begun is not None
    try:
        (tmp_path / "data").read_text()
        begun._began -= 10**12
        assert begun.entry() is None
        assert "has changed since" in begun.refused
    finally:
        recorder.end()


def kept(place: Path, **more: object) -> dict[str, object]:
    entry = {
        "inputs": {},
        "aside": [],
        "text": "page",
        "summaries": [{"a": 1}],
        "status": 0,
        "proved_at": "now",
        **more,
    }
    assert store.keep(str(place), CALL.key, entry)
    return entry


def test_a_kept_verdict_is_found_and_marked_as_remembered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DMFRAME_CACHE", str(tmp_path))
    kept(tmp_path / store.FOLDER)
    entry = found(CALL)
    assert entry is not None
    assert page_of(entry, as_json=False).startswith("page\n\nremembered: proved at now")
    assert '"remembered": true' in page_of(entry, as_json=True)
    assert found(Call("verify", CALL.words, as_json=False, fresh=True)) is None
    assert found(Call("verify", ("other",), as_json=False, fresh=False)) is None


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-9])


def flipped(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


def linked(path: Path) -> None:
    path.symlink_to(path.rename(path.with_suffix(".other")))


@pytest.mark.parametrize(
    "harm",
    [cut, flipped, linked, lambda p: p.write_bytes(b""), lambda p: p.chmod(0o666), lambda p: p.parent.chmod(0o777)],
)
def test_a_damaged_entry_or_one_that_others_may_have_written_is_ignored(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, harm: Callable[[Path], object]
) -> None:
    monkeypatch.setenv("DMFRAME_CACHE", str(tmp_path))
    kept(tmp_path / store.FOLDER)
    (path,) = (tmp_path / store.FOLDER).iterdir()
    harm(path)
    assert found(CALL) is None


def test_an_entry_under_another_key_is_ignored(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DMFRAME_CACHE", str(tmp_path))
    kept(tmp_path / store.FOLDER)
    (path,) = (tmp_path / store.FOLDER).iterdir()
    other = Call("verify", ("other",), as_json=False, fresh=False)
    path.rename(path.with_name(f"{other.key}{store.SUFFIX}"))
    assert found(other) is None


def test_several_may_write_the_same_entry_at_once(tmp_path: Path) -> None:
    workers = [threading.Thread(target=kept, args=(tmp_path,), kwargs={"more": "x" * k}) for k in range(20)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    assert store.find(str(tmp_path), CALL.key) is not None
    assert [path.suffix for path in tmp_path.iterdir()] == [store.SUFFIX]


def test_only_so_many_verdicts_are_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(store, "MOST", 3)
    for k in range(6):
        assert store.keep(str(tmp_path), f"key{k}", {})
        os.utime(tmp_path / f"key{k}{store.SUFFIX}", (OLD + k, OLD + k))
    assert store.keep(str(tmp_path), "last", {})
    assert {path.stem for path in tmp_path.iterdir()} == {"last", "key5", "key4"}


def test_the_folder_is_that_of_compiled_code(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for value in (str(tmp_path), "~/somewhere", ""):
        monkeypatch.setenv("DMFRAME_CACHE", value)
        assert store.folder() == str(cache_folder() / store.FOLDER)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    assert store.folder() == str(Path(platformdirs.user_cache_dir("dmframe", appauthor=False)) / store.FOLDER)


@pytest.mark.parametrize(
    ("words", "call"),
    [
        ("verify pendulum", (("pendulum",), False, False)),
        ("verify a b --json --set x=1 --seed 3 --fresh", (("a", "b", "--set", "x=1", "--seed", "3"), True, True)),
        ("verify a --set=x=1", (("a", "--set=x=1"), False, False)),
        ("verify a --report r.md", None),
        ("verify a --trust", None),
        ("verify --help", None),
        ("verify a --set", None),
        ("verify", None),
        ("", None),
    ],
)
def test_a_call_is_read_as_its_library_reads_it(words: str, call: tuple[tuple[str, ...], bool, bool] | None) -> None:
    read = call_of(words.split())
    assert (None if read is None else (read.words, read.as_json, read.fresh)) == call


@pytest.mark.parametrize(
    ("words", "kept"),
    [
        ("run ur10_fast", ("ur10_fast",)),
        (
            "run ur10_fast --fresh --out there --no-plots --json --force --page --engine compiled --figures=png",
            ("ur10_fast",),
        ),
        (
            "run a b --until 2 --set clock=8ms --reality ur",
            ("a", "b", "--until", "2", "--set", "clock=8ms", "--reality", "ur"),
        ),
        ("run a --baseline --until=3", ("a", "--baseline", "--until=3")),
        ("run a --trust", None),
        ("run a --out", None),
        ("run a --help", None),
        ("run", None),
        ("draw a", None),
    ],
)
def test_words_of_a_run_that_its_conclusions_depend_on(words: str, kept: tuple[str, ...] | None) -> None:
    call = call_of(words.split())
    assert (None if call is None else call.words) == kept
    assert call is None or call.key != Call("verify", call.words).key
