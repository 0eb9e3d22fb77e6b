"""Every combination of generator and servo on every robot: verdict, error bound and time.

``python tests/benchmarks/verify_all.py [ROBOT...]`` prints one line for each configuration; the status is 1 if one is
not proved. Times are CPU seconds to read and build the graph, and to prove it.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

from dmframe.certify import Verdict, verify
from dmframe.graph.graph import Graph

ROBOTS = {
    "ur10, 3 joints": (
        3,
        "{model: ur10, free: [shoulder_pan_joint, shoulder_lift_joint, elbow_joint], "
        "hold: {wrist_2_joint: -90 deg}, tool: ee_link}",
    ),
    "ur10": (6, "{model: ur10, tool: ee_link}"),
    "panda": (7, "panda"),
    "xarm7": (7, "xarm7"),
}
KINEMATICS = {"uncertain": "{type: adaptive_kinematics, Gamma_k: 1}", "known": "{type: kinematics}"}
GOAL, CIRCLE = "{type: setpoint, x_d: [0.4, 0.1, 0.4]}", "{type: circle, center: [0.4, 0.1, 0.4], radius: 0.1, rate: 1}"
FILTERED = "  filter: {type: passive_filter, K_1: 5}\n  task: {type: filtered_regulation, K_2: 1, alpha: 10}\n"
OBSERVED = "  observer: {type: task_observer, beta: 1}\n  task: {type: observed_tracking, gamma: 1}\n"
GENERATORS = {
    "filtered_regulation": (GOAL, FILTERED, tuple(KINEMATICS)),
    "observed_regulation": (GOAL, OBSERVED, tuple(KINEMATICS)),
    "observed_tracking": (CIRCLE, OBSERVED, tuple(KINEMATICS)),
    "known_tracking": (CIRCLE, "  task: {type: known_tracking, gamma: 1}\n", ("known",)),
    "joint_tracking": ("", "  task: {type: joint_tracking, alpha_bar: 2}\n", ("",)),
}
SERVOS = {
    "pi": ("Lambda: 0.01, Lambda_I: 1, w_I: 2", "{type: pi_servo, K_P: 100, K_I: 100}"),
    "pid": (
        "Lambda: 0.01, Lambda_P: 10, Lambda_I: 10, w_P: 2, w_I: 0.5",
        "{type: pid_servo, K_D: 800, K_P: 1760, K_I: 560}",
    ),
}
ARM = "  arm: {type: manipulator, viscous: 5, coulomb: %s}\n"
TORQUE = """\
  task: {type: computed_torque, alpha_bar: 2}
  command: {type: regressor, friction: [viscous], bias: true}
  torque: {type: certainty_equivalence}
  model: {type: regressor, friction: [viscous], bias: true, nominal: 0.8}
  sensor: {type: accelerometer}
"""
WIRES = """\
wires:
  model.dq_ref: arm.dq
  model.ddq_ref: sensor.ddq_m
  adaptation.Y_d: model.Y_d
  torque.Y_d: command.Y_d
"""
ADAPTATIONS = {
    "torque_indirect": "  adaptation: {type: indirect_adaptation, Gamma: 1}\n",
    "torque_direct": "  mass: {type: mass_estimate}\n  adaptation: {type: direct_adaptation, Gamma: 1}\n",
}


def graphs(robot: str) -> Iterator[tuple[str, str]]:
    """Name and text of every configuration on a robot."""
    n, model = ROBOTS[robot]
    head = f"dmframe: 1\nrobot: {model}\nclock: continuous\nduration: 1 s\nblocks:\n"
    joints = f"{{type: sinusoid, center: {[0.3] * n}, amplitude: 0.2, rate: 1}}"
    for servo, (gains, law) in SERVOS.items():
        plant = f"  servo: {law}\n"
        for generator, (path, task, kinds) in GENERATORS.items():
            tie = "position" if generator == "filtered_regulation" else "velocity"
            extra = f"K_c: 0.8, tie: {tie}, " if servo == "pid" else ""
            for kind in kinds:
                geometry = f"  geometry: {KINEMATICS[kind]}\n" if kind else ""
                yield (
                    f"{generator}_{servo}" + (f", {kind} kinematics" if kind else ""),
                    f"{head}  path: {path or joints}\n{geometry}{task}"
                    "  model: {type: regressor, friction: [viscous, coulomb]}\n"
                    "  dynamics: {type: dynamic_compensator, Gamma: 1}\n"
                    f"  inverse: {{type: {servo}_inverse, {extra}{gains}}}\n{plant}{ARM % 8}",
                )
        for adaptation, blocks in ADAPTATIONS.items():
            inverse = f"  inverse: {{type: {servo}_torque_inverse, {gains}}}\n"
            text = f"{head}  path: {joints}\n{TORQUE}{blocks}{inverse}{plant}{ARM % 0}{WIRES}"
            yield f"{adaptation}_{servo}", text


def verdict(text: str, folder: Path) -> tuple[Verdict, float, float]:
    """The verdict on a graph; CPU seconds to build the graph, and to prove it."""
    file = folder / "graph.yaml"
    file.write_text(text, encoding="utf-8")
    begin = time.process_time()
    diagram = Graph.read(file).diagram
    built = time.process_time()
    found = verify(diagram)
    return found, built - begin, time.process_time() - built


def main(robots: list[str]) -> int:
    failed = 0
    with TemporaryDirectory() as folder:
        for robot in robots or ROBOTS:
            for name, text in graphs(robot):
                found, build, prove = verdict(text, Path(folder))
                bound = f"2^{found.test.log2_error_bound:.0f}" if found.test else "-"
                print(
                    f"{robot:15}{name:50}{found.outcome:15}{bound:8}graph {build:.2f} s, proof {prove:.2f} s",
                    flush=True,
                )
                failed += found.outcome != "proved"
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
