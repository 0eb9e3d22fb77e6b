"""Files of an experiment: commands as CSV, a URScript program, and a graph that ``dmframe drive`` runs."""

from __future__ import annotations

import io
import os
from itertools import groupby
from pathlib import Path
from typing import Any, Final

import numpy as np

from dmframe.common.errors import DmframeError
from dmframe.common.files import write_text, writing
from dmframe.graph.graph import Graph
from dmframe.identification.excitation import Excitation
from dmframe.identification.subject import ARM, Subject
from dmframe.robot.library import robots
from dmframe.runtime.signals import velocity_command

COMMANDS: Final = "experiment.csv"
SCRIPT: Final = "experiment.script"
GRAPH: Final = "experiment.yaml"


def write_experiment(subject: Subject, plan: Excitation, folder: Path) -> tuple[str, ...]:
    """Write the files; returns notices, such as that the source's servo does not take velocities.

    Raises
    ------
    OutputError
        A file cannot be written.
    """
    with writing(folder, "folder"):
        folder.mkdir(parents=True, exist_ok=True)
    texts = {COMMANDS: commands_text(plan), GRAPH: graph_text(subject, plan, folder), **subject.files}
    if len(subject.arm) == ARM:
        texts[SCRIPT] = script_text(subject, plan)
    for name, text in texts.items():
        write_text(folder / name, text)
    try:
        velocity_command(Graph.read(folder / GRAPH).diagram)
    except DmframeError as error:
        (folder / GRAPH).unlink()
        return (f"no {GRAPH}: {subject.name} has no servo that takes joint velocities ({error.text})",)
    return ()


def commands_text(plan: Excitation) -> str:
    """Time, commanded positions and velocities, with the names of columns that `identify` reads."""
    n = len(plan.start)
    names = ["t", *(f"q_c_{j}" for j in range(1, n + 1)), *(f"dq_c_{j}" for j in range(1, n + 1))]
    stream = io.StringIO()
    rows = np.column_stack([plan.time, plan.q_c, plan.dq_c])
    np.savetxt(stream, rows, delimiter=",", header=",".join(names), comments="", fmt="%.10g")
    return stream.getvalue()


def graph_text(subject: Subject, plan: Excitation, folder: Path) -> str:
    """A graph with the steps as the controller, and the robot and servo of the source."""
    from ruamel.yaml import YAML

    yaml = YAML()
    yaml.default_flow_style = None
    yaml.width = 140
    robot, model = dict(subject.robot), str(subject.robot["model"])
    if model not in robots() and model not in subject.files:
        robot["model"] = os.path.relpath(model, folder.resolve())
    steps: dict[str, Any] = {
        "type": "velocity_steps",
        "times": [float(f"{plan.period * k:.10g}") for k in plan.at],
        "speeds": [[float(f"{x:.10g}") for x in row] for row in plan.speeds],
    }
    if np.any(plan.ramp > 0):
        steps["ramp"] = [float(f"{plan.period * max(k, 1e-6):.10g}") for k in plan.ramp]
    data = {
        "dmframe": 1,
        "title": f"Velocity steps of every joint of {subject.chain.name}, for dmframe identify",
        "robot": _plain(robot),
        "clock": plan.period,
        "duration": float(f"{plan.period * (plan.count - 1):.10g}"),
        "start": {"q": [float(x) for x in plan.start]},
        "blocks": {"steps": steps, "inverse": {"type": "kinematic_command"}, **_plain(subject.plant)},
    }
    if subject.wires:
        data["wires"] = _plain(subject.wires)
    stream = io.StringIO()
    yaml.dump(data, stream)
    return stream.getvalue()


def _plain(value: Any) -> Any:
    """Dictionaries, lists, texts and numbers of a document, without its comments."""
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, bool) or value is None:
        return value
    kind = next((kind for kind in (int, float, str) if isinstance(value, kind)), str)
    return kind(value)


def script_text(subject: Subject, plan: Excitation) -> str:
    """A URScript program: `movej` to the start, then `servoj` along the commanded positions once a period."""
    start, speeds = subject.spread(plan.start[None])[0], np.zeros((plan.count, ARM))
    places = [list(subject.arm).index(name) for name in subject.chain.joint_names]
    speeds[:, places] = plan.dq_c
    moved = ", ".join(f"q[{j}] + T * v[{j}]" for j in range(ARM))
    lines = [
        "# Velocity steps for dmframe identify: record actual_q and target_q or target_qd by RTDE, each cycle.",
        "# Not tried on hardware, and no safety function: check the motion in a simulator and at reduced speed first.",
        f"# Joints: {', '.join(subject.arm)}; {plan.count} samples of {1000 * plan.period:g} ms.",
        "def dmframe_experiment():",
        f"  T = {plan.period:.10g}",
        f"  global q = {_list(start)}",
        "  def steps(v, count):",
        "    i = 0",
        "    while i < count:",
        "      servoj(q, 0, 0, T, 0.03, 300)",
        f"      q = [{moved}]",
        "      i = i + 1",
        "    end",
        "  end",
        "  movej(q, a=0.5, v=0.3)",
        "  sleep(1.0)",
    ]
    for row, same in groupby(map(tuple, np.round(speeds, 9))):
        lines.append(f"  steps({_list(row)}, {sum(1 for _ in same)})")
    return "\n".join([*lines, "  stopj(2.0)", "end", ""])


def _list(values: Any) -> str:
    return f"[{', '.join(f'{float(x) + 0.0:.9g}' for x in values)}]"
