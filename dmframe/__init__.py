"""Dynamic modularity for robots whose joint servo is closed.

A controller is a graph of typed blocks in a short YAML file. A block states its equations once, together with its
storage function; from that single statement come the simulation, the C code and the exact certificate of stability.

>>> import dmframe as dm
>>> g = dm.load("pendulum").set(duration="2 s")
>>> g.run().plot()                          # doctest: +SKIP
>>> print(g.verify().headline)
proved

These names are the public interface; modules that define blocks import `dmframe.block` too. Every other module is
internal. The framework contains no block and no robot: packages register them under the entry-point groups
``dmframe.blocks`` and ``dmframe.robots``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from dmframe.common.former import accept_former_paths

if TYPE_CHECKING:
    from dmframe.analysis.delay import fitted_delay
    from dmframe.common.errors import DmframeError
    from dmframe.graph.graph import Graph
    from dmframe.graph.load import load
    from dmframe.graph.registries import blocks, graphs, robots
    from dmframe.graph.runs import Runs, compare
    from dmframe.graph.shortcuts import analyse, draw, run, verify
    from dmframe.graph.sweep import sweep
    from dmframe.identification.experiment import experiment
    from dmframe.identification.identify import identify
    from dmframe.results.run import Run
    from dmframe.study.read import load_study
    from dmframe.study.tune import tune

    __version__: str

_HOMES: Final = {
    "DmframeError": "common.errors",
    "Graph": "graph.graph",
    "Run": "results.run",
    "Runs": "graph.runs",
    "analyse": "graph.shortcuts",
    "blocks": "graph.registries",
    "compare": "graph.runs",
    "draw": "graph.shortcuts",
    "experiment": "identification.experiment",
    "fitted_delay": "analysis.delay",
    "graphs": "graph.registries",
    "identify": "identification.identify",
    "load": "graph.load",
    "load_study": "study.read",
    "robots": "graph.registries",
    "run": "graph.shortcuts",
    "sweep": "graph.sweep",
    "tune": "study.tune",
    "verify": "graph.shortcuts",
}
"""The module of each name. A module is imported when its name is first used, since some imports take a second."""

__all__ = [
    "DmframeError",
    "Graph",
    "Run",
    "Runs",
    "__version__",
    "analyse",
    "blocks",
    "compare",
    "draw",
    "experiment",
    "fitted_delay",
    "graphs",
    "identify",
    "load",
    "load_study",
    "robots",
    "run",
    "sweep",
    "tune",
    "verify",
]


accept_former_paths()


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from dmframe.common.version import version

        return version()
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return list(__all__)
