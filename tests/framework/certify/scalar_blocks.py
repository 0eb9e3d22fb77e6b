"""Loops of one block with scalar states, written in one line each, whose behaviour is known by inspection."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, ClassVar, final

from dmframe.block import AbstractBlock, Equations
from dmframe.block.certificate import Certificate
from dmframe.block.parameter import Positive, Scalar
from dmframe.block.port import TIME, Input, Output, Side, State
from dmframe.diagram import Diagram

Rates = Callable[[Any, Any, Any], Mapping[str, Any]]
"""A function of states, inputs and parameters."""


def scalar_loop(states: str, rates: Rates, claim: Callable[[Any, Any, Any], Certificate], **sources: Any) -> Diagram:
    """One block with these states, and sources ``{"r": a function of time}`` as its references."""

    @final
    class Toy(AbstractBlock):
        """Certificate as given by the arguments."""

        inputs = (TIME, *(Input(name) for name in sources))
        outputs = ()
        states: ClassVar[tuple[State, ...]]
        k: Scalar = Positive("", "", default=2.0)

        def equations(self, u: Any, x: Any, p: Any) -> Equations:
            return Equations(rates=rates(x, u, p))

        def certificate(self, u: Any, x: Any, p: Any, truth: Any) -> Certificate:
            return claim(x, u, p)

    Toy.states = tuple(State(name) for name in states.split())
    blocks: dict[str, AbstractBlock] = {"toy": Toy()}
    blocks |= {f"path_{name}": _source(name, function) for name, function in sources.items()}
    return Diagram.build(blocks)


def _source(name: str, function: Callable[[Any], Any]) -> AbstractBlock:
    @final
    class Path(AbstractBlock):
        """A function of time."""

        side = Side.SOURCE
        inputs = (TIME,)
        outputs = (Output(name),)

        def equations(self, u: Any, x: Any, p: Any) -> Equations:
            return Equations(outputs={name: function(u.t)})

    return Path()
