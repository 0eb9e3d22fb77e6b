"""An export gets its name when all files are on the disk; a killed one leaves none of them."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import dmframe as dm
from dmframe.common.errors import OutputError
from dmframe.export.folder import write_all

KINDS: dict[Any, str] = {"c": "arm2_joint.c", "ros2": "package.xml", "fmi3": "arm2_joint.fmu"}


@pytest.mark.parametrize("kind", KINDS)
def test_everything_is_synced_to_the_disk_before_it_has_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: Any
) -> None:
    synced, renames = list[str](), list[tuple[str, int]]()
    fsync, rename = os.fsync, os.rename

    def noted(descriptor: int) -> None:
        synced.append(str(Path(f"/proc/self/fd/{descriptor}").readlink()))
        fsync(descriptor)

    def named(source: Any, target: Any) -> None:
        renames.append((str(source), len(synced)))
        rename(source, target)

    monkeypatch.setattr(os, "fsync", noted)
    monkeypatch.setattr(os, "rename", named)
    files = dm.load("arm2_joint").export(tmp_path / "out", kind)
    ((building, count),) = [item for item in renames if item[0].startswith(str(tmp_path))]
    written = {str(file.relative_to(tmp_path / "out")) for file in files}
    assert KINDS[kind] in written
    assert {f"{building}/{name}" for name in written} <= set(synced[:count])
    assert {str(folder.relative_to(tmp_path / "out")) for folder in (tmp_path / "out").rglob("*")} >= written
    assert str(tmp_path) in synced[count:]


KILLED = """
import os, signal, sys
from dmframe.results import place
def killed(folder):
    assert any(folder.iterdir())
    os.kill(os.getpid(), signal.SIGKILL)
place.sync_below = killed
from dmframe.export.folder import write_all
from pathlib import Path
write_all(Path("out"), {"a.c": "1", "b/c.h": "2"})
"""


def test_an_export_that_was_killed_has_no_files(tmp_path: Path) -> None:
    done = subprocess.run([sys.executable, "-c", KILLED], cwd=tmp_path, capture_output=True, check=False)
    assert done.returncode == -signal.SIGKILL
    assert list((tmp_path / "out").iterdir()) == []


@pytest.mark.parametrize("there", [False, True])
def test_a_disk_that_is_full_leaves_none_of_the_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, there: bool
) -> None:
    from dmframe.results import place

    def full(folder: Path) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    if there:
        (tmp_path / "out").mkdir()
        (tmp_path / "out" / "mine.txt").write_text("of the user")
    monkeypatch.setattr(place, "sync_below", full)
    with pytest.raises(OutputError, match="no space left on device; free some space"):
        write_all(tmp_path / "out", {"a.fmu": "1", "b.fmu": "2"})
    assert [item.name for item in tmp_path.rglob("*")] == (["out", "mine.txt"] if there else [])
    monkeypatch.undo()
    write_all(tmp_path / "out", {"a.fmu": "1", "b.fmu": "2"})
    assert sorted(item.name for item in (tmp_path / "out").iterdir()) == ["a.fmu", "b.fmu", *["mine.txt"] * there]
