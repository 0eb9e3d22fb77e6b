"""A report in a narrow window, in Chromium."""

from __future__ import annotations

from pathlib import Path

import pytest
from in_chromium import Chromium

import dmframe as dm

OVERHANG = "document.documentElement.scrollWidth - document.documentElement.clientWidth"
# Not in a box that scrolls by itself, and not inside a picture or a formula.
OUTSIDE = """[...document.querySelectorAll("body *")].filter((e) => e.getBoundingClientRect().right > innerWidth + 1
  && !e.closest("svg, math, table, .equations, .f, .signal")).map((e) => e.outerHTML.slice(0, 80))"""


@pytest.mark.parametrize("name", ["pendulum", "ur10_fast"])
def test_a_report_is_not_wider_than_its_window(tab: Chromium, tmp_path: Path, name: str) -> None:
    page = tmp_path / "report.html"
    dm.load(name).until("0.2 s").verify().report(page)
    for width in (360, 390, 1250):
        tab.sized(width, 844)
        tab.opened(page)
        tab.until("document.querySelectorAll('article').length")
        assert tab.value("innerWidth") == width
        assert tab.value(OVERHANG) == 0
        assert tab.value(OUTSIDE) == []
    assert tab.said == []
    tab.sized(None)
