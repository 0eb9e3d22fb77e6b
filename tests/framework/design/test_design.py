"""`dmframe design`: requests, the family of plants, paths, the decision, and its honest ends."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import dmframe as dm
from dmframe.cli.app import app
from dmframe.common.errors import DmframeError, UnknownNameError
from dmframe.design import design as module
from dmframe.design.decide import Candidate, Ranking, worth
from dmframe.design.family import HELD_OUT, TRAINING, makers
from dmframe.design.motion import ACCELERATION, AGAIN, NEVER, motion_of
from dmframe.design.motion import TRAINING as TRAINED
from dmframe.design.race_text import FIRST, race_text
from dmframe.design.request import Request
from dmframe.graph.first import FirstGraph, first_graph
from dmframe.race.plan import Run
from dmframe.race.read import load_race


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
    assert set(race.file.laws) == {"feedback", "level", "trend", "repetitive", "experts", "adaptive"}
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


def test_a_task_that_is_missing_is_a_blocked_design_with_a_report(tmp_path: Path) -> None:
    found = CliRunner().invoke(app, ["design", "ur5e", "--task", "pose", "--out", str(tmp_path / "d"), "--json"])
    summary = json.loads(found.stdout)
    assert summary["outcome"] == "blocked"
    assert (summary["graph"], summary["error"], summary["rival_error"], summary["unit"]) == (None, None, None, "mrad")
    assert "--task pose" in summary["reason"]
    assert "no controller for ur5e" in Path(summary["report"]).read_text()
    assert found.return_value == 1 or found.exit_code in (0, 1)


def test_a_robot_that_is_no_arm_is_blocked_and_an_unknown_one_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError):
        module.design(Request.of("ur55"), tmp_path / "unknown")
    urdf = tmp_path / "one.urdf"
    urdf.write_text(
        '<robot name="one"><link name="base"/><link name="tip"/><joint name="j" type="revolute"><parent link="base"/>'
        '<child link="tip"/><axis xyz="0 0 1"/><limit lower="-1" upper="1" velocity="1" effort="1"/></joint></robot>'
    )
    found = module.design(Request.of(str(urdf)), tmp_path / "few")
    assert found.outcome == "blocked"
    assert "expected an arm with 4 to 7" in found.reason
    assert json.loads((tmp_path / "few" / "design.json").read_text())["outcome"] == "blocked"


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
    found = module.Designed("blocked", "", tmp_path, "arm", 0.008, 0.0)
    check = module._rehearsed(Rehearsing(*errors), candidate("level", [1.0]), found)  # type: ignore[arg-type]
    assert check.passed is passed
    assert text in check.text
    adaptive = candidate("experts", [1.0], adaptive=True)
    assert not module._rehearsed(Rehearsing(*errors), adaptive, found).passed  # type: ignore[arg-type]


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
    assert {name for name, _ in found.files} >= {"graph.yaml", "controller/", "commands.txt"}
    again = module.design(Request.of("ur3e", payload="0..1"), tmp_path)
    assert again.summary == found.summary
