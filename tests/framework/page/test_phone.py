"""A live page on a phone, and where it is out of sight."""

from __future__ import annotations

from pathlib import Path

import pytest
from in_chromium import Chromium
from in_node import content

from dmframe.page.page import assembled

HEADLINE = "document.getElementById('headline').textContent"
FRAMES = """(async () => {
  const original = requestAnimationFrame, wait = (ms) => new Promise((done) => setTimeout(done, ms));
  let count = 0;
  await wait(200);
  globalThis.requestAnimationFrame = (next) => { count++; return original(next); };
  await wait(300);
  globalThis.requestAnimationFrame = original;
  return count;
})()"""


def opened(tab: Chromium, folder: Path, size: tuple[int, int]) -> None:
    page = folder / "page.html"
    page.write_text(assembled(content("ur10_demo")), "utf-8")
    tab.sized(*size)
    tab.opened(page)
    tab.until(f"{HEADLINE} === 'Proved in continuous time'")


@pytest.mark.parametrize("size", [(390, 844), (360, 740)])
def test_the_picture_stays_in_sight_above_the_sliders(tab: Chromium, tmp_path: Path, size: tuple[int, int]) -> None:
    opened(tab, tmp_path, size)
    tab.value("document.getElementById('move-servo.K_D').closest('details').open = true")
    tab.value("document.getElementById('move-servo.K_D').scrollIntoView({ block: 'end' })")
    box = "(({ top, bottom }) => [top, bottom])(document.getElementById({}).getBoundingClientRect())"
    top, bottom = tab.value(box.replace("{}", "'view'", 1))
    slider, end = tab.value(box.replace("{}", "'move-servo.K_D'", 1))
    assert top >= 0
    assert bottom < slider
    assert end < size[1] + 1
    assert tab.value("document.documentElement.scrollWidth") == size[0]
    tab.sized(None)


LINES = """(() => {
  const verdict = document.getElementById('verdict');
  return verdict.clientHeight / parseFloat(getComputedStyle(verdict).lineHeight);
})()"""


@pytest.mark.parametrize(("size", "lines"), [((390, 844), 4), ((1000, 700), 4), ((1280, 900), 3)])
def test_the_verdict_ends_between_two_lines_and_values_have_units(
    tab: Chromium, tmp_path: Path, size: tuple[int, int], lines: int
) -> None:
    opened(tab, tmp_path, size)
    assert tab.value(LINES) == pytest.approx(lines, abs=0.05)
    readings = "[...document.querySelectorAll('#first .plot:first-child .legend b')].map((b) => b.textContent)"
    assert all(text.endswith("mm") for text in tab.value(readings))
    tab.sized(None)


def test_a_page_out_of_sight_draws_nothing(tab: Chromium, tmp_path: Path) -> None:
    opened(tab, tmp_path, (1250, 640))
    tab.value("document.getElementById('play').click()")
    assert tab.value(FRAMES) > 2
    tab.value("document.body.style.paddingTop = '6000px', scrollTo(0, 0)")
    assert tab.value(FRAMES) == 0
    tab.value("document.body.style.paddingTop = ''")
    assert tab.value(FRAMES) > 2
    tab.sized(None)
