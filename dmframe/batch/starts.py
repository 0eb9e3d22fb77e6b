"""Where many runs begin: `start_state` of each, all together where no more than numbers differ."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import Any

import casadi as ca
import numpy as np

from dmframe.diagram import Diagram, Variable
from dmframe.errors import DmframeError
from dmframe.simulate.block_starts import Made
from dmframe.simulate.instants import DRAWN, Instants
from dmframe.simulate.start import (
    NEAR,
    ROUNDING,
    goal_and_place,
    on_path,
    pose_on_path,
    start_state,
    told_starts,
)
from dmframe.simulate.start_expressions import symbolic_start

Varied = Callable[[int], Diagram]
"""The diagram of one run, with its numbers."""


def starts_of(
    diagram: Diagram,
    labels: Collection[str],
    varied: Varied,
    p: np.ndarray,
    given: Mapping[str, Any],
    instants: Instants,
    made: Made,
) -> tuple[np.ndarray, dict[int, DmframeError]]:
    """(S, N): where each run begins, and the faults of those that cannot.

    Parameters
    ----------
    labels
        What varies.
    p
        (P, N), the runs' parameters, of runs that have some.
    given, instants, made
        See `start_state`.
    """
    runs = p.shape[1]
    states, faults = np.zeros((diagram.loop.state.numel(), runs)), dict[int, DmframeError]()

    def alone(run: int) -> None:
        try:
            states[:, run] = start_state(varied(run), given, made, instants)
        except DmframeError as fault:
            faults[run] = fault

    posed = list(on_path(diagram, told_starts(diagram, given), made))
    symbols = {parameter.label for parameter in diagram.loop.parameters}
    numbers = {variable.label for variable in diagram.loop.variables} & set(labels) - symbols
    if numbers or len(posed) > 1:  # starts that no expression reads; of two poses, one may hang on the other
        for run in range(runs):
            alone(run)
        return states, faults
    unknown = posed[0][1] if posed else None
    poses = np.zeros((0 if unknown is None else unknown.symbol.numel(), runs))
    if unknown is not None:
        read = _read(diagram, *posed[0], made)
        for members in _alike(p[read]):
            try:  # the pose alone: whatever else ails the first of them is not the others' fault
                pose = pose_on_path(varied(members[0]), given, made, unknown)
                poses[:, members] = pose.reshape(-1, 1, order="F")
            except DmframeError as fault:
                faults.update(dict.fromkeys(members.tolist(), fault))
    begin = _begin(diagram, given, unknown, instants, made)
    free, states = (np.asarray(found.full()) for found in begin(poses, instants.period, p))
    sound = np.isfinite(free) & (np.abs(free - states) <= ROUNDING * (1 + np.abs(free)))
    for run in np.flatnonzero(~np.all(sound, axis=0)).tolist():
        if run not in faults:
            alone(run)
    return states, faults


def _begin(diagram: Diagram, given: Mapping[str, Any], unknown: Variable | None, instants: Instants, made: Made) -> Any:
    """(pose, T, p) -> the state that the blocks say, and the same put into its sets."""
    pose = ca.SX.sym("pose", 0) if unknown is None else unknown.symbol
    drawn = instants.rows(0, 1)[0, DRAWN:]
    said = {key: value for key, value in given.items() if key != NEAR}
    key = ("begin", repr(said), str(drawn.tolist()))
    if key not in made:
        free, held = symbolic_start(diagram, given, unknown, drawn)
        loop = diagram.loop
        made[key] = ca.Function("begin", [pose, loop.period, loop.p], ca.cse([ca.densify(free), ca.densify(held)]))
    return made[key]


def _read(diagram: Diagram, followed: Any, unknown: Variable, made: Made) -> np.ndarray:
    """Places in p of the numbers on which the pose hangs."""
    read = np.zeros(diagram.loop.p.numel(), dtype=bool)
    for function in goal_and_place(diagram.loop, followed, unknown, made):
        columns = function.sparsity_jac(1, 0) if hasattr(function, "sparsity_jac") else function.jac_sparsity(0, 1)
        read[list(columns.get_triplet()[1])] = True
    return np.flatnonzero(read)


def _alike(columns: np.ndarray) -> list[np.ndarray]:
    """Places of the columns that are equal to one another, together."""
    if not columns.size:
        return [np.arange(columns.shape[1])] if columns.shape[1] else []
    _, which = np.unique(columns, axis=1, return_inverse=True)
    order = np.argsort(which.ravel(), kind="stable")
    return np.split(order, np.flatnonzero(np.diff(which.ravel()[order])) + 1)
