"""Which controller for which task: the tables agree with the graphs, their verdicts and runs."""

from __future__ import annotations

import importlib.util
import itertools
import json
import re
import shutil
import subprocess
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import dmframe as dm
from dmframe.block.port import Side
from dmframe.common.errors import DmframeError
from dmframe.graph.which import Guide, guide

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
def reported(which: ModuleType) -> dict[str, Any]:
    return dict(which.words())


@pytest.fixture(scope="module")
def rows(which: ModuleType) -> Rows:
    return {row["graph"]: row for row in which.rows_of(which.TABLE)}


def number(cell: str) -> float:
    """The first value of a cell."""
    found = re.match(r"[\d.]+", cell)
    assert found is not None, cell
    return float(found.group())


def test_each_packaged_graph_has_a_line_or_a_reason_for_having_none(
    which: ModuleType, reported: dict[str, Any]
) -> None:
    assert list(which.faults(reported, dm.graphs())) == []
    lacking = {**reported, "graphs": {name: word for name, word in reported["graphs"].items() if name != "ur10_pose"}}
    assert list(which.faults(lacking, dm.graphs())) == ["ur10_pose has no line in which.yaml"]
    more = {**reported, "left_out": {**reported["left_out"], "ur10_fast": "no reason", "ur11": "no such graph"}}
    assert list(which.faults(more, dm.graphs())) == [
        "ur10_fast has a line and is left out",
        "ur11 is no packaged graph",
    ]


def test_the_page_shows_what_is_kept(which: ModuleType, reported: dict[str, Any], rows: Rows) -> None:
    text, laws, limits = (
        which.PAGE.read_text(encoding="utf-8"),
        which.rows_of(which.LAWS),
        which.rows_of(which.LIMITS),
    )
    assert list(rows) == list(reported["graphs"]), "stale; run: python docs/make_which.py"
    fill = which.fill
    assert fill(text, [*rows.values()], laws, limits, reported) == text, "stale; run: python docs/make_which.py --draw"
    moved = [dict(row) for row in laws]
    moved[2]["rms_final"] = "0.5"
    assert fill(text, [*rows.values()], moved, limits, reported) != text
    assert fill(text, [*rows.values()], laws, [{**row, "room": "-0.01"} for row in limits], reported) != text
    assert fill(text, [{**row, "learnt": "none"} for row in rows.values()], laws, limits, reported) != text


def answer_rows(which: ModuleType) -> list[list[str]]:
    """The cells of the page's first table, without Markdown markup."""
    text = which.PAGE.read_text(encoding="utf-8")
    lines = text.partition(which.ANSWERS_BEGIN)[2].partition(which.ANSWERS_END)[0].strip().splitlines()[2:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def combinations() -> list[list[str]]:
    """Answers to the five questions, in order."""
    choices = [list(item.choices) or ["8 ms", "12 ms", "13 ms", "90 ms"] for item in guide().questions.values()]
    return [list(answers) for answers in itertools.product(*choices)]


def test_the_first_row_of_the_page_that_fits_is_the_answer_of_the_command(which: ModuleType) -> None:
    found, table = guide(), answer_rows(which)
    for answers in combinations():
        kind = "short" if float(answers[1].split()[0]) <= 12 else "long"
        given = [answers[0], kind, *answers[2:]]
        row = next(
            row
            for row in table
            if all(cell == "any" or ask in cell.split(", ") for cell, ask in zip(row, given, strict=False))
        )
        lines = row[5].split("<br>")
        line = next((part for part in lines if part.startswith(kind)), lines[0])
        selection = found.select(dict(zip(found.questions, answers, strict=True)))
        assert f"[`{selection.take.graph}`]" in line, answers
        assert row[7] == selection.rule.because


def test_the_script_of_the_page_chooses_the_same_row(which: ModuleType) -> None:
    node = shutil.which("node")
    if node is None:
        pytest.skip("Node is not installed")
    script = (which.DOCS / "_static" / "which.js").read_text(encoding="utf-8")
    table = [row[:5] for row in answer_rows(which)]
    inputs = [[answers[0], float(answers[1].split()[0]), *answers[2:]] for answers in combinations()]
    script += f"\nconst [table, inputs] = {json.dumps([table, inputs])};"
    script += "\nconsole.log(JSON.stringify(inputs.map((answers) => dmframeWhich.firstRow(table, answers))));"
    done = subprocess.run([node, "-e", script], capture_output=True, text=True, check=True, timeout=60)
    found = guide()
    rules = [found.rule_for(dict(zip(found.questions, answers, strict=True))) for answers in combinations()]
    assert json.loads(done.stdout) == [next(k for k, each in enumerate(found.rules) if each is rule) for rule in rules]


def test_a_changed_answer_makes_the_page_stale(which: ModuleType, reported: dict[str, Any], tmp_path: Path) -> None:
    for file in which.GUIDES.iterdir():
        shutil.copy(file, tmp_path)
    lines = list(which.answer_table(guide(), reported))
    assert "\n".join(lines) in which.PAGE.read_text(encoding="utf-8")
    file = tmp_path / "which.yaml"
    file.write_text(file.read_text(encoding="utf-8").replace("take: ur10_slow_supervised", "take: ur10_slow_sampled"))
    assert list(which.answer_table(Guide(file), reported)) != lines


def test_each_error_of_the_answers_is_that_of_one_cell(which: ModuleType, reported: dict[str, Any]) -> None:
    rows = which.rows_of(which.LAWS)
    cells = [(row["graph"], row["circle"]) for row in rows if row["graph"]]
    assert len(set(cells)) == len(cells)
    for row in rows:
        law = next(law for law in reported["laws"] if law["title"] == row["law"])
        k, circle = next(pair for pair in enumerate(reported["circles"]) if pair[1]["title"] == row["circle"])
        cell = law["cells"][circle.get("cell", k)]
        assert row["graph"] == (cell if isinstance(cell, str) else cell.get("of", ""))
    for servo, periods in guide().plants.items():
        for kind, titles in periods.items():
            circles = [next(each for each in reported["circles"] if each["title"] == title) for title in titles]
            assert [circle["on"] for circle in circles] == [{"short": "ur10_fast", "long": "ur10_slow"}[kind]] * 2
            assert [circle.get("reality") for circle in circles] == [None, "ur"]
            assert all(("servo" in circle) == (servo == "stiff") for circle in circles)


def test_the_page_behind_a_graph_mentions_it_or_one_of_its_blocks(which: ModuleType, reported: dict[str, Any]) -> None:
    for name, word in reported["graphs"].items():
        text = (which.PAGE.parent / word["page"]).read_text(encoding="utf-8")
        graph = dm.load(name)
        own = (graph.data["blocks"][label]["type"] for label in _controllers(graph))
        assert any(f"`{each}`" in text or f"type: {each}" in text for each in (name, *own)) or name in text, name


def _controllers(graph: dm.Graph) -> list[str]:
    return [label for label, block in graph.blocks.items() if block.side is Side.CONTROLLER]


@pytest.mark.parametrize(
    "name", ["computed_torque", "pd_torque", "observed_regulation_pi", "torque_consistent_pi", "ur10_fast_eso"]
)
def test_a_row_is_what_graph_verdict_and_run_state(name: str, which: ModuleType, rows: Rows) -> None:
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


def test_an_estimate_without_a_word_is_reported(which: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(which, "LEARNT", {name: word for name, word in which.LEARNT.items() if name != "w_I"})
    with pytest.raises(KeyError, match="w_I: no words in LEARNT"):
        which.learnt(dm.load("pendulum").diagram)


@pytest.mark.parametrize(("law", "circle"), [(0, 0), (0, 1), (0, 3), (0, 4), (3, 0), (4, 1), (4, 2), (4, 5), (5, 0)])
def test_a_law_on_a_circle_comes_out_as_in_the_table(
    law: int, circle: int, which: ModuleType, reported: dict[str, Any]
) -> None:
    stated, place = reported["laws"][law], reported["circles"][circle]
    kept = {(row["law"], row["circle"]): row for row in which.rows_of(which.LAWS)}[stated["title"], place["title"]]
    found = which.law_row(stated, circle, place)
    for key in ("rms_final", "diverged_at", "at_limits"):
        assert bool(str(found[key])) == bool(kept[key])
        assert float(found[key] or 0) == pytest.approx(float(kept[key] or 0), rel=0.02)


FRONT = {
    "stiff P-PI cascade": ("fast circle, stiff cascade", "slow circle, stiff cascade"),
    "soft PID": ("fast circle", "slow circle"),
}
FRONT_LAWS = ("inverse of J, the gain from margins", "the paper's law, tuned", "the sampled law")


@pytest.mark.parametrize("page", ["README.md", "docs/index.md"])
def test_the_front_pages_figures_are_those_of_the_competitors(page: str, which: ModuleType) -> None:
    text = ROOT.joinpath(page).read_text(encoding="utf-8")
    rows = re.findall(r"^\| ([^|]+) \| (8|90) ms \| (.+) \|$", text, re.MULTILINE)
    assert len(rows) == 4
    kept = {(row["law"], row["circle"]): row for row in which.rows_of(which.LAWS)}
    servo = ""
    for label, clock, cells in rows:
        servo = next((name for name in FRONT if label.startswith(name)), servo)
        circle = FRONT[servo][clock == "90"]
        ideal = circle if "cascade" in circle else f"{circle}, {clock} ms"
        for law, cell in zip(FRONT_LAWS, cells.split(" | "), strict=True):
            (title,) = {one for one, _ in kept if law in one and "supervised" not in one}
            for reported, place in zip(cell.replace("*", "").split(" / "), (ideal, f"{circle}, `ur`"), strict=True):
                error = 1e3 * float(kept[title, place]["rms_final"])
                assert float(reported) == pytest.approx(error, rel=0.01), (law, place)


def test_at_limits_is_the_share_of_instants_in_which_commands_or_torques_were_cut_off(
    which: ModuleType, reported: dict[str, Any]
) -> None:
    """0.2 s of a robot that is commanded 9 rad/s: measured at the output of the limits."""
    graph = dm.load("ur10_fast_kinematic").set({"task.gamma": 900, "start.q": [1.2, -1.2, 1.2], "duration": 0.2})
    graph = graph.reality({"command_limits": {}})
    run = graph.run(progress=False, judge=False)
    before, after = (run.data[name].values for name in ("inverse.dq_c", "command_limits.dq_lim"))
    share = np.mean(np.any(before != after, axis=1))
    assert 0.01 < share < 0.99
    assert which.figures(run, graph)["at_limits"] == pytest.approx(share)
    row = {"rms_final": "0.044", "unit": "m", "diverged_at": ""}
    assert which._cell({**row, "at_limits": "0.723"}) == "**44.0 mm**, at limits 72 % of the time"
    assert which._cell({**row, "at_limits": "0.004"}) == "44.0 mm"
    assert which._cell({**row, "diverged_at": "0.81", "at_limits": ""}) == "**diverges** at 810 ms"


def test_a_law_is_configured_for_the_delay_where_a_predictor_states_from_where_it_goes_on(which: ModuleType) -> None:
    real = which.real(dm.load("ur10_slow_observer"), "ur")
    assert (real.blocks["task"].delay, real.blocks["inverse"].delay) == (1, 1)
    assert which.real(dm.load("ur10_slow_kinematic_inverse"), "ur").blocks["task"].delay == 0
    assert which.real(dm.load("ur10_fast_eso"), "none").blocks.keys() == dm.load("ur10_fast_eso").blocks.keys()


@pytest.mark.parametrize(("title", "reality"), [("observer behind it, margin 5", "none"), ("no limits", "ur")])
def test_a_law_with_limits_does_what_the_table_states(
    title: str, reality: str, which: ModuleType, reported: dict[str, Any]
) -> None:
    (law,) = (law for law in reported["limits"]["laws"] if title in law["title"])
    kept = {(row["law"], row["reality"]): row for row in which.rows_of(which.LIMITS)}[law["title"], reality]
    found = which.limit_row(law, reality, reported["limits"]["on"])
    assert found["says"] == kept["says"]
    for key in ("rms_final", "room"):
        assert float(found[key]) == pytest.approx(float(kept[key]), rel=0.02)


def test_what_the_page_states_of_laws_with_limits_is_in_the_table(which: ModuleType, reported: dict[str, Any]) -> None:
    rows = {(row["law"], row["reality"]): row for row in which.rows_of(which.LIMITS)}
    titles = [law["title"] for law in reported["limits"]["laws"]]
    assert rows.keys() == {(title, reality) for title in titles for reality in which.REALITIES}
    room = {key: float(row["room"]) for key, row in rows.items()}
    for reality in which.REALITIES:
        assert room[titles[0], reality] == pytest.approx(-0.11, abs=1e-3)
        narrow, wide = ([title for title in titles if f"margin {size}" in title] for size in ("5", "60"))
        assert (len(narrow), len(wide)) == (3, 2)
        for group, margin in ((narrow, 0.005), (wide, 0.06)):
            assert all(abs(room[title, reality] - margin) < 1e-3 for title in group)
            rms = [float(rows[title, reality]["rms_final"]) for title in group]
            assert max(rms) < 1.02 * min(rms)
    reports = [rows[title, "none"]["says"] for title in titles]
    assert reports[:4] == ["no proof"] * 4
    assert "beyond" in reports[4]
    assert reports[5].endswith("at all times")


def test_all_laws_of_a_circle_have_its_plant_path_clock_and_start(which: ModuleType, reported: dict[str, Any]) -> None:
    for k, circle in enumerate(reported["circles"]):
        base = dm.load(circle["on"])
        assert circle.get("reality") in (None, "ur")
        for law in reported["laws"]:
            graph = which.law_of(law["cells"][circle.get("cell", k)], circle["on"])
            assert graph.duration == base.duration, law["title"]
            assert graph.clock == base.clock, law["title"]
            assert graph.start == base.start
            shared = {"path", "arm"} if "no servo" in law["title"] else {"path", "arm", "servo"}
            assert {name: graph.blocks[name] for name in shared} == {name: base.blocks[name] for name in shared}


def test_what_the_page_states_of_the_competitors_agrees_with_the_table(
    which: ModuleType, reported: dict[str, Any]
) -> None:
    cells = {(row["law"], row["circle"]): row for row in which.rows_of(which.LAWS)}
    *titles, series = (law["title"] for law in reported["laws"])  # the last one requires the period of the path
    soft, stiff = ([c for c in reported["circles"] if ("servo" in c) is wanted] for wanted in (False, True))
    ideal, real = ([c["title"] for c in soft if ("reality" in c) is wanted] for wanted in (False, True))
    for circle in ideal:
        rms = [float(cells[title, circle]["rms_final"] or "inf") for title in titles]
        without, paper = rms[:7], rms[7]
        assert sum(value < paper for value in without) == 4
        assert min(without) == without[6]
        assert sorted(rms)[:3] == [rms[12], rms[11], rms[10]]
    for circle in real:
        rms = [float(cells[title, circle]["rms_final"] or "inf") for title in titles]
        assert sorted(rms)[:2] == [rms[12], rms[10]]
    least = {
        circle["title"]: min(
            titles, key=lambda title, at=circle["title"]: float(cells[title, at]["rms_final"] or "inf")
        )
        for circle in reported["circles"]
    }
    assert set(least.values()) == {titles[12]}
    below = {at for at in least if float(cells[series, at]["rms_final"]) < float(cells[least[at], at]["rms_final"])}
    assert below == {stiff[1]["title"]}
    assert round(1e7 * float(cells[series, stiff[1]["title"]]["rms_final"])) == 153
    rms = [float(cells[title, real[0]]["rms_final"]) for title in titles]
    limited = {(title, circle) for title in titles for circle in real if float(cells[title, circle]["at_limits"]) > 0}
    assert limited == {(title, circle) for title in titles[:2] for circle in real} | {(titles[6], real[0])}
    assert rms[5] < 1.1 * float(cells[titles[5], ideal[0]]["rms_final"])
    assert rms[11] == pytest.approx(rms[3], rel=0.1)  # the supervisor sends the kinematic command
    margins, *papers = ([1e3 * float(cells[titles[k], c["title"]]["rms_final"]) for c in stiff] for k in (4, 7, 8, 9))
    assert margins == pytest.approx([0.015, 0.027, 0.043, 0.061], rel=0.02)
    assert 0.495 < min(map(min, papers)) < max(map(max, papers)) < 3.45
    ratios = [tuned / inverse for tuned, inverse in zip(papers[2], margins, strict=True)]
    assert (round(min(ratios)), round(max(ratios))) == (27, 65)


def test_a_cell_that_names_no_graph_is_reported(which: ModuleType) -> None:
    with pytest.raises(DmframeError, match="ur11"):
        which.law_of({"of": "ur11"}, "ur10_fast")
