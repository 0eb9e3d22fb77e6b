"""A file is written in full or not at all, at the target of its link, and faults contain its name."""

from __future__ import annotations

import errno
import os
import stat
import threading
from pathlib import Path

import pytest

from dmframe.common.errors import OutputError
from dmframe.common.files import check_place, printable, write_text


def held(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.fixture
def full(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("os.replace", refuse)


def test_a_new_file_has_the_mode_that_the_user_wants_of_files(tmp_path: Path) -> None:
    before = os.umask(0o027)
    try:
        write_text(tmp_path / "a", "text")
    finally:
        os.umask(before)
    assert stat.S_IMODE(tmp_path.joinpath("a").stat().st_mode) == 0o640


def test_a_file_that_was_there_keeps_its_mode(tmp_path: Path) -> None:
    tmp_path.joinpath("a").write_text("old", encoding="utf-8")
    tmp_path.joinpath("a").chmod(0o600)
    write_text(tmp_path / "a", "new")
    assert stat.S_IMODE(tmp_path.joinpath("a").stat().st_mode) == 0o600
    assert tmp_path.joinpath("a").read_text(encoding="utf-8") == "new"


@pytest.mark.parametrize("there", [True, False])
def test_a_link_is_followed(there: bool, tmp_path: Path) -> None:
    tmp_path.joinpath("far").mkdir()
    if there:
        tmp_path.joinpath("far", "a").write_text("old", encoding="utf-8")
    tmp_path.joinpath("link").symlink_to(Path("far", "a"))
    write_text(tmp_path / "link", "new")
    assert tmp_path.joinpath("link").is_symlink()
    assert tmp_path.joinpath("far", "a").read_text(encoding="utf-8") == "new"
    assert held(tmp_path / "far") == ["a"]


def test_a_pipe_is_written_to_and_not_replaced(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    read = list[str]()
    reader = threading.Thread(target=lambda: read.append(tmp_path.joinpath("pipe").read_text(encoding="utf-8")))
    reader.start()
    write_text(tmp_path / "pipe", "text")
    reader.join()
    assert read == ["text"]
    assert stat.S_ISFIFO(tmp_path.joinpath("pipe").stat().st_mode)


def test_a_device_is_written_to_and_a_full_one_is_reported(tmp_path: Path) -> None:
    device = tmp_path / "full"
    try:
        os.mknod(device, stat.S_IFCHR | 0o666, os.makedev(1, 7))
        device.open("wb").close()
    except (OSError, AttributeError):
        pytest.skip("no device can be made here")
    with pytest.raises(OutputError, match="full: cannot be written: no space left on device; free some space"):
        write_text(device, "text")
    assert stat.S_ISCHR(device.stat().st_mode)


def test_what_cannot_be_written_leaves_the_old_file_and_no_other_file(tmp_path: Path, full: None) -> None:
    tmp_path.joinpath("a").write_text("old", encoding="utf-8")
    with pytest.raises(OutputError, match="a: cannot be written: no space left on device; free some space, or choose"):
        write_text(tmp_path / "a", "new")
    with pytest.raises(OutputError):
        write_text(tmp_path / "b", "new", new=True)
    assert held(tmp_path) == ["a"]
    assert tmp_path.joinpath("a").read_text(encoding="utf-8") == "old"


def test_ctrl_c_leaves_the_old_file_and_no_other_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("os.replace", stop)
    for new in (True, False):
        with pytest.raises(KeyboardInterrupt):
            write_text(tmp_path / "a", "new", new=new)
    assert held(tmp_path) == []


def test_a_new_file_takes_nobodys_place(tmp_path: Path) -> None:
    tmp_path.joinpath("link").symlink_to("nowhere")
    tmp_path.joinpath("a").write_text("old", encoding="utf-8")
    for name in ("a", "link"):
        with pytest.raises(OutputError, match=f"{name}: exists already; choose a new file"):
            write_text(tmp_path / name, "new", new=True)
    assert tmp_path.joinpath("a").read_text(encoding="utf-8") == "old"


def test_a_name_as_long_as_the_system_takes_can_be_written(tmp_path: Path) -> None:
    write_text(tmp_path / ("a" * 255), "text")
    assert held(tmp_path) == ["a" * 255]
    with pytest.raises(OutputError, match="cannot be written: file name too long; choose a shorter name"):
        check_place(tmp_path / ("a" * 256))


def test_where_no_file_can_be_is_reported(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="expected a file, found a folder; choose a file in it"):
        check_place(tmp_path)
    with pytest.raises(OutputError, match=r"a: the folder .*no does not exist; create it first, or choose another"):
        check_place(tmp_path / "no" / "a")
    tmp_path.joinpath("link").symlink_to(Path("no", "a"))
    with pytest.raises(OutputError, match=r"link: the folder .*no does not exist"):
        check_place(tmp_path / "link")


def test_bytes_that_are_no_letters_can_be_written_and_printed(tmp_path: Path) -> None:
    write_text(tmp_path / "a", "bad\udcff")
    assert tmp_path.joinpath("a").read_bytes() == b"bad\\udcff"
    assert printable("bad\udcff") == "bad\\udcff"
