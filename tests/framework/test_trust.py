"""Which code a graph may run."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Any

import pytest

import dmframe as dm
from dmframe.catalogue import find_graph
from dmframe.common import trust
from dmframe.common.errors import BlockError

BLOCK = """
import pathlib
pathlib.Path(__file__).with_name("it_ran").touch()
from dmframe_blocks.kinematic_command import KinematicCommand as Mine
"""


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.setenv("HOME", str(tmp_path / "home"))


@pytest.fixture
def graph(tmp_path: Path) -> Path:
    """A graph with a block file in its folder."""
    folder = tmp_path / "graphs"
    folder.mkdir()
    (folder / "mine.py").write_text(BLOCK, encoding="utf-8")
    text = find_graph("ur10_fast_kinematic").read_text(encoding="utf-8")
    file = folder / "g.yaml"
    file.write_text(text.replace("type: kinematic_command", "type: mine.py:Mine"), encoding="utf-8")
    return file


def ran(graph: Path) -> bool:
    return graph.with_name("it_ran").exists()


def test_a_block_file_of_the_users_own_hand_is_run(graph: Path) -> None:
    assert dm.load(graph).blocks["inverse"] is not None
    assert ran(graph)


@pytest.mark.parametrize("open_to_all", ["mine.py", "."])
def test_a_file_that_all_may_write_is_not_run_until_its_folder_is_trusted(graph: Path, open_to_all: str) -> None:
    place = graph.with_name(open_to_all) if open_to_all != "." else graph.parent
    place.chmod(0o777)
    with pytest.raises(BlockError) as message:
        dm.load(graph)
    assert "mine.py would run as your own program, and all users may write to" in str(message.value)
    assert "add --trust" in str(message.value)
    assert f"{graph}:" in str(message.value)
    assert not ran(graph)
    dm.load(graph, trust=True)
    assert ran(graph)
    assert dm.load(graph).name == "g"  # stored


@pytest.mark.skipif(sys.platform != "linux", reason="marks differ")
def test_a_file_that_a_browser_has_marked_is_not_run(graph: Path) -> None:
    try:
        os.setxattr(graph.with_name("mine.py"), "user.xdg.origin.url", b"https://example.org/mine.py")
    except OSError:
        pytest.skip("this file system has no marks")
    with pytest.raises(BlockError, match="it was downloaded"):
        dm.load(graph)
    assert not ran(graph)


def test_a_file_of_another_user_is_not_run(graph: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "getuid", lambda: graph.stat().st_uid + 1)
    if graph.stat().st_uid == 0:
        graph.with_name("mine.py").chmod(0o666)  # root's files are trusted
    with pytest.raises(BlockError, match=r"belongs to another user|all users may write"):
        dm.load(graph)


def test_trust_in_a_folder_reaches_below_it_and_nowhere_else(graph: Path, tmp_path: Path) -> None:
    graph.with_name("mine.py").chmod(0o666)
    trust.remember(tmp_path / "other")
    with pytest.raises(BlockError):
        dm.load(graph)
    trust.remember(tmp_path)
    trust.remember(tmp_path)
    dm.load(graph)
    held = json.loads((tmp_path / "config" / "dmframe" / "trusted_folders.json").read_text())
    assert held == [str(tmp_path / "other"), str(tmp_path)]


@pytest.mark.parametrize("name", ["/tmp/mine.py:Mine", "../mine.py:Mine", "a/../../mine.py:Mine"])
def test_a_file_outside_of_the_graphs_folder_is_refused(graph: Path, name: str) -> None:
    text = graph.read_text(encoding="utf-8").replace("mine.py:Mine", name)
    graph.write_text(text, encoding="utf-8")
    with pytest.raises(BlockError, match="in the graph's folder or below it"):
        dm.load(graph)


def test_the_command_line_prompts_and_stores_the_reply(
    graph: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    from dmframe.cli import main

    graph.with_name("mine.py").chmod(0o666)
    statuses = []
    for words in (("check",), ("check", "--trust"), ("check",)):
        monkeypatch.setattr(sys, "argv", ["dmframe", words[0], str(graph), *words[1:]])
        with pytest.raises(SystemExit) as stopped:
            main()
        statuses.append(stopped.value.code)
    assert statuses == [2, 0, 0]
    assert "add --trust" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["check", "draw", "explain", "verify"])
def test_no_command_runs_a_file_that_is_not_trusted(
    graph: Path, command: str, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    from dmframe.cli import main

    file = graph.with_name("mine.py")
    file.write_text(
        f"import pathlib\npathlib.Path(__file__).with_name('it_ran').touch()\n{file.read_text(encoding='utf-8')}",
        encoding="utf-8",
    )
    file.chmod(0o666)
    monkeypatch.setattr(sys, "argv", ["dmframe", command, str(graph)])
    with pytest.raises(SystemExit) as stopped:
        main()
    assert stopped.value.code == 2
    reported = capsys.readouterr().err
    assert "mine.py would run as your own program, and all users may write to" in reported
    assert f"{graph}:" in reported  # the line that names the file
    assert not graph.with_name("it_ran").exists()


def test_a_link_that_leads_out_of_the_graphs_folder_is_not_followed(graph: Path, tmp_path: Path) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    graph.with_name("mine.py").rename(elsewhere / "mine.py")
    graph.with_name("lib").symlink_to(elsewhere)
    text = graph.read_text(encoding="utf-8").replace("mine.py:Mine", "lib/mine.py:Mine")
    graph.write_text(text, encoding="utf-8")
    with pytest.raises(BlockError, match="in the graph's folder or below it"):
        dm.load(graph)
    assert not (elsewhere / "it_ran").exists()


def test_a_folder_above_that_others_may_write_makes_a_file_theirs(graph: Path) -> None:
    below = graph.with_name("below")
    below.mkdir()
    graph.with_name("mine.py").rename(below / "mine.py")
    graph.write_text(graph.read_text(encoding="utf-8").replace("mine.py:Mine", "below/mine.py:Mine"), encoding="utf-8")
    graph.parent.chmod(0o777)
    with pytest.raises(BlockError, match="all users may write to"):
        dm.load(graph)


def test_a_pipe_is_no_block_file(graph: Path) -> None:
    graph.with_name("mine.py").unlink()
    os.mkfifo(graph.with_name("mine.py"))
    with pytest.raises(BlockError, match="expected a regular file"):
        dm.load(graph)


@pytest.mark.parametrize("content", [b"\xff", b"{}", b"[1]", b""])
def test_a_damaged_list_of_trusted_folders_trusts_nothing_and_is_mended(
    graph: Path, tmp_path: Path, content: bytes
) -> None:
    place = tmp_path / "config" / "dmframe" / "trusted_folders.json"
    place.parent.mkdir(parents=True)
    place.write_bytes(content)
    graph.with_name("mine.py").chmod(0o666)
    with pytest.raises(BlockError, match="add --trust"):
        dm.load(graph)
    dm.load(graph, trust=True)
    assert json.loads(place.read_text()) == [str(graph.parent)]


def test_a_folder_that_all_users_share_cannot_be_trusted(tmp_path: Path) -> None:
    tmp_path.chmod(0o1777)
    with pytest.raises(BlockError, match="all users share"):
        trust.remember(tmp_path)
