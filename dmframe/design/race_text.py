"""The race of a design as a file, which `dmframe race` reads."""

from __future__ import annotations

from typing import Any, Final

from dmframe.catalogue import find_twin
from dmframe.design.family import Block, Family
from dmframe.design.motion import Motion
from dmframe.graph.first import FirstGraph
from dmframe.identification.race_text import dumped, settings

TEMPLATE: Final = "design_joints"
FIRST: Final = "first.yaml"
"""File of the robot's first graph."""
ADAPTIVE: Final = "adaptive"
"""Name of the law of the first graph."""
CHANNEL: Final = "channel"
"""Name of the channel between controller and robot."""
LIMITS: Final = {"joints": "0.1 rad", "tool": "0.1 m"}
"""Error of a run above which it counts as diverged."""


def race_text(first: FirstGraph, family: Family, motion: Motion, clock: float) -> str:
    """The packaged race of designs with a robot, its plants, its paths and its sampling period.

    Parameters
    ----------
    clock
        Sampling period [s].
    """
    from ruamel.yaml import YAML

    graph: Block = YAML(typ="safe").load(first.text)
    data: Any = YAML().load(find_twin(TEMPLATE).read_text(encoding="utf-8"))
    data["robot"], data["start"], data["clocks"] = graph["robot"], {"q": motion.start}, [clock]
    data["plants"], data["paths"] = dict(family.plants), dict(motion.paths)
    data["error"], data["duration"] = motion.error, motion.seconds
    data["limit"] = LIMITS[motion.error]
    data["training"]["plants"] = list(family.training)
    data["realities"] = {CHANNEL: family.channel}
    entrant = data["laws"][data["entrant"]]
    # the rows of the coupled robot have no rotors, which the arm has, so that their proof would be refuted
    entrant["set"] = {**entrant["set"], "inverse.dynamics": "joints", **settings(clock, family.late)}
    Gamma = float(graph["blocks"]["dynamics"]["Gamma"])
    ranges = {
        "task.alpha_bar": [1, 10],
        "inverse.K_c": [0.3, 5],
        "dynamics.Gamma": [float(f"{factor * Gamma:.4g}") for factor in (0.03, 3)],
    }
    data["laws"][ADAPTIVE] = {"graph": FIRST, "tune": ranges}
    return dumped(data)
