"""Simulation of a diagram."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from dmframe.simulate.bounds import Divergence
    from dmframe.simulate.keep import Log
    from dmframe.simulate.many import simulate_many
    from dmframe.simulate.recording import Recording
    from dmframe.simulate.run import simulate
    from dmframe.simulate.solver import Solver
    from dmframe.simulate.start import start_state

_HOMES: Final = {
    "Divergence": "bounds",
    "Log": "keep",
    "Recording": "recording",
    "Solver": "solver",
    "simulate": "run",
    "simulate_many": "many",
    "start_state": "start",
}
"""The module of each name, imported when its name is first used: a graph is read without the simulation."""

__all__ = ["Divergence", "Log", "Recording", "Solver", "simulate", "simulate_many", "start_state"]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
