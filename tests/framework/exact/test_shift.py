"""Differences along shifts: bounded functions keep their values, each output is that of the whole tape."""

from __future__ import annotations

import random

import casadi as ca
import pytest

from dmframe.exact import Tape, random_prime
from dmframe.exact.shift import Shift, ShiftTrial


@pytest.fixture
def trial() -> ShiftTrial:
    rng = random.Random(1)
    return ShiftTrial(random_prime(rng), rng)


def test_a_bounded_function_hides_a_shift(trial: ShiftTrial) -> None:
    p, x, y = trial.prime, ca.SX.sym("x"), ca.SX.sym("y")
    bounded = ca.vertcat(ca.sin(x), ca.cos(x * y), ca.tanh(x) * y, ca.sign(x), ca.fmin(ca.cos(x), y))
    moving = ca.vertcat(3 * x + ca.sin(x), x * y, x * ca.sin(x), x * ca.sign(x), ca.fabs(x), ca.exp(x), x / y)
    tape = Tape.from_function(ca.Function("f", [x, y], [bounded, moving]))
    (at, of), u = (trial.random() for _ in range(2)), trial.random()
    shift = Shift(tape, [[at], [of]], trial, [0])
    (hidden,), (seen,) = (shift.differences([k], [[[(at + u) % p], [of]]]) for k in (0, 1))
    assert hidden == [0] * 5
    assert seen[:2] == [3 * u % p, u * of % p]
    assert seen[2] == u * trial.cos_sin(at)[1] % p
    assert all(seen)


def test_requested_outputs_are_those_of_all_outputs(trial: ShiftTrial) -> None:
    p, x = trial.prime, ca.SX.sym("x", 3)
    outputs = [x[0] * x[1], x[1] + x[2] * x[0], ca.vertcat(x[2], 0, x[0] - x[2])]
    tape = Tape.from_function(ca.Function("f", [*ca.vertsplit(x)], outputs))
    point = [[trial.random()] for _ in range(3)]
    moved = [[[(a + trial.random()) % p] for (a,) in point] for _ in range(2)]
    shift = Shift(tape, point, trial, range(3))
    whole = shift.differences([0, 1, 2], moved)
    (a,), (b,), (c,) = point
    for ((d,), (e,), (f,)), row in zip(moved, whole, strict=True):
        assert row == [x % p for x in (d * e - a * b, e + f * d - b - c * a, f - c, 0, d - f - a + c)]
    assert [row[2:] for row in whole] == shift.differences([2], moved)
    assert shift.values([1]) == [(b + c * a) % p]
