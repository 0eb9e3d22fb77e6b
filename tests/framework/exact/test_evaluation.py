"""Recomputation after a change equals a full evaluation, number by number."""

from __future__ import annotations

import random
from collections.abc import Callable

import casadi as ca
import pytest

from dmframe.exact import Evaluation, Tape, Trial, ZeroDivision, random_prime


def tape_of(expression: Callable[..., ca.SX], *sizes: int) -> Tape:
    symbols = [ca.SX.sym(f"x{k}", size) for k, size in enumerate(sizes)]
    return Tape.from_function(ca.Function("f", symbols, [ca.densify(ca.vertcat(expression(*symbols)))]))


EXPRESSIONS: dict[str, Callable[..., ca.SX]] = {
    "field": lambda a, b, c: ca.vertcat(a[0] * b[1] - c[2] / (1 + a[1] ** 2), ca.sum1(b) ** 3, c[0] ** -2, -2 * a),
    "functions": lambda a, b, c: ca.vertcat(ca.sin(a) * ca.cos(b), ca.tanh(a * c), ca.fmin(b, c), ca.atan2(a[0], c[1])),
    "signs": lambda a, b, c: ca.vertcat(ca.sign(a[0]) * b, ca.fabs(c - a), ca.sign(b[0] * c[0]) + ca.sin(a)),
}


def trial_and_point(seed: int) -> tuple[Trial, list[list[int]]]:
    rng = random.Random(seed)
    trial = Trial(random_prime(rng), rng)
    return trial, [[trial.random() for _ in range(3)] for _ in range(3)]


@pytest.mark.parametrize("name", EXPRESSIONS)
@pytest.mark.parametrize("moved", [(0,), (1,), (2,), (0, 2), (0, 1, 2)])
def test_after_a_change_it_is_what_a_full_evaluation_gives(name: str, moved: tuple[int, ...]) -> None:
    tape, found = tape_of(EXPRESSIONS[name], 3, 3, 3), []
    for again in (True, False):
        trial, point = trial_and_point(5)
        first = Evaluation(tape, point, trial, range(3)).outputs if not again else tape.evaluate(point, trial)
        others = {k: [trial.random() for _ in range(3)] for k in moved}
        if again:
            found.append((first, tape.evaluate([others.get(k, own) for k, own in enumerate(point)], trial)))
        else:
            evaluation = Evaluation(tape, point, trial, range(3))
            found.append((first, tape.outputs_of(evaluation.changed(others), trial)))
            assert evaluation.outputs == first  # which is unchanged
    assert found[0] == found[1]
    assert found[0][0] != found[0][1]


def test_every_choice_of_signs_is_what_a_full_evaluation_gives() -> None:
    tape = tape_of(EXPRESSIONS["signs"], 3, 3, 3)
    (trial, point), (other, _) = trial_and_point(3), trial_and_point(3)
    evaluation, choices = Evaluation(tape, point, trial), 0
    other_point = trial_and_point(3)[1]
    assert evaluation.outputs == tape.evaluate(other_point, other)
    while trial.next_signs():
        assert other.next_signs()
        evaluation.recompute_signs()
        assert evaluation.outputs == tape.evaluate(point, other)
        choices += 1
    assert not other.next_signs()
    assert choices > 8


def test_only_what_depends_on_a_change_is_computed(monkeypatch: pytest.MonkeyPatch) -> None:
    tape, counts = tape_of(EXPRESSIONS["field"], 3, 3, 3), list[int]()
    honest = Tape.compute

    def counted(self: Tape, places: object, *rest: object) -> None:
        held = list(places)  # type: ignore[call-overload]
        counts.append(len(held))
        honest(self, held, *rest)  # type: ignore[arg-type]

    monkeypatch.setattr(Tape, "compute", counted)
    trial, point = trial_and_point(1)
    evaluation = Evaluation(tape, point, trial, (2,))
    evaluation.changed({2: [1, 2, 3]})
    assert counts[0] == len(tape)
    assert 0 < counts[1] < len(tape) / 2


def test_a_denominator_that_vanishes_after_a_change_is_seen() -> None:
    tape = tape_of(lambda a, b: a / b, 1, 1)
    trial, _ = trial_and_point(2)
    evaluation = Evaluation(tape, [[3], [4]], trial, (1,))
    with pytest.raises(ZeroDivision):
        evaluation.changed({1: [0]})
