"""Warnings about the signal path between controller and robot: active channel models, saturation, speed limits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from dmframe.block.port import Access
from dmframe.common.errors import listed
from dmframe.common.units import plain, sliding
from dmframe.diagram import Diagram
from dmframe.diagram.closed_loop import Signal
from dmframe.diagram.wiring import Way
from dmframe.simulate.bounds import is_position, ranges


def warning_signals(diagram: Diagram) -> list[Signal]:
    """Outputs whose non-zero values cause a warning, as columns."""
    ports = {f"{name}.{port.name}" for name, block in diagram.blocks.items() for port in block.outputs if port.notice}
    return [signal for signal in diagram.loop.outputs if signal.label in ports]


def channel_models(diagram: Diagram) -> str:
    """Sentence on the signals that pass through channel models; empty without any."""
    passing = dict[tuple[str, ...], list[str]]()
    for way in diagram.ways:
        through = tuple(wire.block for wire in way.through)
        passing.setdefault(through, []).append(f"{way.origin.block}.{way.origin.port}")
    channels = [f"{listed(signals)} through {listed(list(through))}" for through, signals in passing.items()]
    return f"not ideal: {'; '.join(channels)}" if channels else ""


def unread(diagram: Diagram) -> list[str]:
    """Warnings about blocks with unread outputs, possibly because of a missing wire."""
    free = dict[str, list[str]]()
    for wire in diagram.unread:
        free.setdefault(wire.block, []).append(wire.port)
    return [
        f"no block reads {listed([f'{block}.{port}' for port in ports])}, so that {_part(diagram, block, ports)} "
        "has no effect; add a wire, or remove the block"
        for block, ports in free.items()
    ]


def _part(diagram: Diagram, block: str, ports: Sequence[str]) -> str:
    whole = len(ports) == len(diagram.models[block].equations.outputs)
    return f"{block} ({diagram.type_of(block)})" if whole else "it"


def exceptions(
    diagram: Diagram, signals: Sequence[Signal], columns: Mapping[str, np.ndarray], times: np.ndarray
) -> list[str]:
    """Warnings about the `signals` that were not zero.

    Parameters
    ----------
    columns
        By label: (N, rows); non-finite values are skipped.
    times
        (N,) [s].
    """
    words = {f"{name}.{port.name}": port.notice for name, block in diagram.blocks.items() for port in block.outputs}
    found = list[str]()
    for signal in signals:
        size = np.abs(np.nan_to_num(columns[signal.label], nan=0.0, posinf=0.0, neginf=0.0))
        wrong = np.flatnonzero(np.any(size > 0, axis=1))
        if not wrong.size:
            continue
        row, element = np.unravel_index(int(np.argmax(size)), size.shape)
        most = f"{plain(float(size[row, element]), signal.unit)} at {signal.label}[{element}], t = {times[row]:.6g} s"
        share = 100 * wrong.size / len(times)
        found.append(
            f"{words[signal.label]}, first at t = {times[wrong[0]]:.6g} s, in {share:.3g} % of the recorded instants; "
            f"the largest value is {most}"
        )
    return found


def too_fast(diagram: Diagram, columns: Mapping[str, np.ndarray], times: np.ndarray) -> list[str]:
    """Warnings about recorded velocity commands beyond the robot's limits, unless a saturation block warns."""
    if diagram.robot is None:
        return []
    limits = np.array([joint.velocity if joint.velocity > 0 else np.inf for joint in diagram.robot.joints])
    cut = {f"{way.origin.block}.{way.origin.port}" for way in diagram.ways if _warns(diagram, way)}
    found = list[str]()
    for name, block in diagram.blocks.items():
        for port in block.outputs:
            label = f"{name}.{port.name}"
            velocity = port.access is Access.COMMANDED and port.unit == "rad/s" and port.shape == "n"
            if not velocity or label not in columns or label in cut:
                continue
            share = np.nan_to_num(np.abs(columns[label]) / limits, nan=0.0, posinf=0.0)
            over = np.flatnonzero(np.any(share > 1, axis=1))
            if over.size:
                row, joint = np.unravel_index(int(np.argmax(share)), share.shape)
                speed, most = abs(float(columns[label][row, joint])), float(limits[joint])
                found.append(
                    f"{label} is beyond the robot's velocity limits, first at t = {times[over[0]]:.6g} s: "
                    f"{plain(speed, port.unit)} of {diagram.robot.joints[joint].name} at t = {times[row]:.6g} s, whose "
                    f"limit is {plain(most, port.unit)}; no block limits it"
                )
    return found


BEYOND = 1e-3
"""Fraction of a joint's range by which it may leave its limits without a warning, as at an elastic stop."""


def out_of_range(diagram: Diagram, columns: Mapping[str, np.ndarray], times: np.ndarray) -> list[str]:
    """Warnings about joint positions outside of the limits in the robot's file."""
    found = list[str]()
    for variable in diagram.loop.plant:
        if not is_position(diagram, variable) or variable.label not in columns:
            continue
        (lower, upper), q = ranges(diagram.robot), columns[variable.label]
        width = np.where(np.isfinite(upper - lower), upper - lower, 1.0)
        beyond = np.nan_to_num(np.maximum(lower - q, q - upper) / width, nan=0.0, posinf=0.0, neginf=0.0)
        out = np.flatnonzero(np.any(beyond > BEYOND, axis=1))
        if out.size:
            row, k = np.unravel_index(int(np.argmax(beyond)), beyond.shape)
            joint = diagram.robot.joints[k]
            unit = variable.unit if joint.kind == "revolute" else sliding(variable.unit)
            found.append(
                f"{variable.label} leaves the robot's joint limits, first at t = {times[out[0]]:.6g} s: {joint.name} "
                f"is at {plain(float(q[row, k]), unit)} at t = {times[row]:.6g} s, its limits are "
                f"{plain(joint.lower, unit)} and {plain(joint.upper, unit)}; the simulated joint has no stops"
            )
    return found


FAR = 0.5
"""Fraction of the path's extent above which the distance of the start from the path causes a warning."""


def off_path(diagram: Diagram, columns: Mapping[str, np.ndarray]) -> list[str]:
    """Warnings about a start off the path by more than `FAR` of the path's extent, its largest distance from its start.

    A set-point has no extent and causes none.
    """
    units = {signal.label: signal.unit for signal in diagram.loop.outputs}
    found = list[str]()
    for pair in diagram.loop.followed:
        if pair.desired not in columns or pair.actual not in columns or units[pair.desired] != units[pair.actual]:
            continue
        desired, actual = columns[pair.desired], columns[pair.actual]
        gap = float(np.linalg.norm(actual[0] - desired[0]))
        extent = float(np.max(np.linalg.norm(np.nan_to_num(desired - desired[0]), axis=1)))
        if gap > FAR * extent > 0:
            unit = units[pair.actual]
            found.append(
                f"{pair.actual} starts {plain(gap, unit)} from {pair.desired}, which moves by {plain(extent, unit)} in "
                "this run; --set start=null starts on the path"
            )
    return found


def _warns(diagram: Diagram, way: Way) -> bool:
    return any(port.notice for wire in way.through for port in diagram.blocks[wire.block].outputs)
