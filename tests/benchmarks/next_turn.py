"""Bounds on the next turn against simulated turns of random robots.

``python -m tests.benchmarks.next_turn GRAPH --robots 1000 --seconds 63 [--set BLOCK.PARAM=VALUE]``

For each robot, the sampled law learns on the path for `seconds`, and then runs a turn with a constant estimate. The
servo's K_D is 0.8 to 1.25 times that of the graph, with 10 % between the joints; K_P and K_I over K_D are 0.8 to 1.2
times, viscous friction 0.5 to 1.5 and Coulomb friction 0.3 to 1.5 times that of the graph, joint by joint.
"""

from __future__ import annotations

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy: its threads wait in a loop

import numpy as np

import dmframe as dm
from dmframe.common.errors import DmframeError
from tests.framework.bounds.turns import Turns


def factors(rng: np.random.Generator, joints: int) -> dict[str, np.ndarray]:
    """True parameters of a robot, relative to those of the graph."""
    gain = rng.uniform(0.8, 1.25) * rng.uniform(0.9, 1.1, joints)
    ratios = [rng.uniform(0.8, 1.2, joints) for _ in range(2)]
    return {
        "servo.K_D": gain,
        "servo.K_P": gain * ratios[0],
        "servo.K_I": gain * ratios[1],
        "arm.viscous": rng.uniform(0.5, 1.5, joints),
        "arm.coulomb": rng.uniform(0.3, 1.5, joints),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("graph")
    parser.add_argument("--robots", type=int, default=100)
    parser.add_argument("--seconds", type=float, default=63.0)
    parser.add_argument("--turn", type=float, default=12.6)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--eta", type=float, default=None)
    parser.add_argument("--premise", action="store_true", help="compare eta with what both turns need")
    parser.add_argument("--set", action="append", default=[])
    given = parser.parse_args()
    graph = dm.load(given.graph)
    pairs = (text.split("=", 1) for text in given.set)
    if changed := {label: None if value == "null" else float(value) for label, value in pairs}:
        graph = graph.set(changed)
    assert graph.robot is not None
    turns, rng = Turns(graph, given.seconds), np.random.default_rng(given.seed)
    found, refused = list[tuple[float, float, float]](), 0
    for k in range(given.robots):
        turn = turns.of(factors(rng, graph.robot.n), given.turn)
        try:
            bound = turns.bound(turn, given.eta)
        except DmframeError as error:
            refused += 1
            print(f"{k}: {error}", flush=True)
            continue
        found.append((bound.bound.value, turn.largest, float(np.max(turns.premise(turn))) if given.premise else np.nan))
        if k % 25 == 24:
            report(found, refused)
    report(found, refused)


def report(found: list[tuple[float, float, float]], refused: int) -> None:
    """Print the bounds and how near the turns came to them."""
    bounds, errors, premises = np.array(found).T
    ratio = errors / bounds
    print(
        f"{len(found)} robots, {refused} without a bound: bound {1e3 * np.median(bounds):.3g} mm (median), "
        f"{1e3 * np.max(bounds):.3g} (largest); error {1e3 * np.median(errors):.3g} mm (median), "
        f"{1e3 * np.max(errors):.3g} (largest); error over bound {np.median(ratio):.3g} (median), "
        f"{np.max(ratio):.3g} (largest); eta that both turns need, over eta: {np.max(premises):.3g} (largest)",
        flush=True,
    )


if __name__ == "__main__":
    main()
