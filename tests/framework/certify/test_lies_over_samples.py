"""False claims over samples: steps of one estimate that are stated twice, and losses of a block without storage."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import pytest
from test_samples import Carts, Learner, Smoother, States

from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.block.certificate import Certificate, DelayLine, Square
from dmframe.block.port import Input, State
from dmframe.certify import Verdict, verify
from dmframe.diagram import Diagram


class Twice(Learner):
    """States its steps a second time, before or after the first: unchanged, or with rows that it does not use."""

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
    assert found.refutation.statement == "learner: next value of theta"


def test_the_same_steps_twice_are_proved() -> None:
    assert verdict().outcome == "proved"


class Remembers(AbstractBlock):
    """f+ = y, stored in no V; its stated loss or gain is invented."""

    inputs = (Input("y", "2"),)
    states: States = (State("f", "2", sampled=True),)
    lost: float = 0.0
    gained: float = 0.0

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(next={"f": u.y})

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        return Certificate(
            delay_lines=(DelayLine("f", u.y),),
            dissipation=(Square(u.y, self.lost),) if self.lost else (),
            residual=(Square(u.y, self.gained),) if self.gained else (),
        )


@pytest.mark.parametrize(("lost", "gained"), [(7.0, 0.0), (0.0, 7.0), (7.0, 6.0)])
def test_a_block_that_stores_nothing_loses_and_gains_nothing(lost: float, gained: float) -> None:
    blocks = {"memory": Remembers(lost=lost, gained=gained), "learner": Learner(), "carts": Carts()}
    found = verify(Diagram.build(blocks), trials=1)
    assert found.outcome == "refuted"
    assert found.refutation is not None
    assert found.refutation.statement == "memory: V(next) - V"


def test_a_memory_alone_is_proved_and_a_stored_term_without_a_name_is_counted() -> None:
    assert verify(Diagram.build({"memory": Remembers(), "learner": Learner(), "carts": Carts()})).outcome == "proved"
    found = verify(Diagram.build({"smoother": Smoother(), "learner": Learner(), "carts": Carts()}))
    assert "smoother: storage of term 1 dropped" in {control.fault for control in found.controls}
