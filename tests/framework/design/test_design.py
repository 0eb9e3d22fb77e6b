"""`dmframe design`: requests, the family of plants, paths, the decision, and its honest ends."""

from __future__ import annotations

import json
import math
import shlex
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

import dmframe as dm
from dmframe.cli.app import app
from dmframe.common.errors import DmframeError
from dmframe.design import design as module
from dmframe.design.checks import checks_of, rehearsed
from dmframe.design.contest import Contest
from dmframe.design.decide import Candidate, Ranking, worth
from dmframe.design.designed import Check, Designed, graph_name
from dmframe.design.family import HELD_OUT, TRAINING, makers
from dmframe.design.handover import commands, set_aside
from dmframe.design.motion import ACCELERATION, AGAIN, NEVER, motion_of, tool_motion
from dmframe.design.motion import TRAINING as TRAINED
from dmframe.design.page import LAWS, as_html
from dmframe.design.progress import STAGES, Progress
from dmframe.design.race_text import FIRST, race_text
from dmframe.design.request import Request
from dmframe.graph.first import FirstGraph, first_graph
from dmframe.race.plan import Run
from dmframe.race.protocol import Choice, Tried
from dmframe.race.read import load_race
from dmframe.robot.library import load


@pytest.fixture(scope="module")
def first() -> FirstGraph:
    return first_graph("so101", Path())


@pytest.mark.parametrize(("text", "mass"), [("0..3", 3.0), ("0..3 kg", 3.0), ("500 g", 0.5), (2.0, 2.0), ("0", 0.0)])
def test_a_payload_is_a_mass_or_a_range_from_zero(text: str | float, mass: float) -> None:
    assert Request.of("ur5e", payload=text).payload == mass


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"payload": "1..3"}, "expected a range from 0"),
        ({"payload": "-1"}, "a mass of zero or more"),
        ({"payload": "3 s"}, "kg"),
        ({"task": "image"}, "expected joints, position, pose"),
        ({"clock": "1 s"}, "from 2 ms to 100 ms"),
    ],
)
def test_an_invalid_request_is_refused(given: dict[str, str], text: str) -> None:
    with pytest.raises(DmframeError, match=text):
        Request.of("ur5e", **given)


def test_the_family_varies_the_servo_around_the_first_graphs(first: FirstGraph) -> None:
    family = makers(first, 0.3, 48.0)
    assert list(family.plants) == [*TRAINING, *HELD_OUT]
    assert (family.nominal, list(family.training)) == ("pid", ["pid", "cascade"])
    nominal, soft, stiff = (family.plants[name]["servo"]["K_D"] for name in ("pid", "pid_soft", "pid_stiff_late"))
    np.testing.assert_allclose(np.array(soft) / nominal, 0.5, rtol=1e-5)
    np.testing.assert_allclose(np.array(stiff) / nominal, 3.0, rtol=1e-5)
    loads = {name: plant["arm"]["payload"] for name, plant in family.plants.items()}
    assert [name for name, load in loads.items() if load == [0.3]] == ["pid_loaded", "cascade_loaded"]


def test_paths_start_at_rest_at_one_pose_and_stay_below_the_acceleration(first: FirstGraph) -> None:
    motion = motion_of(first)
    t = np.linspace(0.0, 60.0, 20001)[:, None]
    for name, path in motion.paths.items():
        c, a, w, phi = (np.array(path[key]) for key in ("center", "amplitude", "rate", "phase"))
        np.testing.assert_allclose(c + a * np.sin(phi), motion.start, atol=1e-5)
        assert np.max(np.abs(a * w * np.cos(phi))) < 1e-5
        q = c + a * np.sin(w * t + phi)
        assert np.max(np.abs(np.gradient(np.gradient(q, t[:, 0], axis=0), t[:, 0], axis=0)[2:-2])) < 1.01 * ACCELERATION
        if name in (TRAINED, AGAIN):
            np.testing.assert_allclose(w / path["repeats"], np.round(w / path["repeats"]), atol=1e-4)
        else:
            assert name == NEVER
            assert "repeats" not in path


def test_the_race_of_a_robot_has_all_laws_and_no_held_out_cell_in_training(first: FirstGraph, tmp_path: Path) -> None:
    (tmp_path / FIRST).write_text(first.text)
    text = race_text(first, makers(first, 0.1, 48.0), motion_of(first), 0.008)
    (tmp_path / "race.yaml").write_text(text)
    race = load_race(tmp_path / "race.yaml")
    assert set(race.file.laws) == {"feedback", "level", "trend", "repetitive", "experts", "adaptive"} == set(LAWS)
    assert len(race.held_out) == len(HELD_OUT) * 2
    assert not {(c.plant, c.path) for c in race.held_out} & {(c.plant, c.path) for c in race.training}
    assert (race.file.base_unit, race.file.unit) == ("rad", "mrad")
    run = Run("experts", race.held_out[0], race.laws["experts", 0.008].own, 1)
    assert race.graph(run).blocks["inverse"].dynamics == "joints"  # five joints


def candidate(law: str, errors: list[float], *, adaptive: bool = False) -> Candidate:
    return Candidate(law, adaptive, {}, errors)


def test_an_adaptive_law_is_worth_it_only_if_it_is_clearly_and_mostly_better() -> None:
    simple = candidate("level", [1.0] * 10)
    assert worth(candidate("a", [0.5] * 10, adaptive=True), simple) == ""
    assert "0.9 of that of level" in worth(candidate("a", [0.9] * 10, adaptive=True), simple)
    assert "80 % of the cells" in worth(candidate("a", [0.5] * 8 + [1.2] * 2, adaptive=True), simple)
    assert worth(candidate("a", [0.5] * 9 + [1.2], adaptive=True), simple) == ""
    assert worth(candidate("a", [5.0] * 10, adaptive=True), None) == ""


def test_a_law_that_diverges_in_one_cell_is_no_candidate() -> None:
    laws = Ranking([candidate("a", [1e-3, math.inf]), candidate("b", [5.0, 5.0]), candidate("c", [2.0, 3.0])], "mrad")
    assert [item.law for item in laws.ordered(adaptive=False)] == ["c", "b"]
    assert laws.best(adaptive=True) is None
    swapped = laws.including(candidate("b", [1.0, 1.0]))
    assert [item.law for item in swapped.ordered(adaptive=False)] == ["b", "c"]


def test_a_task_that_the_arm_cannot_do_is_a_blocked_design_with_a_report(tmp_path: Path) -> None:
    found = CliRunner().invoke(app, ["design", "so101", "--task", "pose", "--out", str(tmp_path / "d"), "--json"])
    summary = json.loads(found.stdout)
    assert summary["outcome"] == "blocked"
    assert (summary["graph"], summary["error"], summary["rival_error"], summary["unit"]) == (None, None, None, "mm")
    assert "at least 6 joints" in summary["reason"]
    assert "no controller for so101" in Path(summary["report"]).read_text()
    assert found.return_value == 1 or found.exit_code in (0, 1)


def path_of_the_tool(folder: Path, *rows: str) -> Path:
    (folder / "path.csv").write_text("t,x,y,z\n" + "".join(f"{row}\n" for row in rows))
    return folder / "path.csv"


def test_a_path_out_of_reach_is_a_blocked_design_and_an_unreadable_one_an_error(tmp_path: Path) -> None:
    far = path_of_the_tool(tmp_path, "0,3,0,1", "1,3,0.1,1", "2,3,0.2,1")
    found = module.design(Request.of("ur3e", path=str(far)), tmp_path / "far")
    assert (found.outcome, "out of reach" in found.reason) == ("blocked", True)
    with pytest.raises(DmframeError, match="found joints"):
        module.design(Request.of("ur3e", path=str(far), task="joints"), tmp_path / "far")
    with pytest.raises(DmframeError, match="no orientation"):
        module.design(Request.of("ur3e", path=str(far), task="pose"), tmp_path / "far")
    far.write_text("nothing")
    with pytest.raises(DmframeError, match="column t"):
        module.design(Request.of("ur3e", path=str(far)), tmp_path / "far")
    for key in ("path", "log"):
        with pytest.raises(DmframeError, match=f"{key}: expected a file, found none"):
            Request.of("ur3e", **{key: str(tmp_path / "none.csv")})


def test_the_race_of_a_tool_path_compares_the_error_of_the_tool(first: FirstGraph, tmp_path: Path) -> None:
    (tmp_path / FIRST).write_text(first.text)
    motion = tool_motion(first, load("so101"), turns=False)
    (tmp_path / "race.yaml").write_text(race_text(first, makers(first, 0.1, motion.seconds), motion, 0.008))
    race = load_race(tmp_path / "race.yaml")
    assert (race.file.unit, race.file.duration) == ("mm", 48.0)
    graph = race.graph(Run("feedback", race.held_out[0], race.laws["feedback", 0.008].own, 1))
    assert graph.diagram.loop.goal is not None
    assert (graph.diagram.loop.goal.desired, graph.diagram.loop.goal.actual) == ("path.x_d", "arm.x")


def test_both_kinds_of_laws_have_the_same_number_of_tried_values(monkeypatch: pytest.MonkeyPatch) -> None:
    laws = {"a": candidate("a", [1.0], adaptive=True), "s": candidate("s", [2.0])}
    tried = [Tried((("x", float(k)),), float(k), "" if k != 2 else "diverges") for k in range(6)]
    contest = Contest.__new__(Contest)
    contest.ranking = Ranking(list(laws.values()), "mrad")
    contest._workers = None
    race = SimpleNamespace(held_out=["cell"], file=SimpleNamespace(seed=0))
    choices = [Choice(law, 0.008, tuple(tried)) for law in laws]
    contest._finished = SimpleNamespace(choices=choices, race=race, folder=Path())  # type: ignore[assignment]
    monkeypatch.setattr("dmframe.design.contest.Kept", lambda folder: None)
    monkeypatch.setattr("dmframe.design.contest.computed", lambda race, runs, kept, workers: dict.fromkeys(runs, 3.0))
    for adaptive, law in ((True, "a"), (False, "s")):
        found = list(contest.candidates(adaptive=adaptive))
        assert [item.law for item in found] == [law] * 3
        assert [dict(item.values) for item in found[1:]] == [{"x": 1.0}, {"x": 3.0}]
        assert {item.adaptive for item in found} == {adaptive}


def test_the_reason_against_the_best_adaptive_law_is_that_of_its_best_values(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    best, other = candidate("a", [0.5], adaptive=True), candidate("b", [4.0], adaptive=True)
    simple = candidate("s", [1.0])
    both = {True: [best, candidate("a", [0.6], adaptive=True), other], False: [simple]}
    contest = SimpleNamespace(
        ranking=Ranking([best, other, simple], "mrad"), candidates=lambda adaptive: iter(both[adaptive])
    )
    passed = {"a": False, "b": False, "s": True}
    monkeypatch.setattr(module, "_graph_of", lambda race, item, *_: item)
    monkeypatch.setattr(
        module, "checks_of", lambda graph, item, *_: [Check("c", f"fails {item.error:g}", passed[item.law])]
    )
    monkeypatch.setattr(module, "handed_over", lambda graph, found, *_: found)
    start = Designed("blocked", "", tmp_path, "arm", 0.008, 0.0)
    found = module._chosen(contest, None, None, None, start, Progress(lambda text: None))  # type: ignore[arg-type]
    assert found.outcome == "simple"
    assert "a has a smaller error, but fails 0.5; the error of b is 4 of that of s" in found.reason


def test_laws_that_fail_for_the_same_reason_are_listed_together(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    laws = [candidate("level", [1.0]), candidate("trend", [2.0]), candidate("feedback", [3.0])]
    contest = SimpleNamespace(ranking=Ranking(laws, "mrad"), candidates=lambda adaptive: iter([] if adaptive else laws))
    why = {"level": "no limits", "trend": "too slow", "feedback": "no limits"}
    monkeypatch.setattr(module, "_graph_of", lambda race, item, *_: item)
    monkeypatch.setattr(module, "checks_of", lambda graph, item, *_: [Check("c", why[item.law], passed=False)])
    start = Designed("blocked", "", tmp_path, "arm", 0.008, 0.0)
    found = module._chosen(contest, None, None, None, start, Progress(lambda text: None))  # type: ignore[arg-type]
    assert found.outcome == "blocked"
    assert found.reason.endswith("; level and feedback: no limits; trend: too slow")


@pytest.mark.parametrize("cause", ["", "a joint is at its torque limit"])
def test_where_all_laws_diverge_the_reason_is_the_obstacle_if_one_is_found(
    cause: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ranking = Ranking([candidate("level", [math.inf]), candidate("a", [math.inf], adaptive=True)], "mrad")
    contest = SimpleNamespace(ranking=ranking, candidates=lambda adaptive: iter([]), hardest="cell")
    monkeypatch.setattr(module, "obstacle", lambda race, cell: cause)
    start = Designed("blocked", "", tmp_path, "arm", 0.008, 0.0)
    found = module._chosen(contest, None, None, None, start, Progress(lambda text: None))  # type: ignore[arg-type]
    assert found.outcome == "blocked"
    assert found.reason == cause or (not cause and "each law without a model diverged" in found.reason)


def test_a_graph_of_the_folder_is_kept_when_another_one_takes_its_place(tmp_path: Path) -> None:
    assert set_aside(tmp_path, "graph.yaml", "new") == []
    (tmp_path / "graph.yaml").write_text("edited")
    (tmp_path / "controller").mkdir()
    (tmp_path / "page.html").write_text("page")
    assert set_aside(tmp_path, "graph.yaml", "edited") == []
    assert set_aside(tmp_path, "graph.yaml", "new")[0][0] == "before/1/graph.yaml"
    assert not (tmp_path / "graph.yaml").exists()
    assert not (tmp_path / "controller").exists()
    assert (tmp_path / "before" / "1" / "page.html").read_text() == "page"
    (tmp_path / "graph.yaml").write_text("again")
    assert set_aside(tmp_path, "", None)[0][0] == "before/2/graph.yaml"
    assert (tmp_path / "before" / "1" / "graph.yaml").read_text() == "edited"
    (tmp_path / "design.json").write_text('{"graph": "elsewhere/arm_experts_8ms.yaml"}')
    (tmp_path / "arm_experts_8ms.yaml").write_text("same")
    assert set_aside(tmp_path, "arm_experts_8ms.yaml", "same") == []
    assert set_aside(tmp_path, "arm_level_8ms.yaml", "same")[0][0] == "before/3/arm_experts_8ms.yaml"


def test_each_command_that_repeats_a_design_is_one_that_exists(tmp_path: Path) -> None:
    chosen = candidate("experts", [1.0], adaptive=True)
    found = Designed("adaptive", "r", tmp_path / "a b", "arm", 0.008, 1.5, chosen=chosen, command="dmframe design arm")
    lines = commands(found).splitlines()
    assert len(lines) == 14
    assert all(line.startswith("# ") for line in lines[::2])
    words = [shlex.split(line) for line in lines[1::2]]
    assert [line[1] for line in words] == ["design", "race", "verify", "analyse", "rehearse", "run", "drive"]
    for _, name, *rest in words:
        shown = " ".join(CliRunner().invoke(app, [name, "--help"]).stdout.split())
        assert {word for word in rest if word.startswith("--") and word not in shown} == set()
        assert "a b" in " ".join(rest) or name == "design"


def test_the_report_links_the_files_next_to_it(tmp_path: Path) -> None:
    found = Designed("simple", "r", tmp_path, "arm", 0.008, 1.5, files=[("a b/report.html", "what it is")])
    assert '<a href="a%20b/report.html"><code>a b/report.html</code></a>' in as_html(found)


def test_a_graph_is_named_after_robot_law_and_clock() -> None:
    assert graph_name("ur5e", "experts", 0.008) == "ur5e_experts_8ms.yaml"
    assert graph_name("my arm.urdf.xacro", "level", 0.0025) == "my_arm_level_2_5ms.yaml"


def test_the_rest_is_estimated_from_what_was_done_since_the_start(monkeypatch: pytest.MonkeyPatch) -> None:
    now, said = [0.0], list[str]()
    monkeypatch.setattr("dmframe.design.progress.time.monotonic", lambda: now[0])
    progress = Progress(said.append)
    progress.say("robot", "reading")
    assert said == ["reading"]
    now[0] = float(STAGES["robot"] + STAGES["tuning"])
    progress.say("comparison", "comparing")
    left = sum(STAGES.values()) - now[0]
    assert said[-1] == f"comparing; about {left / 60:.0f} min left in all"
    progress.keep("comparison")  # by an earlier command, at once
    progress.say("proof", "proving")
    assert said[-1] == f"proving; about {(left - STAGES['comparison']) / 60:.0f} min left in all"


class Rehearsing:
    """A graph whose rehearsal has given errors [rad]; None for a run that was stopped."""

    text = "a graph"

    def __init__(self, *errors: float | None) -> None:
        rows = [{"condition": f"c{k}", "needed": True, "rms": rms, "why": "worse"} for k, rms in enumerate(errors)]
        self.summary = {"passed": False, "unit": "rad", "sentence": "", "conditions": rows}

    def rehearse(self, *_: float, **__: float) -> Rehearsing:
        return self


@pytest.mark.parametrize(
    ("errors", "passed", "text"),
    [
        ((0.01, 0.09), True, "fails the rehearsal with c0"),
        ((0.01, 0.2), False, "has an error of 200 mrad with c1"),
        ((0.01, None), False, "is stopped with c1"),
        ((0.01, math.nan), False, "with c1"),
    ],
)
def test_a_simple_law_that_diverges_in_a_rehearsal_is_not_handed_over(
    errors: tuple[float | None, ...], passed: bool, text: str, tmp_path: Path
) -> None:
    found = Designed("blocked", "", tmp_path, "arm", 0.008, 0.0)
    check = rehearsed(Rehearsing(*errors), candidate("level", [1.0]), found, Progress(lambda text: None))  # type: ignore[arg-type]
    assert check.passed is passed
    assert text in check.text
    adaptive = candidate("experts", [1.0], adaptive=True)
    assert not rehearsed(Rehearsing(*errors), adaptive, found, Progress(lambda text: None)).passed  # type: ignore[arg-type]


def test_a_law_that_is_not_proved_is_not_rehearsed_and_has_the_reason(tmp_path: Path) -> None:
    verification = SimpleNamespace(proved=False, stable=False, headline="refuted", reason="inverse: no identity")
    found = Designed("blocked", "", tmp_path, "arm", 0.008, 0.0)
    graph = SimpleNamespace(verify=lambda: verification)
    law = candidate("experts", [1.0], adaptive=True)
    (check,) = checks_of(graph, law, found, Progress(lambda text: None))  # type: ignore[arg-type]
    assert (check.passed, check.text) == (False, "it is not proved: refuted, inverse: no identity")


def test_without_a_compiler_it_says_what_is_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "find_compiler", lambda: None)
    found = module.design(Request.of("so101"), tmp_path)
    assert (found.outcome, "no C compiler" in found.reason) == ("blocked", True)


def test_a_robot_gets_a_controller_that_is_proved_and_rehearsed_or_the_simple_one(tmp_path: Path) -> None:
    found = module.design(Request.of("ur3e", payload="0..1"), tmp_path)
    assert found.outcome in ("adaptive", "simple")
    assert found.chosen is not None
    assert math.isfinite(found.chosen.worst)
    assert all(check.passed for check in found.checks)
    graph = dm.load(found.graph or "")
    if found.outcome == "adaptive":
        assert graph.verify().proved
        assert found.other is not None
        assert found.chosen.error < 0.8 * found.other.error
    assert graph.run(until=20.0).error.rms_by_eighth[-1] < 0.01
    assert {name for name, _ in found.files} >= {"controller/", "commands.txt", f"ur3e_{found.chosen.law}_8ms.yaml"}
    again = module.design(Request.of("ur3e", payload="0..1"), tmp_path)
    assert again.summary == found.summary


def test_the_report_marks_a_proof_of_estimates_alone_and_lists_what_was_assumed(tmp_path: Path) -> None:
    checks = [Check("proof", "over samples", passed=True, whole=False), Check("rehearsal", "passed", passed=True)]
    found = Designed("adaptive", "r", tmp_path, "arm", 0.008, 0.0, checks=checks, assumed=("link a: 2 kg",))
    page = as_html(found)
    assert "passed, in part" in page
    assert "tested by runs alone" in page
    assert "link a: 2 kg" in page
    assert "assumed: link a: 2 kg" in str(found)
    assert found.summary["assumed"] == ["link a: 2 kg"]
    failed = Check("proof", "not applicable", passed=False, whole=False)
    for others in (checks[1:], [failed]):  # nothing, and a proof that failed, cover no part
        other = as_html(Designed("adaptive", "r", tmp_path, "arm", 0.008, 0.0, checks=others))
        assert "in part" not in other
        assert "tested by runs alone" not in other
