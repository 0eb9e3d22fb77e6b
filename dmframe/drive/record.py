"""Conversion of a drive to a recording, with the same signals, files and figures as of a simulation."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any, Final

import casadi as ca
import numpy as np

from dmframe.block.model import SYMBOLIC, symbols_in
from dmframe.block.port import Side
from dmframe.common.slices import slices
from dmframe.common.units import plain
from dmframe.diagram import Diagram
from dmframe.diagram.closed_loop import Signal, stack
from dmframe.runtime.driving import DriveResult, Plan
from dmframe.runtime.gate import Gate
from dmframe.runtime.journal import Journal
from dmframe.runtime.scaled import ScaledController
from dmframe.runtime.signals import FIELDS
from dmframe.simulate import Recording, Solver
from dmframe.simulate.recording import ExtraSignal
from dmframe.simulate.run import moving_outputs

MOST_BYTES: Final = 48 * 2**20
"""Memory for the signals of a drive whose samples are in a file."""
CHUNK: Final = 4096
"""Rows whose signals are computed together."""
THINNED: Final = "signals and figures have one of {every} samples; samples.bin has all {count}, which replay compares"


def recording_of(
    diagram: Diagram,
    scaled: ScaledController,
    result: DriveResult,
    *,
    robot: str,
    plan: Plan,
    gate: Gate,
    solver: Solver,
    thinned: bool = False,
    only: Collection[str] | None = None,
) -> Recording | None:
    """Recording of a drive; None without a sample.

    Time is the controller's; the robot's time is an additional signal. Signals of the robot that are not measured, such
    as torques, are missing. Outputs of the controller are computed from its states and measurements.

    Parameters
    ----------
    thinned
        Decimate the samples of a long drive so that the signals fit into `MOST_BYTES`.
    only
        Labels of the outputs of the controller and of trajectories that are computed; all by default.
    """
    journal = result.journal
    if not len(journal):
        return None
    every = _every(diagram, journal) if thinned else 1
    found = journal.parts(every)
    states = {label: found[f"state:{label}"] for label in scaled.controller.states}
    shown = {name: found[name] for name in FIELDS if journal.columns.widths[name]}
    measured = {label: shown[name] for label, name in scaled.fields.items()}
    commands = {scaled.label: found["command"]}
    time, scale, missed, answer, age = (
        np.ascontiguousarray(found[name][:, 0]) for name in ("reference", "scale", "missed", "answer", "age")
    )
    period = scaled.controller.clock * (1 + missed) * scale
    known = plain_signals(diagram)
    others = {label: shown[name] for label, name in known.items() if label not in measured and name in shown}
    seen = _velocities_scaled(measured, scaled, scale)
    outputs = {**_computed(diagram, states, seen, time, period, only), **others, **measured, **commands}
    hidden = {variable.label for variable in diagram.loop.controller if not variable.recorded}
    extra = {
        "robot.time": ExtraSignal(found["time"], "", "s", "time of the robot's clock"),
        "robot.scale": ExtraSignal(scale[:, None], "", "", "rate of the controller's time relative to the robot's"),
        "robot.missed": ExtraSignal(missed[:, None], "", "", "samples lost before this one"),
        "robot.sent": ExtraSignal(found["sent"], "n", "rad/s", "command after the gate"),
        "robot.answer": ExtraSignal(answer[:, None], "", "s", "from the sample to the command, on this computer"),
    }
    if np.isfinite(age).all():
        extra["robot.age"] = ExtraSignal(age[:, None], "", "s", "age of the last command that the robot received")
    more = (*[journal.notice] * bool(journal.notice), *[THINNED.format(every=every, count=len(journal))] * (every > 1))
    return Recording(
        diagram=diagram,
        clock=scaled.controller.clock,
        duration=plan.until,
        solver=solver,
        time=time,
        states={label: values for label, values in states.items() if label not in hidden},
        outputs=outputs,
        divergence=None,
        interrupted=result.stop is not None,
        wall_time=result.wall_time,
        engine=scaled.controller.engine,
        notices=(*_notices(result, robot, plan.shadow, answer, missed, extra), *more),
        beside=extra,
        drive={**drive_data(robot, plan, gate), "every": every},
        start=_start(diagram, states) if every == 1 else np.zeros(0),
    )


def _start(diagram: Diagram, states: Mapping[str, np.ndarray]) -> np.ndarray:
    """The controller's states before the first command, and zeros for the plant's, which no sample contains."""
    none = np.zeros((1, 0))
    parts = [states.get(v.label, none)[0] for v in diagram.loop.variables]
    sizes = [v.symbol.numel() for v in diagram.loop.variables]
    return np.concatenate([part if part.size else np.zeros(n) for part, n in zip(parts, sizes, strict=True)])


def drive_data(robot: str, plan: Plan, gate: Gate) -> dict[str, Any]:
    """Options of a drive as JSON data, from which a replay reconstructs the gate."""
    return {
        "robot": robot,
        "shadow": plan.shadow,
        "ramp": repr(plan.ramp),
        "period": repr(gate.period),
        "limits": gate.limits.data,
    }


def _every(diagram: Diagram, journal: Journal) -> int:
    width = journal.columns.width + sum(int(signal.expression.numel()) for signal in diagram.loop.outputs)
    return max(1, -(-len(journal) * width * 8 // MOST_BYTES))


def _velocities_scaled(
    measured: dict[str, np.ndarray], scaled: ScaledController, scale: np.ndarray
) -> dict[str, np.ndarray]:
    """Measurements in the controller's time; NaN while it waited, so that results are NaN, too."""
    rate = np.where(scale > 0, scale, np.nan)[:, None]
    return {label: rows if scaled.fields[label] != "dq" else rows / rate for label, rows in measured.items()}


def plain_signals(diagram: Diagram) -> dict[str, str]:
    """Label of each signal of the robot -> field of a sample, also if the controller reads it through an encoder."""
    return {
        signal.label: signal.name
        for signal in diagram.loop.outputs
        if signal.name in FIELDS and diagram.blocks[signal.block].side is Side.PLANT
    }


def _computed(
    diagram: Diagram,
    states: dict[str, np.ndarray],
    measured: dict[str, np.ndarray],
    time: Any,
    period: Any,
    only: Collection[str] | None = None,
) -> dict[str, np.ndarray]:
    """Outputs of the controller and of trajectories, by rows."""
    loop = diagram.loop
    plant = stack(variable.symbol for variable in loop.plant)
    with SYMBOLIC:
        own = [signal for signal in moving_outputs(diagram) if diagram.blocks[signal.block].side is not Side.PLANT]
        own = [signal for signal in own if only is None or signal.label in only]
        column = loop.projected([stack(signal.expression for signal in own)], joined=False)[0]
        column = ca.cse(loop.on_path(column))
        used = symbols_in([column])
        read = [variable for variable in loop.controller if used & variable.identities]
        z, given = stack(v.symbol for v in read), stack(leaf.symbol for leaf in loop.measured)
        if ca.depends_on(column, plant):
            own, column = _without(own, loop, plant)
        f = ca.Function("outputs", [z, given, loop.time, loop.period, loop.p], [column])
        rows = [np.zeros((len(time), 0)), *(states[variable.label] for variable in read)]
        inputs = [np.zeros((len(time), 0)), *(measured[leaf.name] for leaf in loop.measured)]
        z, given = np.hstack(rows).T, np.hstack(inputs).T
        parts_of = [slice(first, min(first + CHUNK, len(time))) for first in range(0, len(time), CHUNK)]
        found = np.concatenate([_mapped(f, z, given, time, period, loop.p_values, part) for part in parts_of])
    parts = slices(signal.expression.numel() for signal in own)
    return {signal.label: np.ascontiguousarray(found[:, part]) for signal, part in zip(own, parts, strict=True)}


def _mapped(f: Any, z: Any, given: Any, time: Any, period: Any, p: np.ndarray, part: slice) -> np.ndarray:
    """Evaluate a function at some instants."""
    count = part.stop - part.start
    whole = np.repeat(p[:, None], count, axis=1)
    return np.asarray(f.map(count)(z[:, part], given[:, part], time[None, part], period[None, part], whole).full().T)


def _without(own: list[Signal], loop: Any, plant: Any) -> tuple[list[Signal], Any]:
    kept, columns = list[Signal](), [ca.SX(0, 1)]
    for signal in own:
        column = loop.on_path(loop.projected([stack([signal.expression])], joined=False)[0])
        if not ca.depends_on(column, plant):
            kept.append(signal)
            columns.append(column)
    return kept, ca.cse(ca.vertcat(*columns))


def _notices(
    result: DriveResult,
    robot: str,
    shadow: bool,
    answer: np.ndarray,
    missed: np.ndarray,
    extra: dict[str, ExtraSignal],
) -> tuple[str, ...]:
    found = [f"robot: {robot}, shadow drive: no command was sent" if shadow else f"robot: {robot}"]
    taken = answer[np.isfinite(answer)]
    if taken.size:
        half, most, worst = (plain(float(value), "s") for value in np.percentile(taken, [50, 99, 100]))
        found.append(f"time to compute and send a command: median {half}, 99th percentile {most}, maximum {worst}")
    if "robot.age" in extra and not shadow:
        ages = extra["robot.age"].values
        half, worst = (plain(float(value), "s") for value in np.percentile(ages, [50, 100]))
        found.append(f"measured latency of commands: median {half}, maximum {worst}")
    if missed.any():
        found.append(f"{int(missed.sum())} of {int(missed.sum()) + missed.size} samples were lost")
    found += [f"the gate limited {count} commands by {rule}" for rule, count in result.cuts.items()]
    if result.stop is not None:
        found.append(f"the robot was stopped: {result.stop}")
    return tuple(found)
