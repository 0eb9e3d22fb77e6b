"""A search over the box of a graph for the robot with the largest error: none exceeds the printed bound."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dmframe as dm
from dmframe.block.model import SYMBOLIC
from dmframe.bounds import error_bounds
from dmframe.certify import verify

TUNED = {"inverse.Lambda_I": 100, "inverse.w_I": 2.2}
LEAK = {"inverse.K_c": 2.0, "model.bias": True, "dynamics.a_d_hat_box": None}
UNTIL = 60.0
TORQUE = 5.0
PUSH = '''
from dmframe.block import TIME, AbstractBlock, Equations, Output, Real, Side, Vector
import casadi as ca

class Push(AbstractBlock):
    """A torque on the joints that changes its sign with a period."""

    side = Side.PLANT
    inputs = (TIME,)
    outputs = (Output("tau_ext", "n", "N m"),)
    torque: Vector = Real("n", "N m")
    rate: Vector = Real("n", "rad/s")

    def equations(self, u, x, p):
        return Equations({"tau_ext": p.torque * ca.sign(ca.sin(p.rate * u.t))})
'''
LOW = np.array([0.8, 1.76, 1.76, 1.76, 1, 1, *np.log([0.05] * 3), 0])
HIGH = np.array([1.25, 2.64, 2.64, 2.64, 1.5, 1.5, *np.log([7.0] * 3), 5])
"""Ends of what is varied: servo gain, ratio of each joint, friction twice, logarithms of the torques' rates, load."""


@cache
def bound(name: str, D: float, more: tuple[tuple[str, Any], ...]) -> dict[str, float]:
    """The bounds on the joint error, by kind."""
    graph = dm.load(name).set(dict(more))
    with SYMBOLIC:
        verdict = verify(graph.diagram, uncertain=graph.intervals(), start=graph.start, trials=1)
        found = error_bounds(verdict, uncertain=graph.intervals(), start=graph.start, over=UNTIL, disturbance=D).found
    return {item.kind: item.value for item in found if item.unit == "rad"}


def pushed(name: str, folder: Path, more: Mapping[str, Any]) -> dm.Graph:
    """The packaged graph with a torque at each joint, in continuous time as the bound."""
    (folder / "push.py").write_text(PUSH)
    text = Path(dm.load(name).document.name).read_text()
    push = "  push:     {type: push.py:Push, torque: [0, 0, 0], rate: [1, 1, 1]}\nbaseline:"
    (folder / "pushed.yaml").write_text(text.replace("baseline:", push))
    return dm.load(folder / "pushed.yaml", trust=True).set({**more, "clock": "continuous"})


def errors(graph: dm.Graph, parts: np.ndarray, D: float) -> tuple[np.ndarray, np.ndarray]:
    """Root mean square and largest value of the joint error of the robots at these parts of the intervals."""
    s, r, viscous, coulomb, rate, load = np.split(LOW + (HIGH - LOW) * parts, [1, 4, 5, 6, 9], axis=1)
    stiff = s * np.array([800, 800, 400])
    values = {
        "servo.K_P": stiff,
        "servo.K_I": r * stiff,
        "arm.viscous": viscous * np.array([5, 5, 2]),
        "arm.coulomb": coulomb * np.array([8, 8, 4]),
        "push.rate": np.exp(rate),
        "push.torque": D * np.ones_like(rate),
        **({"load.mass": load} if "load" in graph.blocks else {}),
    }
    data = dm.sweep(graph, {key: value.tolist() for key, value in values.items()}, until=UNTIL, design="list")
    assert not data["diverged"].values.any()
    squares = [data[f"rms_{k}"].values ** 2 for k in range(1, 9)]
    return np.sqrt(np.mean(squares, axis=0)), data["error_most"].values


def search(graph: dm.Graph, runs: int, D: float) -> tuple[float, float]:
    """The largest of both errors over a fifth of the runs, half at corners, then near the worst ones so far."""
    rng, size = np.random.default_rng(runs), len(LOW)
    fifth = runs // 5
    corners = rng.random((fifth, 1)) < 0.5
    parts = np.where(corners, rng.integers(0, 2, (fifth, size)), rng.random((fifth, size)))
    mean, most = errors(graph, parts, D)
    for step in (0.3, 0.15, 0.08, 0.04):
        worst = parts[np.argsort(-mean)[: max(fifth // 20, 1)]]
        near = worst[rng.integers(0, len(worst), fifth)] + step * rng.normal(size=(fifth, size))
        more = errors(graph, np.clip(near, 0, 1), D)
        parts, mean, most = np.vstack([parts, np.clip(near, 0, 1)]), np.append(mean, more[0]), np.append(most, more[1])
    return float(np.max(mean)), float(np.max(most))


@pytest.mark.parametrize("D", [0.0, TORQUE])
@pytest.mark.parametrize(
    ("name", "runs", "more", "within"),
    [
        ("joint_tracking_pi", 40, TUNED, 10),
        ("joint_tracking_pi", 2000, TUNED, 10),
        ("joint_tracking_bounded", 400, {}, 10),
        ("joint_tracking_bounded", 100, LEAK, 50),
    ],
    ids=["short", "2000", "loaded", "leak"],
)
def test_no_robot_exceeds_the_bound_and_the_worst_is_near_it(
    name: str, runs: int, more: Mapping[str, Any], within: float, D: float, tmp_path: Path
) -> None:
    """The packaged `joint_tracking_pi` starts with a w_I that dominates its bound; the others are near."""
    limit = bound(name, D, tuple(more.items()))
    mean, most = search(pushed(name, tmp_path, more), runs, D)
    assert mean < limit["rms"]
    assert most < limit["sup"]
    assert limit["rms"] < within * mean
