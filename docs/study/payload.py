"""Effect of a reset on a load's estimate, for ``docs/how_to/payload.md``: ``python docs/study/payload.py``.

For each law: the errors of the mass about 10 s and 30 s after 4 kg have become 1 kg, and the tool error;
then the largest error in the second cycle of picking up and releasing 4 kg.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any, Final

import numpy as np
import pinocchio as pin

import dmframe as dm
from dmframe.robot.library import find_robot

GRIPPER: Final = (0.3, [0, 0.04, 0], [0.01, 0, 0.01, 0, 0, 0.01])
HELD: Final = ([0.02, 0.08, -0.03], [0.03, 0, 0.03, 0, 0, 0.03])
CHANGED: Final = 90.0  # [s]
NO_BOX: Final = {"dynamics.a_d_hat_box": None}


def graph_with(masses: Sequence[float], at: Sequence[float]) -> dm.Graph:
    """`ur10_payload` with these loads; the mass of the gripper means no other load."""
    bodies = [GRIPPER[1:] if mass == GRIPPER[0] else HELD for mass in masses]
    center, inertia = [body[0] for body in bodies], [body[1] for body in bodies]
    loads = {"mass": list(masses), "at": list(at), "center": center, "inertia": inertia}
    changes: dict[str, Any] = {f"load.{name}": value for name, value in loads.items()}
    return dm.load("ur10_payload").set(changes)


def reset(graph: dm.Graph, gripper: Mapping[str, Any] | None = None, **options: Any) -> dm.Graph:
    """The same with resets at the signal of all loads but the first."""
    known: Any = graph.blocks["dynamics"]
    law = {"type": "reset_compensator", "Gamma": list(known.Gamma), "a_d_hat": list(known.a_d_hat), **options}
    load: Any = graph.blocks["load"]
    return graph.set(
        {"dynamics": law, "blocks.gripper": {"type": "gripper", "at": list(load.at[1:]), **(gripper or {})}}
    )


@cache
def _arm() -> Any:
    return pin.buildModelFromUrdf(str(find_robot("ur10").urdf))


def errors(run: dm.Run) -> np.ndarray:
    """Distance of the tool from its position for the desired joint angles [mm]."""
    arm, recording = _arm(), run.recording
    data, tool, found = arm.createData(), arm.getFrameId("ee_link"), []
    for q in recording["path.q_d"]:
        pin.framesForwardKinematics(arm, data, q)
        found.append(data.oMf[tool].translation.copy())
    return 1e3 * np.asarray(np.linalg.norm(recording["arm.x"] - np.array(found), axis=1))


def changes() -> None:
    """4 kg become 1 kg."""
    plain = graph_with([0.3, 4.3, 1.3], [0.0, 30.0, CHANGED])
    bare, early, late = plain.set(NO_BOX), [29.8, CHANGED - 0.2], [30.2, CHANGED + 0.2]
    centers = {"center": [HELD[0], HELD[0]]}
    laws = {
        "the gradient alone": bare,
        "in a box": plain,
        "leak: 0.02": bare.set({"dynamics.leak": 0.02}),
        "leak: 0.05": bare.set({"dynamics.leak": 0.05}),
        "reset_compensator": reset(plain),
        "signal 0.2 s late": reset(plain, {"at": late}),
        "signal 0.2 s early": reset(plain, {"at": early}),
        "with the load by its drawing": reset(plain, {"mass": [4, 1], **centers}),
        "with half of its mass": reset(plain, {"mass": [2, 0.5], **centers}),
    }
    for name, graph in laws.items():
        run = graph.run(until=CHANGED + 35)
        time, mass, error = run.time - CHANGED, run.recording["dynamics.a_d_hat"][:, 0] - 1.3, errors(run)
        means = [np.mean(mass[(time >= middle - 5) & (time < middle + 5)]) for middle in (10, 30)]
        first = error[(time >= 0) & (time < 10)]
        figures = f"{means[0]:.2f} kg | {means[1]:.2f} kg | {np.sqrt(np.mean(first**2)):.2f} mm | {first.max():.2f} mm"
        sys.stdout.write(f"| {name} | {figures} |\n")


def turns() -> None:
    """4 kg are taken up and put down."""
    plain = graph_with([0.3, 4.3, 0.3, 4.3, 0.3], [0.0, 30.0, 50.0, 70.0, 90.0])
    laws = {
        "the gradient in a box": plain,
        "reset_compensator": reset(plain),
        "with clearing: 0": reset(plain, clearing=0),
    }
    for name, graph in laws.items():
        run = graph.run(until=100)
        error = errors(run)
        largest = [error[(run.time >= begin) & (run.time < begin + 10)].max() for begin in (70.0, 90.0)]
        sys.stdout.write(f"| {name} | {largest[0]:.1f} mm | {largest[1]:.1f} mm |\n")


if __name__ == "__main__":
    changes()
    turns()
