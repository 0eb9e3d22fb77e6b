"""A source that states a signal and its derivative: compared with each other, and one independent variable."""

from __future__ import annotations

from typing import final

import casadi as ca
import pytest

from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.block.certificate import Certificate, Square
from dmframe.block.port import TIME, Input, Output, Side, State
from dmframe.certify import verify
from dmframe.common.errors import DerivativeError
from dmframe.diagram import Diagram


@final
class Both(AbstractBlock):
    """A path and its derivative."""

    side = Side.SOURCE
    inputs = (TIME,)
    outputs = (Output("r", ""), Output("dr", "", "1/s", derivative_of="r"))
    factor: int = 1

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"r": ca.sin(u.t) ** 2, "dr": self.factor * 2 * ca.cos(u.t) * ca.sin(u.t)})


@final
class Track(AbstractBlock):
    """Tracks it."""

    inputs = (Input("r", ""), Input("dr", "", "1/s", derivative_of="r"))
    states = (State("x", ""),)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(rates={"x": u.dr - (x.x - u.r)})

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        return Certificate(storage=(Square(x.x - u.r),), dissipation=(Square(x.x - u.r),))


@final
class Two(AbstractBlock):
    """A path, and another signal with the name of its derivative."""

    side = Side.SOURCE
    inputs = (TIME,)
    outputs = (Output("r", ""), Output("dr", "", "1/s"))

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"r": ca.sin(u.t), "dr": 2 + ca.cos(u.t)})


@final
class Reader(AbstractBlock):
    """Reads both."""

    inputs = (Input("r", ""), Input("rate", "", "1/s", derivative_of="r"), Input("dr", "", "1/s"))
    states = (State("q", ""),)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(rates={"q": u.dr - u.rate})


def test_a_stated_derivative_is_the_derivative():
    diagram = Diagram.build({"path": Both(), "track": Track()})
    assert [leaf.name for leaf in diagram.loop.trajectories] == ["path.r", "path.dr"]
    assert verify(diagram).outcome == "proved"


def test_a_stated_derivative_that_is_another_signal_is_refused():
    with pytest.raises(DerivativeError, match=r"path\.dr: expected the time derivative of path\.r"):
        Diagram.build({"path": Both(factor=2), "track": Track()})


def test_leaves_have_names_of_their_own():
    diagram = Diagram.build({"path": Two(), "reader": Reader()})
    names = [leaf.name for leaf in diagram.loop.trajectories]
    assert sorted(names) == ["path.d(r)/dt", "path.dr", "path.r"]
