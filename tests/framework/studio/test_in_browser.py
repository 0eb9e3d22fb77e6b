"""The studio in a browser: an edit is followed by diagram, verdict and live page; the file is the user's."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from in_chromium import Chromium, chromium

from dmframe.catalogue import find_graph
from dmframe.studio.examine import drawn

TEXT = find_graph("pendulum").read_text("utf-8").replace("clock: continuous", "clock: 4 ms   # a comment")
HEADLINE = "document.getElementById('headline').textContent"
STATE = "document.getElementById('verdict').className"
PROVED = f"{STATE} === 'proved'"
PAGE = "document.querySelector('#mine iframe:not(.next)') && !document.querySelector('#mine iframe.next')"
NAMED = "[...document.querySelectorAll('#diagram .named')].map((each) => each.dataset.name).join()"
BANNER = "!document.getElementById('banner').hidden && document.getElementById('news').textContent"
SELECT = """(() => {{
  const {{ view }} = document.querySelector(".cm-content").cmTile, at = view.state.sliceDoc().indexOf({old!r});
  view.focus();
  view.dispatch({{ selection: {{ anchor: at, head: at + {length} }} }});
  return at;
}})()"""
WATCH = """(() => {
  globalThis.seen = [];
  const verdict = document.getElementById("verdict");
  const note = () => seen.push(`${verdict.className}: ${document.getElementById("headline").textContent}`);
  const all = { subtree: true, childList: true, attributes: true, characterData: true };
  new MutationObserver(note).observe(verdict, all);
  new MutationObserver(() => seen.push("diagram")).observe(document.getElementById("diagram"), { childList: true });
  addEventListener("message", ({ data }) => seen.push(`page: ${data.headline}`));
})()"""


@pytest.fixture(scope="module")
def tab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Chromium]:
    with chromium(tmp_path_factory.mktemp("profile"), "--force-prefers-reduced-motion") as found:
        yield found


@pytest.fixture
def mine(tmp_path: Path, tab: Chromium, started: Any) -> Iterator[Path]:
    """A graph file that is open in the browser."""
    path = tmp_path / "mine.yaml"
    path.write_text(TEXT)
    with started(path) as (_, address):
        tab.visit(address)
        until(tab, f"{PROVED} && {PAGE}")
        yield path
        tab.ask("Page.navigate", url="about:blank")


def until(tab: Chromium, expression: str) -> Any:
    """`Chromium.until`, with the patience that proofs on a busy machine require."""
    return tab.until(expression, 2000)


def replace(tab: Chromium, old: str, new: str) -> None:
    """Select a text with the keyboard's cursor and type over it."""
    assert tab.value(SELECT.format(old=old, length=len(old))) >= 0
    tab.ask("Input.insertText", text=new)


def click(tab: Chromium, label: str) -> None:
    tab.value(f"[...document.querySelectorAll('button')].find((each) => each.textContent === {label!r}).click()")


def test_an_edit_is_followed_by_diagram_verdict_and_page_and_the_file_waits_for_save(tab: Chromium, mine: Path) -> None:
    tab.value(WATCH)
    replace(tab, "K_c: 1,", "K_c: 1.5,")
    until(tab, f"{PROVED} && seen.includes('diagram') && {PAGE}")
    until(tab, "seen.at(-1) === 'page: Proved in continuous time'")
    seen = tab.value("seen")
    assert seen[0] == "waiting: Checking ..."  # no verdict of the old text is shown for the new one
    assert seen[-1] == "page: Proved in continuous time"
    assert tab.value(HEADLINE) == "Proved in continuous time"
    assert mine.read_text() == TEXT
    click(tab, "Save")
    until(tab, "document.getElementById('state').textContent === 'saved'")
    assert mine.read_text() == TEXT.replace("K_c: 1,", "K_c: 1.5,")
    assert tab.said == []


@pytest.mark.parametrize(
    ("K_c", "headline"),
    [("1.5", "Proved at these values in continuous time"), ("0.01", "The proof does not apply at these values")],
)
def test_the_shown_page_decides_its_conditions_at_the_edited_numbers(
    K_c: str, headline: str, tab: Chromium, mine: Path
) -> None:
    """At once, until the proof of the new text ends."""
    text = TEXT.replace("K_c: 1,", f"K_c: {K_c},")
    p = next(stage["p"] for stage in drawn(text, str(mine), TEXT) if stage["stage"] == "numbers")
    tab.value("addEventListener('message', ({ data }) => { globalThis.answer = data; })")
    tab.value(f"document.querySelector('#mine iframe').contentWindow.postMessage({{ p: {p}, edit: 7 }}, '*')")
    until(tab, f"globalThis.answer?.edit === 7 && answer.headline === {headline!r}")


def test_indices_are_subscripts_in_the_verdict_and_in_its_conditions(tab: Chromium, mine: Path) -> None:
    indices = "[...document.querySelectorAll('#{} sub')].map((each) => each.textContent)"
    assert "d" in tab.value(indices.format("detail"))  # of q - q_d
    assert {"d", "P", "I", "c", "⋆"} <= set(tab.value(indices.format("conditions")))
    assert "_c" not in tab.value("document.getElementById('conditions').textContent")


def test_a_wrong_sign_turns_the_verdict_red_and_names_the_block(tab: Chromium, mine: Path) -> None:
    replace(tab, "K_c: 1,", "K_c: -1,")
    until(tab, f"{STATE} === 'failed' && {NAMED} === 'inverse'")
    assert "blocks.inverse.K_c: expected a number > 0" in tab.value("document.getElementById('faults').textContent")
    line = TEXT[: TEXT.index("K_c: 1,")].count("\n") + 1
    assert f"line {line}" in tab.value("document.getElementById('faults').textContent")
    assert tab.value("document.querySelector('.cm-named').textContent").strip().startswith("inverse:")
    replace(tab, "K_c: -1,", "K_c: 0.01,")
    until(tab, f"{STATE} === 'failed' && {NAMED} === 'inverse' && {HEADLINE} === 'Not applicable'")
    assert "Block: inverse." in tab.value("document.getElementById('detail').textContent")
    replace(tab, "K_c: 0.01,", "K_c: 1,")
    until(tab, f"{PROVED} && {NAMED} === ''")


def test_a_file_that_changes_on_the_disk_is_loaded_or_the_user_decides(tab: Chromium, mine: Path) -> None:
    other = TEXT.replace("K_c: 1,", "K_c: 2,")
    mine.write_text(other)
    until(tab, "document.querySelector('.cm-content').textContent.includes('K_c: 2,')")
    replace(tab, "K_c: 2,", "K_c: 3,")
    mine.write_text(TEXT)
    assert "was changed by another program" in until(tab, BANNER)
    click(tab, "Save")
    until(tab, f"({BANNER}).includes('nothing was written')")
    assert mine.read_text() == TEXT
    click(tab, "Overwrite the file with this text")
    until(tab, "document.getElementById('state').textContent === 'saved'")
    assert mine.read_text() == TEXT.replace("K_c: 1,", "K_c: 3,")
    mine.unlink()
    until(tab, f"({BANNER} || '').includes('was removed')")
    click(tab, "Write it again")
    until(tab, "document.getElementById('state').textContent === 'saved'")
    assert mine.read_text() == TEXT.replace("K_c: 1,", "K_c: 3,")


def test_another_graph_is_compared_side_by_side(tab: Chromium, mine: Path) -> None:
    tab.value("document.getElementById('other').value = 'pendulum_kinematic'")
    tab.value("document.getElementById('other').onchange(), 0")
    until(tab, "document.querySelector('#theirs iframe:not(.next)')")
    assert "has no certificate" in tab.value("document.querySelector('.side-verdict').textContent")
    assert "kinematic_command" in tab.value("document.querySelector('.lines .gone').parentNode.textContent")


def test_keys_and_types_are_completed_and_described(tab: Chromium, mine: Path) -> None:
    replace(tab, "K_c: 1,", "Lamb")
    until(tab, "[...document.querySelectorAll('.cm-completionLabel')].some((each) => each.textContent === 'Lambda_P')")
    replace(tab, "type: pid_servo", "type: pid_s")
    until(tab, "[...document.querySelectorAll('.cm-completionLabel')].some((each) => each.textContent === 'pid_servo')")
