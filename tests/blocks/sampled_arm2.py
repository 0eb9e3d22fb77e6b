"""Two links with the sampled law at 40 ms: a graph that is proved quickly."""

from __future__ import annotations

from typing import Any


def sampled_arm2(**inverse: Any) -> dict[str, Any]:
    """The graph as data, with other parameters of its inverse."""
    return {
        "dmframe": 1,
        "robot": "arm2",
        "clock": "40 ms",
        "duration": "4 s",
        "start": {"q": [0.5, 0.9]},
        "blocks": {
            "path": {"type": "circle", "center": [0.6, 0.2], "radius": 0.1, "rate": "0.5 rad/s"},
            "task": {"type": "sampled_tracking", "gamma": 1},
            "inverse": {"type": "sampled_inverse", "w_0": 0.02, **inverse},
            "servo": {"type": "pid_servo", "K_D": [60, 30], "K_P": [120, 60], "K_I": [40, 20]},
            "arm": {"type": "manipulator", "viscous": [1, 0.5], "coulomb": [0.5, 0.2]},
        },
        "wires": {},
    }
