"""Which controller for which task: the tables are those of the graphs, of their verdicts and of runs."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

import dmframe as dm
from dmframe.errors import DmframeError
from dmframe.port import Side

ROOT = Path(__file__).parents[2]
Rows = dict[str, dict[str, str]]


@pytest.fixture(scope="module")
def which() -> ModuleType:
    spec = importlib.util.spec_from_file_location("make_which", ROOT / "docs" / "make_which.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def said(which: ModuleType) -> dict[str, Any]:
    return dict(which.words())


@pytest.fixture(scope="module")
def rows(which: ModuleType) -> Rows:
    return {row["graph"]: row for row in which.read(which.TABLE)}


def number(cell: str) -> float:
    """The first of a cell."""
    found = re.match(r"[\d.]+", cell)
    assert found is not None, cell
    return float(found.group())


def test_each_packaged_graph_has_a_line_or_a_reason_for_having_none(which: ModuleType, said: dict[str, Any]) -> None:
    assert list(which.faults(said, dm.graphs())) == []
    lacking = {**said, "graphs": {name: word for name, word in said["graphs"].items() if name != "ur10_pose"}}
    assert list(which.faults(lacking, dm.graphs())) == ["ur10_pose has no line in which.yaml"]
    more = {**said, "left_out": {**said["left_out"], "ur10_fast": "no reason", "ur11": "no such graph"}}
    assert list(which.faults(more, dm.graphs())) == [
        "ur10_fast has a line and is left out",
        "ur11 is no packaged graph",
    ]


def test_the_page_shows_what_is_kept(which: ModuleType, said: dict[str, Any], rows: Rows) -> None:
    text, laws = which.PAGE.read_text(encoding="utf-8"), which.read(which.LAWS)
    assert list(rows) == list(said["graphs"]), "stale; run: python docs/make_which.py"
    fill = which.fill
    assert fill(text, [*rows.values()], laws, said) == text, "stale; run: python docs/make_which.py --draw"
    moved = [dict(row) for row in laws]
    moved[3]["rms_final"] = "0.5"
    assert fill(text, [*rows.values()], moved, said) != text
    assert fill(text, [{**row, "learnt": "nothing"} for row in rows.values()], laws, said) != text


def test_the_page_behind_a_graph_tells_of_it_or_of_one_of_its_blocks(which: ModuleType, said: dict[str, Any]) -> None:
    for name, word in said["graphs"].items():
        text = (which.PAGE.parent / word["page"]).read_text(encoding="utf-8")
        graph = dm.load(name)
        own = (graph.experiment.data["blocks"][label]["type"] for label in _controllers(graph))
        assert any(f"`{each}`" in text or f"type: {each}" in text for each in (name, *own)) or name in text, name


def _controllers(graph: dm.Graph) -> list[str]:
    return [label for label, block in graph.experiment.blocks.items() if block.side is Side.CONTROLLER]


@pytest.mark.parametrize(
    "name", ["computed_torque", "pd_torque", "observed_regulation_pi", "torque_consistent_pi", "ur10_fast_eso"]
)
def test_a_row_is_what_graph_verdict_and_run_say(name: str, which: ModuleType, rows: Rows) -> None:
    found, kept = dict(which.row_of(name)), dict(rows[name])
    assert number(found.pop("error")) == pytest.approx(number(kept.pop("error")), rel=0.02, abs=1e-4)
    assert found == kept


@pytest.mark.parametrize(
    "name",
    [
        "panda_full",
        "pendulum",
        "torque_indirect_pid",
        "ur10_admittance",
        "ur10_consistent",
        "ur10_fast_position",
        "ur10_paced",
        "ur10_payload",
        "ur10_pose_observed",
        "ur10_slow_sampled",
    ],
)
def test_the_other_cells_are_those_of_the_graph(name: str, which: ModuleType, rows: Rows) -> None:
    kept = rows[name]
    assert which.facts(dm.load(name)) == {key: kept[key] for key in which.FACTS}


def test_facts_change_with_the_graph(which: ModuleType) -> None:
    graph = dm.load("observed_tracking_pi")
    facts = which.facts(graph)
    assert facts["learnt"] == "lengths (12), dynamics (36), servo (6)"
    assert "tool" not in facts["known"]
    known = which.facts(graph.set({"geometry.adapt": "tool"}))
    assert known["learnt"] == "lengths (3), dynamics (36), servo (6)"
    held = which.facts(dm.load("known_tracking_pi"))
    assert held["known"] == "lengths, axes, tool, gravity, v₀"
    assert held["learnt"] == "dynamics (36), servo (6)"
    assert which.facts(graph.set({"clock": "continuous"}))["clock"] == "continuous"


def test_an_estimate_without_a_word_is_told(which: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(which, "LEARNT", {name: word for name, word in which.LEARNT.items() if name != "w_I"})
    with pytest.raises(KeyError, match="w_I: no words in LEARNT"):
        which.learnt(dm.load("pendulum").diagram)


@pytest.mark.parametrize(("law", "circle"), [(0, 0), (0, 1), (3, 0), (4, 1), (5, 0)])
def test_a_law_on_a_circle_comes_out_as_the_table_says(
    law: int, circle: int, which: ModuleType, said: dict[str, Any]
) -> None:
    stated, place = said["laws"][law], said["circles"][circle]
    kept = {(row["law"], row["circle"]): row for row in which.read(which.LAWS)}[stated["title"], place["title"]]
    found = which.law_row(stated, circle, place)
    for key in ("rms_final", "diverged_at"):
        assert bool(found[key]) == bool(kept[key])
        assert float(found[key] or 0) == pytest.approx(float(kept[key] or 0), rel=0.02)


def test_all_laws_of_a_circle_have_its_plant_path_clock_and_start(which: ModuleType, said: dict[str, Any]) -> None:
    for k, circle in enumerate(said["circles"]):
        base = dm.load(circle["on"])
        for law in said["laws"]:
            graph = which.law_of(law["cells"][k], circle["on"])
            assert graph.duration == base.duration, law["title"]
            assert graph.clock == base.clock, law["title"]
            assert graph.experiment.start == base.experiment.start
            shared = {"path", "arm"} if "no servo" in law["title"] else {"path", "arm", "servo"}
            assert {name: graph.blocks[name] for name in shared} == {name: base.blocks[name] for name in shared}


def test_what_the_page_says_of_the_competitors_agrees_with_the_table(which: ModuleType, said: dict[str, Any]) -> None:
    cells = {(row["law"], row["circle"]): row for row in which.read(which.LAWS)}
    titles = [law["title"] for law in said["laws"]]
    for circle in (circle["title"] for circle in said["circles"]):
        rms = [float(cells[title, circle]["rms_final"] or "inf") for title in titles]
        without, paper = rms[:6], rms[6]
        assert sum(value < paper for value in without) == 3
        assert min(without) == without[5]
        assert sorted(rms)[:2] == [rms[10], rms[9]]


def test_a_cell_that_names_no_graph_is_told(which: ModuleType) -> None:
    with pytest.raises(DmframeError, match="ur11"):
        which.law_of({"of": "ur11"}, "ur10_fast")
