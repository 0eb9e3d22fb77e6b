"""Motions for the comparison of rows: two carts compared with their exact solution, and blocks with false rows."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from test_samples import B, Carts, Learner, M

from dmframe.block import Equations, Signals
from dmframe.block.certificate import Certificate, DelayLine
from dmframe.block.port import Access, Output, State
from dmframe.certify import Verdict, verify
from dmframe.certify.claim import claim_of
from dmframe.certify.driven import known_elements, with_nodes
from dmframe.certify.motions import Moved
from dmframe.diagram import Diagram

T = 0.005


def built(learner: Learner, carts: Carts | None = None) -> Diagram:
    return Diagram.build({"learner": learner, "carts": carts or Carts()})


def verdict(learner: Learner, carts: Carts | None = None) -> Verdict:
    return verify(built(learner, carts))


def test_a_motion_is_that_of_the_plant_with_its_commands_held() -> None:
    claim = claim_of(built(Learner()))
    (part,) = [part for part in claim.parts if part.certificate.steps]
    moved = Moved(claim, part, part.certificate.steps[0])
    assert [row.stored for row in moved.estimator_rows] == [False]
    motion = moved.motion(np.random.default_rng(3))
    left = moved.left(motion, T, 0.6)
    c, m, b = motion.commands(T * np.arange(120)).T, np.array(M), np.array(B)
    v, y, reported = np.zeros((121, 2)), np.zeros((121, 2)), np.zeros((120, 2))
    for k in range(120):
        fade, end = np.exp(-b / m * T), c[k] / b
        v[k + 1] = end + (v[k] - end) * fade
        y[k + 1] = y[k] + end * T + (v[k] - end) * (1 - fade) * m / b
        reported[k] = m * (v[k] - v[k - 1]) / T + b * (y[k] - y[k - 1]) / T if k else 0
    np.testing.assert_allclose(left.y[1:], c[:-1], atol=1e-15)
    np.testing.assert_allclose(left.predicted, reported, atol=1e-11)
    np.testing.assert_allclose(left.left, left.y - left.predicted, atol=1e-12)


def test_a_command_is_replaced_wherever_it_appears() -> None:
    x, y, free = (ca.SX.sym(name, 2) for name in ("x", "y", "free"))
    command = ca.sin(x) * y

    def replaced(expression: Any) -> Any:
        return with_nodes(ca.SX(expression), known_elements(command), free)

    for made, wanted in (
        (command, free),
        (ca.sin(x) * y, free),
        (x + 3 * command, x + 3 * free),
        (ca.vertcat(command[1], y[0]), ca.vertcat(free[1], y[0])),
        (ca.horzcat(x, command), ca.horzcat(x, free)),
        (ca.sin(x) + y, ca.sin(x) + y),
    ):
        function = ca.Function("left", [x, y, free], [replaced(made) - wanted])
        assert not np.any(function([0.3, 0.4], [1.1, 1.2], [2.1, 2.2]).full())


class Summing(Learner):
    """Stores the sum of its commands, and outputs the difference."""

    states = (*Learner.states, State("sum", "2", sampled=True))
    fault: float = 1.0

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        own = super().equations(u, x, p)
        total = x.sum + self._pushes(x)
        return replace(own, next={**own.next, "sum": total, "c_old": self.fault * (total - x.sum)})


def test_a_block_may_store_its_command_in_any_form() -> None:
    found = verdict(Summing())
    assert found.outcome == "proved", found.reason
    assert not found.rows_assumed
    assert "row 1, 0.5, 0.5, " in verdict(Summing(fault=2.0)).reason


class Shuffled(Learner):
    """Stores rows with the output of the other cart, and states the same."""

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        own = super().equations(u, x, p)
        rows = own.next["rows"]
        return replace(own, next={**own.next, "rows": ca.horzcat(rows[[0, 1, 2, 3, 5, 4], 0], rows[:, 1:])})

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        stated = super().certificate(u, x, p, truth)
        newest = stated.delay_lines[0].newest
        return replace(stated, delay_lines=(DelayLine("rows", newest[[0, 1, 2, 3, 5, 4]]),))


class Swapped(Learner):
    """States its true values in another order."""

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        stated = super().certificate(u, x, p, truth)
        return replace(stated, steps=(replace(stated.steps[0], true=stated.steps[0].true[[2, 3, 0, 1]]),))


@pytest.mark.parametrize(("learner", "reports"), [(Shuffled(), "stored row 1, "), (Swapped(), ": row 1, ")])
def test_what_is_stored_and_what_is_true_is_compared(learner: Learner, reports: str) -> None:
    found = verdict(learner)
    assert found.outcome == "not_applicable"
    assert "does not fall with the period: " in found.reason
    assert reports in found.reason


class Lavish(Learner):
    """Leaves its true values open."""

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        stated, free = super().certificate(u, x, p, truth), ca.SX.sym("free", 4)
        return replace(stated, steps=(replace(stated.steps[0], true=free),), unknown={"free": free})


class Bent(Learner):
    """Has the square of an unknown constant among its true values."""

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        stated, free = super().certificate(u, x, p, truth), ca.SX.sym("free")
        true = ca.vertcat(stated.steps[0].true[:3], free**2)
        return replace(stated, steps=(replace(stated.steps[0], true=true),), unknown={"free": free})


class Idle(Learner):
    """Does not estimate parameters of the second cart."""

    def _steps(self, u: Signals, x: Signals, p: Signals, true: Any) -> Any:
        steps, cart = super()._steps(u, x, p, true), ca.DM([1, 1, 0, 0])
        return replace(steps, rows=tuple((h * cart, y * cart[1:3]) for h, y in steps.rows))


class Direct(Carts):
    """Outputs the command as part of its measurement."""

    outputs = (*Carts.outputs, Output("extra", "2", access=Access.MEASURED))

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        own = super().equations(u, x, p)
        return replace(own, outputs={**own.outputs, "extra": u.c})


class Reading(Learner):
    """Reads that output."""

    inputs = (*Learner.inputs, replace(Learner.inputs[0], name="extra"))

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        own = super().equations(u, x, p)
        return replace(own, next={**own.next, "c_old": u.extra})


@pytest.mark.parametrize(
    ("learner", "carts", "why"),
    [
        (Lavish(), Carts(), "there are more unknown constants than outputs, and they could explain any rows"),
        (Bent(), Carts(), "what its rows leave is not affine in its unknown constants"),
        (Idle(), Carts(), "a row is zero along all motions"),
        (Reading(), Direct(), "what is measured holds a command of the same instant"),
    ],
)
def test_what_is_not_compared_is_assumed_and_the_headline_states_it(learner: Learner, carts: Carts, why: str) -> None:
    found = verdict(learner, carts)
    assert found.rows_assumed
    assert found.headline.endswith("; that its rows follow from the plant is assumed")
    assert any(item.text.endswith(f"; not checked: {why}") for item in found.assumptions)
