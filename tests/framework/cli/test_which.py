"""``dmframe which``: the graph for five answers, from options or from a terminal."""

from __future__ import annotations

import io
import itertools
import json
import sys
from typing import Any

import pytest

from dmframe.cli import which as command
from dmframe.graph.which import Guide, guide

STIFF = ("--servo", "stiff", "--period", "8 ms", "--path", "varies", "--load", "constant", "--known", "lengths")


@pytest.fixture(scope="module")
def found() -> Guide:
    return guide()


def every(found: Guide) -> list[dict[str, str]]:
    """All combinations of answers, with periods on both sides of the boundary."""
    choices = [list(item.choices) or ["1 ms", "12 ms", "13 ms", "0.2 s"] for item in found.questions.values()]
    return [dict(zip(found.questions, answers, strict=True)) for answers in itertools.product(*choices)]


def test_a_stiff_servo_with_feed_forward_needs_no_adaptation(dmframe: Any) -> None:
    reported = dmframe("which", *STIFF)
    assert reported.status == 0
    assert reported.out.startswith("take ur10_fast_inverse_tuned, a law without adaptation\n  no adaptation is needed")
    assert "dmframe new ur10_fast_inverse_tuned mine.yaml" in reported.out


def test_json_holds_the_answers_the_graph_and_its_errors_in_mm(dmframe: Any, found: Guide) -> None:
    data = json.loads(dmframe("which", *STIFF, "--json").out)
    assert data["take"] == "ur10_fast_inverse_tuned"
    assert data["adaptation"] is False
    assert data["answers"] == {
        key.removeprefix("--"): value for key, value in zip(STIFF[::2], STIFF[1::2], strict=True)
    }
    error = found.errors["ur10_fast_inverse_tuned", "fast circle, stiff cascade"]
    assert error is not None
    assert data["error"]["ideal"] == pytest.approx(1e3 * error)
    assert [other["graph"] for other in data["others"]] == ["ur10_fast_best", "known_tracking_p_pi"]


def test_an_answer_says_what_holds_for_another_robot_and_how_to_go_on_with_it(dmframe: Any, found: Guide) -> None:
    out = dmframe("which", *STIFF).out
    assert "for another robot: the kind of law follows from your answers" in out
    assert "dmframe design ROBOT --period '8 ms' --out DIR" in out
    for answers in every(found):
        commands = found.select(answers).summary["elsewhere"]
        assert any(command.startswith("dmframe design") for command in commands) != (answers["servo"] == "torque")


def test_a_period_other_than_the_graphs_is_set(dmframe: Any) -> None:
    words = [*STIFF]
    words[3] = "20 ms"
    assert "dmframe run mine.yaml --set clock='20 ms'" in dmframe("which", *words).out


def test_without_a_terminal_missing_answers_are_listed(dmframe: Any) -> None:
    reported = dmframe("which", *STIFF[:4])
    assert reported.status == 2
    assert "no terminal to ask; give --path, --load, --known, for example: dmframe which --servo stiff" in reported.err


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("--servo", "stif"), "--servo stif: unknown answer; did you mean stiff?"),
        (("--period", "8 kg"), "--period 8 kg: expected a quantity in s"),
        (("--period", "8"), "--period 8: 8 s, expected 50 µs to 500 ms; for 8 ms write `8 ms`"),
        (("--period", "-8 ms"), "--period -8 ms: expected a time above zero"),
    ],
)
def test_a_wrong_answer_is_refused(dmframe: Any, words: tuple[str, str], text: str) -> None:
    reported = dmframe("which", *STIFF, *words)
    assert reported.status == 2
    assert text in reported.err


def test_on_a_terminal_it_prompts_for_what_no_option_answers(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    # a number; a wrong one and the default; a name
    monkeypatch.setattr(sys, "stdin", Terminal("2\n9\n\ndelay\n"))
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    command.which(servo="soft", period="90 ms", known=None, path=None, load=None, as_json=True)
    reported = capsys.readouterr()
    assert "--load 9: unknown answer" in reported.err
    answers = json.loads(reported.out)["answers"]
    assert (answers["path"], answers["load"], answers["known"]) == ("varies", "constant", "delay")


def test_each_rule_answers_some_combination_and_each_graph_has_facts(found: Guide) -> None:
    used = {id(found.rule_for(answers)) for answers in every(found)}
    assert [rule.because for rule in found.rules if id(rule) not in used] == []
    for answers in every(found):
        selection = found.select(answers)
        assert {selection.take.graph, *(other.graph for other in selection.others)} <= set(found.facts)


def test_conditions_and_alternatives_have_no_unknown_keys(found: Guide) -> None:
    conditions = [rule.when for rule in found.rules]
    for rule in found.rules:
        for other in rule.others:
            assert set(other) <= {"take", "if", "when"}
            assert isinstance(other["if"], str)
            conditions.append(other.get("when", {}))
    for when in conditions:
        for key, values in when.items():
            assert set(values) <= set(found.questions[key].choices or ("short", "long")), (key, values)


def test_a_law_without_adaptation_estimates_nothing(found: Guide) -> None:
    for rule in found.rules:
        estimated = {found.facts[graph]["learnt"] != "none" for _, graph in rule.graphs()}
        assert estimated == {rule.adaptation}, rule.because


def test_what_a_reason_compares_with_the_inverse_of_j_is_true_of_the_errors(found: Guide) -> None:
    compared = 0
    for answers in every(found):
        selection = found.select(answers)
        if "a smaller error than the inverse of J" in selection.rule.because:
            kind = found.period_class(answers["period"])
            inverse = found.taken(
                {"short": "ur10_fast_inverse_tuned", "long": "ur10_slow_inverse_tuned"}[kind], "soft", kind
            )
            assert selection.take.ideal is not None
            assert selection.take.ur is not None
            assert inverse.ideal is not None
            assert inverse.ur is not None
            assert selection.take.ideal < inverse.ideal
            assert selection.take.ur < inverse.ur
            compared += 1
    assert compared > 0


def test_each_option_lists_all_answers(found: Guide) -> None:
    from typer.main import get_command

    from dmframe.cli.app import app

    group = get_command(app)
    options = {each.name: each for each in group.commands["which"].params}  # type: ignore[attr-defined]
    for key, question in found.questions.items():
        assert all(name in options[key].help for name in question.choices), key
