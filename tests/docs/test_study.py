"""The study of Section V: its page and figures are generated from its data, and its data from its runs."""

from __future__ import annotations

import importlib.util
import itertools
import math
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from dmframe.graph.graph import Graph
from dmframe.study.plan import Study
from dmframe.study.read import load_study

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def study() -> ModuleType:
    spec = importlib.util.spec_from_file_location("study_section_v", ROOT / "docs" / "study" / "section_v.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["study_section_v"] = module  # dataclasses look up their module
    spec.loader.exec_module(module)
    return module


def test_the_data_hold_every_run_of_the_study_once(study: ModuleType) -> None:
    rows = study.read()
    assert [(row.place, row.form, row.gains) for row in rows] == [
        (cell.place, cell.form, cell.gains) for cell in study.cells()
    ]
    assert all(math.isnan(row.rms_mm) != math.isnan(row.diverged) for row in rows)
    assert not any(math.isfinite(row.diverged) for row in rows if row.form == "kinematic")


def test_the_page_holds_the_tables_of_the_data(study: ModuleType) -> None:
    text = study.PAGE.read_text(encoding="utf-8")
    assert study.fill(text, study.read()) == text, "stale; run: python docs/study/section_v.py --draw"
    assert text.count("| fast | x ") == len(study.SERVOS) * len(study.CLOCKS)


def of(ratios: dict[Any, float], places: list[Any], task: str) -> list[float]:
    return [ratios[place] for place in places if place[0] == task]


def test_what_the_page_states_of_the_papers_gains_agrees_with_the_data(study: ModuleType) -> None:
    rows, text = study.read(), " ".join(study.PAGE.read_text(encoding="utf-8").split())
    places, law = study.unknown(), {form: study.ratios(rows, form, "paper") for form in study.FORMS}
    slow = {form: of(ratios, places, "slow") for form, ratios in law.items()}
    for ratios in law.values():
        assert max(of(ratios, places, "fast")) < 1
    assert len(slow["velocity"]) == 81
    assert sum(value < 1 for value in slow["velocity"]) == 73
    worse = [place for place in places if place[0] == "slow" and 1 <= law["velocity"][place] < math.inf]
    assert {place[4] for place in worse} == {0.0}  # without friction
    assert max(law["velocity"][place] for place in worse) < 1.065
    late = [row for row in rows if (row.form, row.gains) == ("velocity", "paper") and row.diverged > 0]
    assert sorted(row.diverged for row in late if row.place in places) == [69.3, 179.4]
    assert "in 81 of 81 places of the fast experiment and in 73 of 81 of the slow one" in text
    assert f"slow {sum(value < 1 for value in slow['position'])} of 81" in text
    assert f"worse by up to {(max(slow['position']) - 1) * 100:.0f} %" in text
    tenth = {form: study.ratios(rows, form, "tenth") for form in study.FORMS}
    assert [sum(v < 1 for v in of(tenth["velocity"], places, task)) for task in study.TASKS] == [81, 74]
    assert sum(v < 1 for v in of(tenth["position"], places, "slow")) == 1
    assert [sum(map(math.isinf, ratios.values())) for ratios in law.values()] == [4, 1]


def test_what_the_page_states_of_the_two_forms_agrees_with_the_data(study: ModuleType) -> None:
    rows = study.read()
    first, second = (study.ratios(rows, form, "paper") for form in study.FORMS)
    assert [sum(first[p] < second[p] for p in first if p[0] == task) for task in study.TASKS] == [94, 119]
    first, second = (study.ratios(rows, form, "boxed_100") for form in study.FORMS)
    stable = [p for p in first if min(first[p], second[p]) < math.inf]
    assert [sum(p[0] == task for p in stable) for task in study.TASKS] == [40, 42]
    assert [sum(second[p] < first[p] for p in stable if p[0] == task) for task in study.TASKS] == [32, 13]
    everywhere = dict[str, int]()
    for form in study.FORMS:
        ratios = [study.ratios(rows, form, gains) for gains in study.MAPPED]
        everywhere[form] = sum(min(of_gains[p] for of_gains in ratios) >= 1 for p in study.mapped())
    assert everywhere == {"velocity": 7, "position": 1}


def test_the_condition_of_the_paper_holds_at_every_place_of_the_unknowns(study: ModuleType) -> None:
    for (name, K_c), (_, _, proportional, integral, *_) in itertools.product(
        (("fast", 0.8), ("slow", 1.5)), study.unknown()
    ):
        assert K_c + 2.2 * proportional - 0.7 * integral / K_c > 0, name  # M_bar / K_D without friction


def test_the_pictures_are_small_enough(study: ModuleType) -> None:
    for name in (*study.TASKS, "unknown"):
        assert study.FOLDER.joinpath(f"section_v_{name}.png").stat().st_size < 200_000


@pytest.fixture(scope="module")
def plans(study: ModuleType) -> list[Study]:
    return [load_study(study.FOLDER / f"{name}.yaml") for name in study.STUDIES]


def places_of(study: ModuleType, plans: list[Study]) -> dict[Any, tuple[Study, int]]:
    return {study.cell_of(point.values): (plan, point.index) for plan in plans for point in plan.points}


def test_the_study_files_hold_every_cell(study: ModuleType, plans: list[Study]) -> None:
    assert places_of(study, plans).keys() == set(study.cells())
    assert [len(plan.points) for plan in plans] == [360, 480, 1134]


def test_a_cell_is_a_packaged_graph_with_other_numbers(study: ModuleType, plans: list[Study]) -> None:
    plan, index = places_of(study, plans)[study.Cell("fast", 3.0, 1.0, 1.0, 0.0, 0.03, "position", "boxed_100")]
    graph = plan.points[index].graph
    assert graph.file.clock == pytest.approx(0.03)
    assert graph.blocks["servo"].K_D == (2400, 2400, 1200)  # type: ignore[attr-defined]
    assert graph.blocks["servo"].K_P == (5280, 5280, 2640)  # type: ignore[attr-defined]
    assert graph.blocks["servo"].K_I == (1680, 1680, 840)  # type: ignore[attr-defined]
    assert graph.blocks["arm"].coulomb == (0, 0, 0)  # type: ignore[attr-defined]
    assert graph.blocks["dynamics"].Gamma == 100  # type: ignore[attr-defined]
    assert graph.blocks["inverse"].tie == "position"  # type: ignore[attr-defined]
    assert graph.blocks["inverse"].w_box == (0, pytest.approx(0.004 / 3, rel=1e-5))  # type: ignore[attr-defined]
    plan, index = places_of(study, plans)[study.Cell("slow", 3.0, 0.5, 2.0, 3.0, 0.09, "velocity", "tenth")]
    graph = plan.points[index].graph
    assert (graph.file.clock, graph.file.duration) == (0.09, 200)
    assert graph.blocks["servo"].K_P == (2640, 2640, 1320)  # type: ignore[attr-defined]
    assert graph.blocks["servo"].K_I == (3360, 3360, 1680)  # type: ignore[attr-defined]
    assert graph.blocks["arm"].coulomb == (24, 24, 12)  # type: ignore[attr-defined]
    assert graph.blocks["dynamics"].Gamma == 0.1  # type: ignore[attr-defined]


@pytest.mark.parametrize("task", ["fast", "slow"])
@pytest.mark.parametrize("form", ["kinematic", "velocity", "position"])
def test_the_graphs_own_cell_changes_nothing_but_the_step(
    task: str, form: str, study: ModuleType, plans: list[Study]
) -> None:
    gains = "" if form == "kinematic" else "paper"
    cell = study.Cell(task, 1.0, 1.0, 1.0, 1.0, study.TASKS[task], form, gains)
    plan, index = places_of(study, plans)[cell]
    name = f"ur10_{task}" + {"kinematic": "_kinematic", "position": "_tied_position"}.get(form, "")
    boxes = ("dynamics.a_d_hat", "inverse.w", "inverse.w_P", "inverse.w_I") if gains and task == "fast" else ()
    changed = plan.points[index].graph
    own = Graph.read(name, [f"{estimate}_box=null" for estimate in boxes])  # they are not part of the paper's law
    assert changed.blocks == own.blocks
    assert (changed.file.clock, changed.file.duration) == (own.file.clock, own.file.duration)


def test_runs_of_the_study_come_out_as_in_the_data(study: ModuleType, plans: list[Study]) -> None:
    rows = {(row.place, row.form, row.gains): row for row in study.read()}
    places = places_of(study, plans)
    for cell in (
        study.Cell("slow", 1.0, 1.0, 1.0, 1.0, 0.09, "kinematic", ""),
        study.Cell("slow", 0.3, 1.0, 1.0, 0.0, 0.09, "velocity", "tenfold"),
        study.Cell("fast", 0.1, 1.0, 1.0, 1.0, 0.09, "position", "boxed_100"),
    ):
        plan, index = places[cell]
        found, kept = plan.rows(index, 0, 1), rows[cell.place, cell.form, cell.gains]
        assert found["fault"] == [None]
        assert found["rms_final"][0] * 1e3 == pytest.approx(kept.rms_mm, rel=2e-3, nan_ok=True)
        assert found["diverged_at"][0] == pytest.approx(kept.diverged, rel=0.2, nan_ok=True)


def test_without_the_runs_it_states_which_command_makes_them(
    study: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        study.main([str(tmp_path)])
    assert ended.value.code == 2
    assert "run it first: dmframe study FILE" in capsys.readouterr().err
