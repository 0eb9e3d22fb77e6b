"""What a run tells of the way between controller and robot: what stands on it, and where that cut something off."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from dmframe.diagram import Diagram
from dmframe.diagram.closed_loop import Signal
from dmframe.errors import listed
from dmframe.units import plain


def telling(diagram: Diagram) -> list[Signal]:
    """The outputs that are zero as long as all is well, each a column."""
    ports = {f"{name}.{port.name}" for name, block in diagram.blocks.items() for port in block.outputs if port.told}
    return [signal for signal in diagram.loop.outputs if signal.label in ports]


def between(diagram: Diagram) -> str:
    """A sentence that names the blocks through which signals pass; empty where there are none."""
    passing = dict[tuple[str, ...], list[str]]()
    for way in diagram.ways:
        through = tuple(wire.block for wire in way.through)
        passing.setdefault(through, []).append(f"{way.origin.block}.{way.origin.port}")
    said = [f"{listed(signals)} through {listed(list(through))}" for through, signals in passing.items()]
    return f"not ideal: {'; '.join(said)}" if said else ""


def exceptions(
    diagram: Diagram, signals: Sequence[Signal], columns: Mapping[str, np.ndarray], times: np.ndarray
) -> list[str]:
    """What is to be told of each of `signals` that was not zero.

    Parameters
    ----------
    columns
        By label: (N, rows); numbers that are not finite are passed over.
    times
        (N,) [s].
    """
    words = {f"{name}.{port.name}": port.told for name, block in diagram.blocks.items() for port in block.outputs}
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
            f"{words[signal.label]}, first at t = {times[wrong[0]]:.6g} s, in {share:.3g} % of the instants kept; "
            f"the most is {most}"
        )
    return found
