"""The file of the studio: its bytes are the user's, and a newer version is never overwritten silently."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dmframe.common.errors import OutputError
from dmframe.studio.file import LINE, MARK, MOST_BYTES, ChangedError, File, with_line_ends

TEXT = "dmframe: 1   # a comment\r\n\r\nblocks:\n  a:  {x: 1}  \rend"


@pytest.fixture
def file(tmp_path: Path) -> File:
    path = tmp_path / "mine.yaml"
    path.write_bytes((MARK + TEXT).encode())
    return File(path)


def as_edited(text: str) -> str:
    """A text as an editor holds it, with one kind of line end."""
    return "\n".join(LINE.split(text.removeprefix(MARK)))


def test_a_saved_text_without_an_edit_has_the_same_bytes(file: File) -> None:
    before, now = file.path.read_bytes(), file.read()
    assert file.save(as_edited(now.text), now.version) == now
    assert file.path.read_bytes() == before


def test_an_edit_changes_its_line_alone(file: File) -> None:
    now = file.read()
    saved = file.save(as_edited(now.text).replace("x: 1", "x: 2"), now.version)
    assert file.path.read_bytes() == (MARK + TEXT.replace("x: 1", "x: 2")).encode()
    assert saved == file.read()


def test_ends_that_would_become_one_are_kept_apart() -> None:
    assert with_line_ends("a\n\ra", "\n\n") == "\n\n"
    assert with_line_ends("aa\n\na\r\ra", "a\n\n\n") == "a\n\n\n"


def test_a_new_line_has_the_line_end_that_most_have() -> None:
    assert with_line_ends("a\r\nb\r\nc\n", "a\nnew\nb\nc\n") == "a\r\nnew\r\nb\r\nc\n"
    assert with_line_ends("", "a\nb") == "a\nb"


@given(st.text(st.sampled_from("ab \r\n"), max_size=40))
def test_every_text_comes_back_as_it_was(text: str) -> None:
    assert with_line_ends(text, as_edited(text)) == text


@given(st.text(st.sampled_from("ab\r\n"), max_size=40), st.text(st.sampled_from("ab\n"), max_size=40))
def test_the_lines_of_every_edit_are_those_that_the_user_wrote(old: str, new: str) -> None:
    assert as_edited(with_line_ends(old, new)) == new


def test_a_file_that_another_program_changed_is_not_overwritten(file: File) -> None:
    now = file.read()
    file.path.write_text("other: 1\n")
    with pytest.raises(ChangedError, match="changed by another program") as error:
        file.save("mine: 1\n", now.version)
    assert error.value.now.text == file.path.read_text() == "other: 1\n"
    file.save("mine: 1\n", error.value.now.version)  # the user has seen this version
    assert file.path.read_text() == "mine: 1\n"


def test_a_removed_file_is_written_again_only_if_the_user_knows_of_it(file: File) -> None:
    now = file.read()
    file.path.unlink()
    with pytest.raises(ChangedError, match="was removed"):
        file.save("mine: 1\n", now.version)
    assert not file.path.exists()
    file.save("mine: 1\n", "")
    assert file.path.read_text() == "mine: 1\n"


def test_a_file_that_may_not_be_written_keeps_its_bytes(file: File, monkeypatch: pytest.MonkeyPatch) -> None:
    before, now = file.path.read_bytes(), file.read()
    monkeypatch.setattr(os, "access", lambda *_: False)  # the tests may run as root, who may write everywhere
    assert not file.writable
    with pytest.raises(OutputError, match="cannot be written"):
        file.save("mine: 1\n", now.version)
    assert file.path.read_bytes() == before


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (b"a: \xff\n", "line 1 is no text in UTF-8"),
        (b"a: \0\n", "binary"),
        (b"#" * (MOST_BYTES + 1), "has more than 1000000 bytes"),
    ],
)
def test_what_is_no_text_is_not_edited(file: File, content: bytes, problem: str) -> None:
    file.path.write_bytes(content)
    now = file.read()
    assert problem in now.problem
    assert now.text == ""


def test_a_text_that_is_no_file_is_not_written(file: File) -> None:
    before, now = file.path.read_bytes(), file.read()
    with pytest.raises(OutputError, match="which UTF-8 cannot represent"):
        file.save("a: \ud800\n", now.version)
    with pytest.raises(OutputError, match="shorten it"):
        file.save("#" * (MOST_BYTES + 1), now.version)
    assert file.path.read_bytes() == before


def test_a_link_is_followed_and_the_mode_is_kept(file: File) -> None:
    file.path.chmod(0o640)
    link = file.path.with_name("link.yaml")
    link.symlink_to(file.path.name)
    linked = File(link)
    linked.save("mine: 1\n", linked.read().version)
    assert link.is_symlink()
    assert file.path.read_bytes() == (MARK + "mine: 1\r\n").encode()
    assert file.path.stat().st_mode & 0o777 == 0o640
