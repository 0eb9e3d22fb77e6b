"""The packaged demonstration: its figures, its rivals and buttons in a browser, and the page in the package."""

from __future__ import annotations

import base64
import importlib.util
import json
import re
import zlib
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from in_chromium import Chromium
from in_node import content

import dmframe as dm
from dmframe.block.model import SYMBOLIC
from dmframe.catalogue import find_page, pages
from dmframe.certify.claim import claim_of
from dmframe.exact.rational import as_float
from dmframe.page.page import assembled, policy
from dmframe.page.periods import stable_periods
from dmframe.results.along import along
from dmframe.results.run import Run

NAME = "ur10_demo"
LOAD = {"load.at": [0.0, 8.0]}
SCORES = "[...document.querySelectorAll('#scores tr')].map((row) => row.cells[2].textContent)"
HEADLINE = "document.getElementById('headline').textContent"
STATE = "document.getElementById('verdict').className"
COMMAND = "document.getElementById('command').textContent"


@cache
def runs(**changes: Any) -> tuple[Run, ...]:
    """Runs of the graph and of its rivals."""
    graph = dm.load(NAME)
    changed = {"clock": changes["clock"]} if "clock" in changes else {}
    changed |= LOAD if changes.get("loaded") else {}
    return tuple(
        each.set(changed).run(judge=False) for each in (graph, *(graph.rival(name) for name in graph.file.page.rivals))
    )


def rms(run: Run, first: float, last: float) -> float:
    """Root mean square of the error [m]."""
    assert run.error is not None
    within = (run.time >= first) & (run.time <= last)
    return float(np.sqrt(np.mean(run.error.norm[within] ** 2)))


def storage(run: Run) -> np.ndarray:
    kappa = dm.load(NAME).verify().verdict.kappa
    assert kappa is not None
    return along(claim_of(run.recording.diagram), run.recording, as_float(kappa.chosen)).V


def test_the_demonstration_learns_and_its_rival_of_the_same_gain_does_not() -> None:
    ours, same_gain, inverse = runs()
    assert rms(ours, 16, 20) < 0.25e-3
    assert rms(same_gain, 16, 20) > 3e-3
    assert rms(inverse, 16, 20) < rms(ours, 16, 20)  # the page says so
    V = storage(ours)
    rises = np.diff(V)[np.diff(V) > 0]
    assert V[-1] < 0.08 * V[0]
    assert rises.sum() < 0.0005 * V[0]


def test_a_long_period_lets_v_rise() -> None:
    (ours, *_) = runs(clock="32 ms")
    V = storage(ours)
    assert V[-1] > 2 * V[np.searchsorted(ours.time, 5.0)]


def shown(text: str) -> float:
    """A printed length [m]."""
    number, unit = text.split()
    return float(number) * {"m": 1.0, "mm": 1e-3, "µm": 1e-6}[unit]


def page_of(folder: Path, **changed: Any) -> Path:
    """The demonstration's page, with some of its data changed."""
    place = folder / "page.html"
    html = assembled({**content(NAME), **changed})
    script = re.search(r'<script type="module">(.*?)</script>', html, re.DOTALL)
    assert script is not None
    longer = f"{script[1]}globalThis.simulated = () => run;\n"  # a page keeps its run for itself
    style = re.search(r"<style>(.*?)</style>", html, re.DOTALL)
    assert style is not None
    html = html.replace(script[1], longer).replace(policy(script[1], style[1]), policy(longer, style[1]))
    place.write_text(html, "utf-8")
    return place


CHANGES: dict[str, dict[str, Any]] = {"": {}, "#load.at=[0,8]": {"loaded": True}, "#clock=16": {"clock": "32 ms"}}


def scores_are_those_of_runs(tab: Chromium, page: Path, fragment: str) -> None:
    tab.opened(page, fragment)
    texts = tab.until(f"{HEADLINE} !== 'Loading' && {SCORES}.length && {SCORES}")
    # the page compares a thousand instants of the run
    expected = [rms(run, 16, 20) for run in runs(**CHANGES[fragment])]
    assert [shown(text) for text in texts] == pytest.approx(expected, rel=0.02)
    assert tab.said == []


@pytest.mark.parametrize("fragment", CHANGES)
def test_the_page_prints_the_errors_that_runs_give(tab: Chromium, tmp_path: Path, fragment: str) -> None:
    scores_are_those_of_runs(tab, page_of(tmp_path), fragment)


def test_rivals_that_do_not_get_the_load_would_be_noticed(tab: Chromium, tmp_path: Path) -> None:
    alone = [{**rival, "shared": []} for rival in content(NAME)["rivals"]]
    with pytest.raises(AssertionError):
        scores_are_those_of_runs(tab, page_of(tmp_path, rivals=alone), "#load.at=[0,8]")


def test_buttons_set_values_and_reset_them(tab: Chromium, tmp_path: Path) -> None:
    tab.opened(page_of(tmp_path), "#at=8")
    tab.until(f"{HEADLINE} === 'Proved in continuous time'")
    tab.value("document.getElementById('button-load').click()")
    assert tab.until(f"{COMMAND}.includes('load.at') && {COMMAND}").endswith("--set 'load.at=[0, 8]'")
    assert tab.value("decodeURIComponent(location.hash)") == "#load.at=[0,8]"
    assert tab.value(HEADLINE) == "Proved at these values in continuous time"
    assert "holds 3 kg" in tab.value("document.getElementById('says').textContent")
    tab.value("document.getElementById('button-load').click()")
    tab.until(f"!{COMMAND}.includes('load.at')")
    tab.value("document.getElementById('button-clock').click()")
    assert tab.until(f"{COMMAND}.includes('clock=0.032') && {STATE}").split()[0] == "fails"
    assert re.match("This run is not as proved: sampled every 32 ms, V rises by", tab.value(HEADLINE))
    tab.value("document.getElementById('reset').click()")
    tab.until(f"{HEADLINE} === 'Proved in continuous time'")
    assert tab.value("document.getElementById('says').textContent") == ""
    assert tab.said == []


def test_the_deviation_is_enlarged_and_labelled(tab: Chromium, tmp_path: Path) -> None:
    tab.opened(page_of(tmp_path), "#at=18")
    tab.until(f"{HEADLINE} === 'Proved in continuous time'")
    label = "document.getElementById('enlarge').textContent"
    assert tab.value(label) == "deviation × 20"
    far = tab.value("Math.hypot(...simulated().trace.slice(-3).map((x, k) => x - simulated().path.at(k - 3)))")
    tab.value("document.getElementById('enlarge').click()")
    assert tab.value(label) == "deviation × 1"
    near = tab.value("Math.hypot(...simulated().trace.slice(-3).map((x, k) => x - simulated().path.at(k - 3)))")
    assert far == pytest.approx(20 * near, rel=1e-3)


def test_an_address_that_sets_other_values_than_a_button_is_reported(tab: Chromium, tmp_path: Path) -> None:
    tab.opened(page_of(tmp_path), "#load.at=[5,8]")
    notice = "document.getElementById('notice').textContent"
    assert "load.at=[5,8]" in tab.until(f"{HEADLINE} !== 'Loading' && {notice}")


def made(html: str) -> tuple[str, dict[str, Any]]:
    """A page without its data and its policy, and the data with decoded modules."""
    found = re.search(r'id="data">(.*?)</script>', html, re.DOTALL)
    assert found is not None
    data = json.loads(found[1])
    for loop in (data, *(rival["loop"] for rival in data["rivals"])):
        loop["module"] = zlib.decompress(base64.b64decode(loop["module"])).hex()
    return html.replace(found[1], ""), data


def same(one: Any, other: Any) -> bool:
    """Equal up to rounding."""
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same(one[key], other[key]) for key in one)
    if isinstance(one, list):
        return len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, float):
        return bool(np.isclose(one, other, rtol=1e-9, atol=1e-12))
    if isinstance(one, str):  # lines are as long as the terminal is wide
        return one.split() == other.split()
    return bool(one == other)


def fresh_page() -> str:
    """The page as `docs/make_demo.py` makes it, with its periods."""
    graph = dm.load(NAME)
    with SYMBOLIC:
        periods = stable_periods(graph.diagram, graph.clock, graph.verify().verdict, graph.start)
    return assembled({**content(NAME), "periods": None if periods is None else periods.data})


def test_the_page_in_the_package_is_current_and_small() -> None:
    place = find_page(NAME)
    assert place.stat().st_size < 200_000
    packaged, fresh = (made(html) for html in (place.read_text("utf-8"), fresh_page()))
    remedy = "run python docs/make_demo.py"
    assert packaged[0] == fresh[0], remedy
    for key in fresh[1].keys() - {"dmframe"}:  # the installed version
        assert same(packaged[1][key], fresh[1][key]), f"{key}: {remedy}"


def test_a_page_is_packaged_for_each_graph_that_has_rivals() -> None:
    file = Path(__file__).parents[3] / "docs" / "make_demo.py"
    spec = importlib.util.spec_from_file_location("make_demo", file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert module.packaged() == pages()
