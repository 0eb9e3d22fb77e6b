"""The discrete-time step that a block states in addition to its rate: used by runs, absent in continuous time."""

from __future__ import annotations

from typing import Any, ClassVar, final

import numpy as np
import pytest

from dmframe.block import AbstractBlock, Equations
from dmframe.block.certificate import Certificate, Square
from dmframe.block.port import Output, Side, State
from dmframe.certify import verify
from dmframe.common.errors import DmframeError
from dmframe.diagram import Diagram
from dmframe.simulate import simulate


def falling(second: bool = True, side: Side = Side.CONTROLLER, sampled: bool = False, name: str = "x") -> Diagram:
    """x' = -x^3, with the second term of its series."""

    @final
    class Falling(AbstractBlock):
        """Step as given by the arguments."""

        outputs = (Output("seen"),)
        states: ClassVar[tuple[State, ...]]

        def equations(self, u: Any, x: Any, p: Any) -> Equations:
            moves = {"next": {"x": x.x}} if sampled else {"rates": {"x": -(x.x**3)}}
            return Equations({"seen": x.x}, **moves, second={name: 1.5 * x.x**5} if second else {})

        def certificate(self, u: Any, x: Any, p: Any, truth: Any) -> Certificate:
            return Certificate(storage=(Square(x.x),), dissipation=(Square(x.x**2),))

    Falling.side = side
    Falling.states = (State("x", sampled=sampled),)
    return Diagram.build({"falling": Falling()})


def test_a_step_on_a_clock_takes_the_second_term_and_the_proof_stays_as_it_is() -> None:
    T, found = 0.1, dict[bool, np.ndarray]()
    for second in (False, True):
        run = simulate(falling(second), 1.0, clock=T, start={"x": 1.0})
        found[second] = run.states["falling.x"].ravel()
        x = [1.0]
        for _ in range(10):
            x.append(x[-1] - T * x[-1] ** 3 + second * T**2 * 1.5 * x[-1] ** 5)
        np.testing.assert_allclose(found[second], x, rtol=1e-14)
    exact = 1 / np.sqrt(1 + 2 * T * np.arange(11))
    assert np.max(np.abs(found[True] - exact)) < np.max(np.abs(found[False] - exact)) / 5
    assert verify(falling()).outcome == "proved"
    assert falling(True).fingerprint != falling(False).fingerprint  # a run uses another map


@pytest.mark.parametrize("wrong", [{"side": Side.PLANT}, {"sampled": True}, {"name": "y"}])
def test_what_takes_no_such_step_is_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(DmframeError, match=r"equations state the second term of ., which has no step on a clock"):
        falling(**wrong)
