"""Blocks of a user, with correct and wrong units, alone in a diagram."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from dmframe.block import AbstractBlock, Equations
from dmframe.block.parameter import Diagonal, Positive
from dmframe.block.port import TIME, Output, State
from dmframe.diagram import Diagram

UNITS: Mapping[str, str] = {"K": "N m/rad", "D": "N m s/rad", "I": "kg m^2", "w": "1/s"}
STATES = (State("q", "n", "rad"), State("dq", "n", "rad/s"))


def joint(
    rates: Callable[[Any, Any, Any], Mapping[str, Any]] | None = None,
    output: Callable[[Any, Any], Any] | None = None,
    certificate: Callable[[Any, Any, Any], Any] | None = None,
    start: Callable[[Any], Mapping[str, Any]] | None = None,
    conditions: Callable[[Any], Any] | None = None,
    **units: str,
) -> Diagram:
    """Joints with springs and dampers, K q + D dq + I ddq = 0, with a torque; other equations and units as given."""
    own = {**UNITS, **units}
    numbers = {name: Positive("n", unit, default=1.0) for name, unit in own.items()}
    stated = rates or (lambda u, x, p: {"q": x.dq, "dq": -(p.K * x.q + p.D * x.dq) / p.I})
    shown = output or (lambda x, p: p.K * x.q + p.D * x.dq)
    members: dict[str, Any] = {
        "__doc__": "Joints on springs.",
        "__module__": __name__,
        "__annotations__": dict.fromkeys(numbers, Diagonal),
        **numbers,
        "inputs": (TIME,),
        "outputs": (Output("tau", "n", "N m"),),
        "states": STATES,
        "equations": lambda self, u, x, p: Equations({"tau": shown(x, p)}, stated(u, x, p)),
    }
    if certificate is not None:
        members["certificate"] = lambda self, u, x, p, truth: certificate(u, x, p)
    if start is not None:
        members["start"] = lambda self, u, p, truth: start(p)
    if conditions is not None:
        members["conditions"] = lambda self, p, truth: conditions(p)
    block = type(AbstractBlock)("Joint", (AbstractBlock,), members)
    return Diagram.build({"joint": block(K=(1.0, 2.0))})


def faults(diagram: Diagram) -> list[str]:
    """The messages about inconsistent units."""
    return [fault.text for fault in diagram.unit_faults]
