"""No setting of the sliders gives a green verdict above a V that rises by more than is stated."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from in_chromium import Chromium
from in_node import content, content_of_graph

import dmframe as dm
from dmframe.page.page import assembled, policy

HEADLINE = "document.getElementById('headline').textContent"
GREEN = 0.05
"""Rise of V, as a fraction of its fall, up to which a verdict may be green."""
# The setting is made as by hand, and V is looked at without the page's own arithmetic: its largest rise above the
# running minimum and its fall, from one step of the load to the next.
TRIAL = """
globalThis.trial = (moves) => {
  sliders.moved.clear();
  sliders.fixed.clear();
  for (const [label, place] of moves) {
    const slider = sliders.rows.find((row) => row.label === label);
    sliders.moved.set(label, valueAt(slider, slider.least + (1 - slider.least) * place));
  }
  simulate(false);
  const V = run.V?.values ?? [], sets = content.buttons.flatMap((button) => button.set);
  const set = sets.find(({ label }) => label === "load.at");
  const step = set ? Math.ceil(sliders.numbers[set.at + 1] / run.tick - 1e-9) : Infinity;
  let least = V[0], start = V[0], rise = 0, fall = 0;
  V.forEach((value, k) => {
    if (k === step) { fall += start - least; least = start = value; }
    least = Math.min(least, value);
    rise = Math.max(rise, value - least);
  });
  fall += start - least;
  const finite = Array.from(V).every(Number.isFinite), text = (id) => document.getElementById(id).textContent;
  const kind = document.getElementById("verdict").className;
  return { kind, headline: text("headline"), detail: text("detail"), rise, fall, first: V[0], finite };
};
"""


def page_of(folder: Path, name: str, right: str = "", wrong: str = "") -> Path:
    """A page on which a test may set the sliders; `wrong` replaces a part of its script."""
    html = assembled(content(name))
    script, style = (re.findall(f"<{tag}>(.*?)</{tag[:6].strip()}>", html, re.DOTALL)[-1] for tag in TAGS)
    assert script.count(right) >= 1
    changed = (script.replace(right, wrong) if right else script) + TRIAL
    place = folder / "page.html"
    place.write_text(html.replace(script, changed).replace(policy(script, style), policy(changed, style)), "utf-8")
    return place


TAGS = ('script type="module"', "style")


def none_is_green_in_error(tab: Chromium, page: Path, name: str, count: int, *moved: str) -> dict[str, int]:
    """Try random settings, of the sliders `moved` if there are any; returns how many had each verdict."""
    tab.opened(page)
    tab.until(f"{HEADLINE} !== 'Loading' && typeof trial === 'function'")
    labels = list(moved) or [slider["label"] for slider in content(name)["sliders"]] + ["clock"]
    draw, seen = np.random.default_rng(7), dict[str, int]()
    for _ in range(count):
        some = draw.choice(labels, min(len(labels), draw.integers(1, 5)), replace=False)
        moves = [[str(label), float(draw.uniform())] for label in some]
        found = tab.value(f"trial({moves})")
        kind = found["kind"].split()[0]
        seen[kind] = seen.get(kind, 0) + 1
        if kind == "proved":
            check(found, moves)
    return seen


def check(found: dict[str, Any], moves: list[Any]) -> None:
    """A green verdict states at least the rise of V."""
    assert found["finite"], moves
    rounding = 1e-9 * abs(found["first"])
    stated = re.search(r"by at most ([\d.]+)(?:·10(\S+))? % of its decrease", found["detail"])
    if stated is None:
        assert found["rise"] <= rounding, (moves, found)
        return
    power = int((stated[2] or "0").translate(str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻", "0123456789-")))
    percent = float(stated[1]) * 10.0**power
    assert found["rise"] <= found["fall"] * percent / 100 * 1.006 + rounding, (moves, found)  # three digits are printed
    assert found["rise"] <= GREEN * found["fall"] + rounding, (moves, found)


@pytest.mark.parametrize("count", [12, 1000])
def test_no_setting_is_green_above_a_v_that_rises_by_more_than_stated(
    tab: Chromium, tmp_path: Path, count: int
) -> None:
    seen = none_is_green_in_error(tab, page_of(tmp_path, "ur10_demo"), "ur10_demo", count)
    assert seen["proved"] > count / 20
    assert set(seen) > {"proved"}
    assert tab.said == []


def test_a_verdict_that_ignores_the_rise_of_v_would_be_noticed(tab: Chromium, tmp_path: Path) -> None:
    page = page_of(tmp_path, "ur10_demo", "if (!climb || !climb.rise) return 0;", "return 0;")
    with pytest.raises(AssertionError):
        none_is_green_in_error(tab, page, "ur10_demo", 60, "clock")


def test_no_v_is_drawn_of_a_graph_that_is_refuted() -> None:
    """With a servo that compensates gravity, the parameters of `regressor` have no true values."""
    data = content_of_graph(dm.load("ur10_fast").set({"arm.maker_gravity": 1}))
    assert data["verdict"]["outcome"] == "refuted"
    assert "storage" not in {group["kind"] for group in data["groups"]}
