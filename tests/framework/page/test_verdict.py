"""A page's verdict at moved numbers and at the graph's."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
from in_node import WEB, answered, content

FILE, MOVED, CLOCK = ({"p": p, "run": run} for p, run in ((False, False), (True, False), (False, True)))


def said(data: dict[str, Any], *questions: dict[str, Any], web: Path = WEB) -> list[dict[str, Any]]:
    answers: list[dict[str, Any]] = answered(data, judged=list(questions), web=web)["answers"]
    return answers


def stated(*conditions: dict[str, Any], **verdict: Any) -> dict[str, Any]:
    """A verdict's data with these conditions only, at margins given by a test."""
    plain = {"how": "exact", "value": 1.0, "holds": True, "size": 1, "strict": True}
    known = {"outcome": "proved", "headline": "proved", "reason": "the identity; more", "kappa": None}
    rows = [{"name": f"condition {k}", "at": k, **plain, **given} for k, given in enumerate(conditions)]
    return {"verdict": {**known, "conclusions": ["x goes to zero"], "conditions": rows, **verdict}, "clock": 0.01}


def margins(*values: float) -> dict[str, Any]:
    """NaN is transferred as null."""
    return {"margins": [None if math.isnan(value) else value for value in values], "moved": MOVED}


@pytest.mark.parametrize("name", ["arm2_joint", "ur10_fast"])
def test_at_the_files_numbers_a_page_judges_as_verify_does(name: str) -> None:
    data = content(name)
    (found,) = said(data, {"p": data["p"], "moved": FILE})
    assert found["state"] == "proved"
    assert found["headline"] == "Proved in continuous time"
    assert "It follows that" in found["sentences"][-1]
    for row, condition in zip(found["rows"], data["verdict"]["conditions"], strict=True):
        assert row["holds"] is condition["holds"], row["name"]
        if row["margin"] is not None and not row["name"].startswith(("inverse.w", "the servo level")):
            assert row["margin"] == pytest.approx(condition["value"], rel=1e-9, abs=1e-12), row["name"]


def test_a_gain_that_breaks_a_condition_takes_the_proof_away() -> None:
    data, p = content("ur10_fast"), list(content("ur10_fast")["p"])
    slider = next(slider for slider in data["sliders"] if slider["label"] == "inverse.K_c")
    for k in range(slider["at"], slider["at"] + slider["size"]):
        p[k] *= 0.02
    (found,) = said(data, {"p": p, "moved": MOVED})
    assert found["state"] == "fails"
    assert "does not apply" in found["headline"]
    assert "M̄ ≥ 0" in found["sentences"][0]


@pytest.mark.parametrize(("factor", "state"), [(1.5, "proved"), (4.0, "undecided")])
def test_a_path_that_moved_numbers_take_out_of_reach_is_not_called_proved(factor: float, state: str) -> None:
    data = content("known_tracking_pi")
    slider = next(slider for slider in data["sliders"] if slider["label"] == "path.radius")
    p = list(data["p"])
    p[slider["at"]] *= factor
    (found,) = said(data, {"p": p, "moved": {**MOVED, "at": [slider["at"]]}})
    assert found["state"] == state


def test_a_margin_that_is_zero_holds_where_the_condition_is_not_strict() -> None:
    data = stated({"strict": True}, {"strict": False})
    strict, loose, none = said(data, margins(0.0, 1.0), margins(1.0, 0.0), margins(1.0, math.nan))
    assert (strict["state"], loose["state"], none["state"]) == ("fails", "proved", "fails")
    assert "condition 0" in strict["sentences"][0]
    assert "condition 1" in none["sentences"][0]


def test_the_least_of_several_margins_decides() -> None:
    found = said(stated({"size": 3}), margins(1.0, -1.0, math.nan), margins(1.0, -1.0, 2.0))
    assert [one["state"] for one in found] == ["fails", "fails"]


def test_what_was_decided_for_the_files_numbers_alone_is_open_elsewhere() -> None:
    data = stated({"at": None, "size": None}, {"at": 0})
    here, there = said(data, {**margins(1.0), "moved": FILE}, margins(1.0))
    assert here["state"] == "proved"
    assert there["state"] == "undecided"
    assert "condition 0" in there["sentences"][-1]
    assert "file's values only" in there["sentences"][-1]


def test_a_decision_at_the_files_numbers_remains_while_its_inputs_do() -> None:
    data, elsewhere = stated({"at": None, "size": None, "reads": [3, 4]}, {"at": 0}), {"p": True, "run": False}
    stays, goes = said(data, *({**margins(1.0), "moved": {**elsewhere, "at": at}} for at in ([2, 5], [2, 4])))
    assert (stays["state"], goes["state"]) == ("proved", "undecided")


def test_what_is_tacit_is_named_where_it_does_not_hold_and_nowhere_else() -> None:
    tacit = {"name": "toy: k - 3 is not zero", "how": "exact", "value": None, "holds": True, "size": 1, "strict": True}
    data = stated({}, tacit=[{**tacit, "at": 1, "opens": False}])
    opening = stated({}, tacit=[{**tacit, "at": 1, "opens": True}])
    holds, zero, here = said(data, margins(1.0, 1.0), margins(1.0, 0.0), {**margins(1.0, 0.0), "moved": FILE})
    assert (holds["state"], zero["state"], here["state"]) == ("proved", "fails", "proved")
    assert (len(holds["rows"]), len(zero["rows"])) == (1, 2)
    assert "All 1 conditions" in " ".join(holds["sentences"])
    assert "k - 3 is not zero" in zero["sentences"][0]
    (answered_otherwise,) = said(opening, margins(1.0, 0.0))
    assert answered_otherwise["state"] == "undecided"


def test_that_a_loop_stays_bounded_is_of_the_files_numbers_too() -> None:
    whole, part = (said(stated({}, bounded=bounded), margins(1.0))[0]["sentences"][-1] for bounded in (True, False))
    assert "the whole loop stays bounded was concluded for the file's values; for these it is not decided" in whole
    assert "bounded" not in part


def test_conclusions_are_of_the_files_numbers() -> None:
    here, moved, clock = said(stated({}), *({**margins(1.0), "moved": where} for where in (FILE, MOVED, CLOCK)))
    assert here["sentences"][-1] == "It follows that x goes to zero."
    assert "not decided" in moved["sentences"][-1]
    assert moved["headline"] == "Proved at these values in continuous time"
    assert "continuous time" in clock["sentences"][-1]


def test_a_loop_without_a_proof_gives_the_reason() -> None:
    reason = "inverse: a kinematic_command has no certificate"
    (found,) = said(stated(outcome="not_applicable", headline="not applicable", reason=reason), margins())
    assert found["state"] == "unproved"
    assert reason in found["sentences"][0]
    (refuted,) = said(stated(outcome="refuted", headline="refuted", reason="task: a sign"), margins())
    assert refuted["headline"].startswith("Refuted")


def test_samples_are_not_called_a_proof() -> None:
    (found,) = said(stated({"how": "sampled", "size": 0}), margins())
    assert "not proved" in found["sentences"][1]


def test_a_page_that_takes_any_margin_for_one_that_holds_would_be_noticed(tmp_path: Path) -> None:
    for script in WEB.glob("*.js"):
        (tmp_path / script.name).write_text(script.read_text("utf-8").replace("margin > 0", "!(margin < -9)"), "utf-8")
    (zero, none) = said(stated({}), margins(0.0), margins(math.nan), web=tmp_path)
    assert zero["state"] == none["state"] == "proved"  # which the tests above refuse
