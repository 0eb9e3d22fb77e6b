"""Initial states of many runs, vectorised if the runs differ only in numbers."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import Any

import casadi as ca
import numpy as np

from dmframe.common.errors import DmframeError
from dmframe.diagram import Diagram, Variable
from dmframe.simulate.block_starts import Made
from dmframe.simulate.instants import DRAWN, Instants
from dmframe.simulate.start import (
    NEAR,
    ROUNDING,
    fixed_starts,
    goal_and_place,
    on_path,
    pose_on_path,
    start_state,
)
from dmframe.simulate.start_expressions import symbolic_start

Varied = Callable[[int], Diagram]
"""Function from the run's index to its diagram."""


def starts_of(
    diagram: Diagram,
    labels: Collection[str],
    varied: Varied,
    p: np.ndarray,
    given: Mapping[str, Any],
    instants: Instants,
    made: Made,
) -> tuple[np.ndarray, dict[int, DmframeError]]:
    """(S, N): initial state of each run, and the faults of runs without one.

    Parameters
    ----------
    labels
        Varied parameters.
    p
        (P, N), the runs' parameters.
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

    posed = list(on_path(diagram, fixed_starts(diagram, given), made))
    symbols = {parameter.label for parameter in diagram.loop.parameters}
    numbers = {variable.label for variable in diagram.loop.variables} & set(labels) - symbols
    if numbers or len(posed) > 1:  # initial values are not in p; or one of two poses may depend on the other
        for run in range(runs):
            alone(run)
        return states, faults
    unknown = posed[0][1] if posed else None
    poses = np.zeros((0 if unknown is None else unknown.symbol.numel(), runs))
    if unknown is not None:
        read = _read(diagram, *posed[0], made)
        for members in _alike(p[read]):
            try:  # only the pose: other faults of the first run need not occur in the others
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
    """(pose, T, p) -> initial state of the blocks, and its projection into their sets."""
    pose = ca.SX.sym("pose", 0) if unknown is None else unknown.symbol
    drawn = instants.rows(0, 1)[0, DRAWN:]
    stated = {key: value for key, value in given.items() if key != NEAR}
    key = ("begin", repr(stated), str(drawn.tolist()))
    if key not in made:
        free, projected = symbolic_start(diagram, given, unknown, drawn)
        loop = diagram.loop
        made[key] = ca.Function("begin", [pose, loop.period, loop.p], ca.cse([ca.densify(free), ca.densify(projected)]))
    return made[key]


def _read(diagram: Diagram, followed: Any, unknown: Variable, made: Made) -> np.ndarray:
    """Indices in p of the parameters on which the pose depends."""
    read = np.zeros(diagram.loop.p.numel(), dtype=bool)
    for function in goal_and_place(diagram.loop, followed, unknown, made):
        columns = function.sparsity_jac(1, 0) if hasattr(function, "sparsity_jac") else function.jac_sparsity(0, 1)
        read[list(columns.get_triplet()[1])] = True
    return np.flatnonzero(read)


def _alike(columns: np.ndarray) -> list[np.ndarray]:
    """Indices of the columns, grouped by equal columns."""
    if not columns.size:
        return [np.arange(columns.shape[1])] if columns.shape[1] else []
    _, which = np.unique(columns, axis=1, return_inverse=True)
    order = np.argsort(which.ravel(), kind="stable")
    return np.split(order, np.flatnonzero(np.diff(which.ravel()[order])) + 1)
