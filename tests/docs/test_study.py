"""The study of Section V: its page and pictures are those of its data, and its data are those of its runs."""

from __future__ import annotations

import importlib.util
import itertools
import math
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from dmframe.config.graph import load_graph

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def study() -> ModuleType:
    spec = importlib.util.spec_from_file_location("study_section_v", ROOT / "docs" / "study" / "section_v.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["study_section_v"] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


def test_the_data_hold_every_place_of_the_map_once(study: ModuleType) -> None:
    rows = study.read()
    assert [(row.place, row.controller) for row in rows] == [(cell.place, cell.controller) for cell in study.cells()]
    assert all(math.isnan(row.rms_mm) != math.isnan(row.diverged) for row in rows)
    assert not any(math.isfinite(row.diverged) for row in rows if row.controller == "kinematic")


def test_the_page_holds_the_tables_of_the_data(study: ModuleType) -> None:
    text = study.PAGE.read_text(encoding="utf-8")
    assert study.fill(text, study.read()) == text, "stale; run: python docs/study/section_v.py --draw"
    assert text.count("| fast | x ") == len(study.SERVOS) * len(study.CLOCKS)


def test_the_pages_sentences_agree_with_the_data(study: ModuleType) -> None:
    rows, text = study.read(), study.PAGE.read_text(encoding="utf-8")
    told = {controller: study.ratios(rows, controller) for controller in study.TITLES}
    slow = [value for place, value in told["paper"].items() if place[0] == "slow"]
    assert f"({sum(value >= 1 for value in slow)} of {len(slow)})" in text
    assert f"by up to a factor of {max(slow):.1f}" in text
    places = list(told["paper"])
    missed = [place for place in places if min(values[place] for values in told.values()) >= 1]
    assert [place[0] for place in missed] == ["fast"]
    diverged = [place for place, value in told["paper"].items() if np.isinf(value)]
    assert diverged == [("fast", 0.1, 0.0, 0.09)]
    assert {(place[1], place[3]) for place, value in told["boxed_10"].items() if np.isinf(value)} == {
        (0.1, 0.09),
        (0.3, 0.09),
    }
    worst = max((value, place) for place, value in told["boxed_100"].items() if np.isfinite(value))
    assert worst[1] == ("slow", 3.0, 1.0, 0.09)
    assert f"{worst[0]:.1f} times the kinematic error" in text


def test_the_pictures_are_small_enough(study: ModuleType) -> None:
    for task in study.TASKS:
        assert study.FOLDER.joinpath(f"section_v_{task}.png").stat().st_size < 200_000


def test_a_cell_is_a_packaged_graph_with_other_numbers(study: ModuleType) -> None:
    name, changes = study.overrides(study.Cell("fast", 3.0, 0.0, 0.03, "boxed_100"))
    graph = load_graph(name, changes)
    assert name == "ur10_fast"
    assert graph.file.clock == pytest.approx(0.03)
    assert graph.blocks["servo"].K_D == (2400, 2400, 1200)
    assert graph.blocks["arm"].coulomb == (0, 0, 0)
    assert graph.blocks["dynamics"].Gamma == 100
    assert graph.blocks["inverse"].w_box == (0, pytest.approx(0.004 / 3, rel=1e-5))


def test_the_graphs_own_cell_changes_nothing_but_the_horizon_and_the_step(study: ModuleType) -> None:
    for task, clock, controller in itertools.product(("fast", "slow"), (0.008, 0.09), ("kinematic", "paper")):
        if (task, clock) in (("fast", 0.09), ("slow", 0.008)):
            continue
        name, changes = study.overrides(study.Cell(task, 1.0, 1.0, clock, controller))
        changed, own = load_graph(name, changes), load_graph(name)
        assert changed.blocks == own.blocks
        assert changed.file.clock == pytest.approx(own.file.clock)


def test_two_runs_of_the_study_come_out_as_the_data_say(study: ModuleType) -> None:
    rows = {(row.place, row.controller): row for row in study.read()}
    for cell in (
        study.Cell("slow", 1.0, 1.0, 0.09, "kinematic"),
        study.Cell("fast", 0.1, 1.0, 0.09, "boxed_100"),
    ):
        found, kept = study.run(cell), rows[cell.place, cell.controller]
        assert found.rms_mm == pytest.approx(kept.rms_mm, rel=0.01, nan_ok=True)
        assert found.diverged == pytest.approx(kept.diverged, rel=0.2, nan_ok=True)
