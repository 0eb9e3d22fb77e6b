"""Joint paths for tuning and comparison: from rest, within limits, repeating and never repeating."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, final

import numpy as np

from dmframe.design.family import Block, rounded
from dmframe.graph.first import FirstGraph

TRAINING: Final = "repeating"
NEVER: Final = "wander"
AGAIN: Final = "cycle"
ACCELERATION: Final = 0.7
"""Largest acceleration of a joint, a half of what the channel of a UR admits [rad/s^2]."""
SLOWER: Final = 0.7
"""Fundamental frequency of the training path relative to the slowest joint of the first graph."""
FASTER: Final = 1.3
"""That of the repeating held-out path."""
HARMONICS: Final = 3


@final
@dataclass(frozen=True)
class Motion:
    """Paths as sections of a race file, and where they start [rad, m]."""

    paths: Mapping[str, Block]
    start: list[float]


def motion_of(first: FirstGraph) -> Motion:
    """Paths about the centre of the first graph's path, with its amplitudes.

    Each joint starts at rest at an end of its range: a path that starts with a velocity requires an infinite
    acceleration.
    """
    from ruamel.yaml import YAML

    path = YAML(typ="safe").load(first.text)["blocks"]["path"]
    center, amplitude, rate = (np.array(path[key], dtype=float) for key in ("center", "amplitude", "rate"))
    fastest = np.sqrt(ACCELERATION / np.maximum(amplitude, 1e-9))
    slower = min(1.0, float(np.min(fastest / np.maximum(rate, 1e-9))))
    phase = np.where(np.arange(center.size) % 2, -1.0, 1.0) * np.pi / 2
    base = float(f"{SLOWER * slower * rate.min():.3g}")
    again = float(f"{FASTER * base:.3g}")
    multiples = 1 + np.arange(center.size) % HARMONICS
    multiples = np.minimum(multiples, np.maximum(1, np.floor(fastest / base)))
    phase = np.array(rounded(phase))

    def moving(rates: Any, **more: float) -> Block:
        found = {"center": center, "amplitude": amplitude, "rate": rates, "phase": phase}
        return {"type": "sinusoid", **{key: rounded(value) for key, value in found.items()}, **more}

    paths = {
        TRAINING: moving(base * multiples, repeats=base),
        AGAIN: moving(np.full(center.size, again), repeats=again),
        NEVER: moving(slower * rate),
    }
    return Motion(paths, rounded(center + amplitude * np.sin(phase)))
