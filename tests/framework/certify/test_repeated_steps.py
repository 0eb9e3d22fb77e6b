"""A block that states steps of one estimate twice: both are checked, and neither stands for the other."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import pytest
from test_samples import Carts, Learner

from dmframe.block import Signals
from dmframe.certificate import Certificate
from dmframe.certify import Verdict, verify
from dmframe.diagram import Diagram


class Twice(Learner):
    """States its steps a second time, before or after the first: as they are, or of rows that it never learns from."""

    lies: bool = False
    before: bool = False

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        own = Learner.certificate(self, u, x, p, truth)
        (steps,) = own.steps
        seven = 7 * ca.DM.ones(4)
        more = replace(steps, true=seven, rows=((ca.DM.ones(4), 2 * seven[:2]),)) if self.lies else steps
        return replace(own, steps=(more, steps) if self.before else (steps, more))


def verdict(**options: Any) -> Verdict:
    return verify(Diagram.build({"learner": Twice(**options), "carts": Carts()}))


@pytest.mark.parametrize("before", [True, False])
def test_steps_that_are_never_taken_are_refuted(before: bool) -> None:
    found = verdict(lies=True, before=before)
    assert found.outcome == "refuted"
    assert found.refutation is not None
    assert found.refutation.says == "learner: what theta becomes"


def test_the_same_steps_twice_are_proved() -> None:
    assert verdict().outcome == "proved"
