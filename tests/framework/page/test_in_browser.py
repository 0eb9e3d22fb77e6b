"""A live page in a browser, opened from a disk: what it says of the proof while a slider is dragged."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from in_browser import Browser, browser
from in_node import content

from dmframe import notebook
from dmframe.page.page import assembled

HEADLINE = "document.getElementById('headline').textContent"
SAYS = "document.getElementById('says').textContent"
K_C = "move-inverse.K_c"


def judges_truly(tab: Browser, page: Path) -> None:
    """Open the page, break a condition by hand, and come back."""
    tab.opened(page)
    assert tab.until(f"{HEADLINE} !== 'Loading' && {HEADLINE}") == "Proved"
    assert "All 16 conditions hold" in tab.value(SAYS)
    tab.dragged(K_C, 0.5, 0.02)
    tab.until("document.getElementById('command').textContent.includes('inverse.K_c=[0.0')")
    assert "does not apply" in tab.value(HEADLINE)
    assert "M̄ ≥ 0" in tab.value(SAYS)
    tab.value("document.getElementById('reset').click()")
    assert tab.until(f"{HEADLINE} === 'Proved'")
    assert tab.said == []


@pytest.fixture(scope="module")
def tab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with browser(tmp_path_factory.mktemp("profile")) as found:
        yield found


def saved(folder: Path, html: str) -> Path:
    page = folder / "page.html"
    page.write_text(html, "utf-8")
    return page


def test_a_page_from_a_disk_says_truly_what_is_proved_where_its_sliders_stand(tab: Browser, tmp_path: Path) -> None:
    judges_truly(tab, saved(tmp_path, assembled(content("ur10_fast"))))


def test_a_page_whose_margins_were_wrong_would_be_noticed(tab: Browser, tmp_path: Path) -> None:
    right = assembled(content("ur10_fast"))
    wrong = right.replace("strict ? margin > 0 : margin >= 0", "true")
    assert wrong != right
    with pytest.raises(AssertionError, match="does not apply"):
        judges_truly(tab, saved(tmp_path, wrong))


def test_an_address_keeps_what_was_moved(tab: Browser, tmp_path: Path) -> None:
    page = saved(tmp_path, assembled(content("arm2_joint")))
    tab.opened(page, "#task.alpha_bar=1.5&clock=0.5")
    tab.until("document.getElementById('command').textContent.includes('task.alpha_bar=3')")
    assert "clock=0.001" in tab.value("document.getElementById('command').textContent")
    assert tab.value(HEADLINE) == "Proved at these values"
    tab.dragged("move-task.alpha_bar", 0.7, 0.8)
    tab.until("!location.hash.includes('alpha_bar=1.5&')")
    assert "clock=0.5" in tab.value("location.hash")
    assert tab.said == []


def test_a_page_runs_inside_a_notebook_which_it_cannot_reach(tab: Browser, tmp_path: Path) -> None:
    told = "<script>addEventListener('message', (event) => (document.title = event.data))</script>"
    says = f"setInterval(() => parent.postMessage({HEADLINE}, '*'), 50)"
    inside = assembled(content("arm2_joint")).replace("</body>", f"<script>{says}</script></body>")
    tab.opened(saved(tmp_path, f"<!doctype html>{told}{notebook.framed(inside, 'live', 800)}"))
    tab.until("document.title === 'Proved'")
    assert tab.said == []


def test_a_page_fits_a_phone_and_its_controls_have_names(tab: Browser, tmp_path: Path) -> None:
    tab.ask("Emulation.setDeviceMetricsOverride", width=360, height=740, deviceScaleFactor=2, mobile=True)
    tab.opened(saved(tmp_path, assembled(content("ur10_fast"))))
    tab.until(f"{HEADLINE} === 'Proved'")
    assert tab.value("document.documentElement.scrollWidth") == 360
    controls = "[...document.querySelectorAll('input, button, select')]"
    nameless = f"{controls}.filter((e) => !e.ariaLabel && !e.labels?.length && !e.textContent)"
    assert tab.value(f"{nameless}.map((e) => e.outerHTML)") == []
    tab.ask("Emulation.clearDeviceMetricsOverride")


@pytest.mark.parametrize("name", ["ur10_fast", "arm2_joint"])
def test_a_page_is_small_and_asks_for_nothing(name: str) -> None:
    html = assembled(content(name))
    assert len(html.encode()) < 200_000
    assert not re.search(r"(src|href)=[\"'](?!data:)|@import|url\(|fetch\(|importScripts|https?:", html)
