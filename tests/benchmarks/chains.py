"""(d): the cost to build, compile, step and verify a chain of n joints."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from tests.benchmarks.table import Row, Section
from tests.benchmarks.worker import Failed, measure

JOINTS = (3, 6, 7, 10, 15, 20, 30)
REPEATS = 5
STAGES = ("build", "compile", "step", "verify")


def urdf(n: int) -> str:
    """A chain of n equal joints about z, y, x, z, ... in turn; heavy rotors avoid stiffness at any length."""
    lines = ['<robot name="chain">', '<link name="link_0"/>']
    axes = ("0 0 1", "0 1 0", "1 0 0")
    for j in range(n):
        lines += [
            f'<link name="link_{j + 1}"><inertial><origin xyz="0.01 0.02 0.05"/><mass value="1"/>'
            '<inertia ixx="1.1" iyy="1.2" izz="1.3" ixy="0.01" ixz="0.02" iyz="0.03"/></inertial></link>',
            f'<joint name="joint_{j}" type="revolute"><parent link="link_{j}"/><child link="link_{j + 1}"/>'
            f'<origin xyz="0.01 0 {0.1 if j else 0.0}"/><axis xyz="{axes[j % 3]}"/>'
            '<limit lower="-3" upper="3" velocity="5" effort="300"/></joint>',
        ]
    return "\n".join([*lines, "</robot>", ""])


def graph(n: int) -> str:
    """Joint tracking on that chain, the full set of dynamic parameters estimated."""
    return f"""\
dmframe: 1
robot: {{model: ./chain.urdf}}
clock: 8 ms
duration: 1 s
start: {{q: {[0.3] * n}}}
blocks:
  path:     {{type: sinusoid, center: {[0.3] * n}, amplitude: 0.1, rate: 0.5}}
  task:     {{type: joint_tracking, alpha_bar: 2}}
  model:    {{type: regressor, friction: [viscous]}}
  dynamics: {{type: dynamic_compensator, Gamma: 0.01}}
  inverse:  {{type: pid_inverse, K_c: 1, Lambda: 0.000001, Lambda_P: 0.1, Lambda_I: 0.1, w_P: 2, w_I: 0.7,
             w_box: [0, 1], w_P_box: [1, 3], w_I_box: [0.5, 2]}}
  servo:    {{type: pid_servo, K_D: 100, K_P: 220, K_I: 70}}
  arm:      {{type: manipulator, viscous: 1}}
"""


def cost(n: int, stages: Sequence[str]) -> dict[str, Any]:
    """Seconds of each requested stage; the chain is always built first. The step is one sample of 8 ms."""
    from dmframe.certify import verify
    from dmframe.graph.graph import Graph
    from dmframe.simulate import simulate

    with TemporaryDirectory() as folder:
        os.environ["DMFRAME_CACHE"] = str(Path(folder, "cache"))
        Path(folder, "chain.urdf").write_text(urdf(n), encoding="utf-8")
        file = Path(folder, "chain.yaml")
        file.write_text(graph(n), encoding="utf-8")
        _ = Graph.read("pendulum").diagram  # so that imports are not measured
        begin = time.perf_counter()
        loaded = Graph.read(file)
        diagram = loaded.diagram
        found = {"build": time.perf_counter() - begin}
        if "step" in stages:
            options: dict[str, Any] = {"clock": loaded.file.clock, "solver": loaded.solver, "start": loaded.start}
            begin = time.perf_counter()
            first = simulate(diagram, 0.008, engine="compiled", **options)
            found["compile"] = time.perf_counter() - begin
            if first.engine != "compiled":
                raise RuntimeError("; ".join(first.notices) or "no compiled engine")
            runs = [simulate(diagram, 1.0, engine="compiled", **options) for _ in range(REPEATS)]
            if runs[0].divergence is not None:
                raise RuntimeError(f"the chain diverged: {runs[0].divergence}")
            found["step"] = min(run.wall_time for run in runs) / (len(runs[0].time) - 1)
        if "verify" in stages:
            begin = time.perf_counter()
            verdict = verify(diagram)
            found["verify"] = time.perf_counter() - begin
            if verdict.outcome != "proved":
                raise RuntimeError(f"the verdict is {verdict.outcome}")
        return found


def section(
    limit: float, joints: Sequence[int] = JOINTS, progress: Callable[[str], None] = lambda text: None
) -> Section:
    """Four rows for each number of joints."""
    rows, three = list[Row](), dict[str, float]()
    for n in joints:
        progress(f"(d) {n} joints")
        found, faults = dict[str, float](), dict[str, str]()
        for stages in (["build", "compile", "step"], ["verify"]):
            try:
                found = {**measure("chains:cost", limit, n=n, stages=stages), **found}
            except Failed as failure:
                faults |= dict.fromkeys(stages, str(failure))
        three = three or found
        rows += [row(n, stage, found, faults, three) for stage in STAGES]
    return Section(
        "d",
        "joint tracking on generated chains, full set of dynamic parameters",
        f"the cost with {joints[0]} joints, divided by this cost",
        tuple(rows),
        (f"A stage that takes longer than {limit:g} s is ended. Compiling includes writing the C and loading it.",),
    )


def row(n: int, stage: str, found: dict[str, float], faults: dict[str, str], three: dict[str, float]) -> Row:
    """One stage of one chain."""
    name = f"{n} joints: {stage}"
    if stage not in found:
        return Row("d", name, status="failed", agreement=faults.get(stage, "not reached"))
    scale, unit = (1e6, "us a sample") if stage == "step" else (1.0, "s")
    ratio = three[stage] / found[stage] if found is not three and stage in three else None
    if not np.isfinite(found[stage]):
        return Row("d", name, status="failed", agreement="not finite")
    return Row("d", name, found[stage] * scale, unit, ratio)
