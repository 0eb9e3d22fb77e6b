r"""Whether a desired path of the tool leaves what the tool can reach: a refutation, and never a proof of reach.

The tool is no farther from the first joint's origin than the sum of the offsets behind it, :math:`|x - o_1| \le
\sum_{i > 1} |t_i| + |t_{tool}|`, whatever the angles are; and where the rows of J have a combination c with
:math:`c^\top J(q) = 0`, as of an arm that moves in a plane, :math:`c^\top x` never changes. One instant at which the
path is elsewhere is enough. A sliding joint has no such bound: the model that runs has no end stops. The cost is
some ms.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import suppress
from typing import Any, Final

import casadi as ca
import numpy as np

from dmframe.block.model import symbols_in
from dmframe.certificate import SX
from dmframe.certify.checked import Checked
from dmframe.certify.claim import Claim
from dmframe.certify.smoothness import HORIZON, SAMPLES
from dmframe.diagram.closed_loop import ClosedLoop, stack
from dmframe.errors import ValueFault
from dmframe.exact.ends import enclosing
from dmframe.units import plain

OUTWARD: Final = 1 + 1e-9
"""By which a reach is enlarged: more than all rounding on the way to it."""
POSES: Final = 12
FLAT: Final = 1e-9
"""Largest singular value over the largest, and distance [m], that rounding explains."""

SOURCE: Final = "x goes to x_d only where the tool can be"


def reach_conditions(claim: Claim) -> Iterator[Checked]:
    """A condition that fails for each desired path of a tool that is out of its reach at some instant."""
    loop = claim.loop
    for name, robot, path in _paths(claim):
        times = np.linspace(0.0, HORIZON, SAMPLES)
        function = ca.Function("path", [loop.time, loop.p], [path])
        places = function.map(SAMPLES)(times[None, :], np.tile(loop.p_values[:, None], SAMPLES)).full()
        for why in (*_too_far(robot, places, times), *_off_plane(robot, places, times)):
            yield Checked(f"{name} {why}", "within the reach of the tool", None, False, SOURCE, reads=loop.p)


def kept_within(claim: Claim) -> Iterator[tuple[str, SX | None, SX]]:
    """Of each path that `reach_conditions` looks at: its name, a margin in parameters, and the parameters it reads.

    The margin above zero keeps the path in reach at all times looked at; below zero it decides nothing. It is None
    where it is not above zero at the graph's own numbers, or no bounds of the path were found.
    """
    loop = claim.loop
    for name, robot, path in _paths(claim):
        known = symbols_in([loop.p])
        read = ca.vertcat(ca.SX(0, 1), *(x for x in ca.symvar(path) if x.element_hash() in known))
        margin = _room(loop, robot, path) if not _still(robot)[0].shape[1] else None
        if margin is not None and not float(ca.Function("room", [loop.p], [margin])(loop.p_values)) > 0:
            margin = None
        yield f"{name} is within the reach of the tool", margin, read


def _room(loop: ClosedLoop, robot: Any, path: SX) -> SX | None:
    """The square of the reach less that of the farthest corner of a box about the path."""
    found = _sphere(robot)
    if found is None:
        return ca.SX(1)
    center, reach = found
    with suppress(ValueFault):
        ends = enclosing(path - center, {loop.time.element_hash(): (0.0, HORIZON)}, waves=True)
        far = ca.fmax(ends.lower * ends.lower, ends.upper * ends.upper)
        return ca.SX(reach * reach - ca.sum1(far))
    return None


def _paths(claim: Claim) -> Iterator[tuple[str, Any, SX]]:
    """Desired paths of a robot's tool that parameters and the time decide: label, robot, path."""
    loop = claim.loop
    for pair in loop.followed:
        robot = claim.diagram.models[pair.actual.partition(".")[0]].robot
        path = loop.on_path(pair.wanted)
        if robot is None or not symbols_in([path]) <= symbols_in([loop.time, loop.p]):
            continue
        if _is_tool(claim, robot, loop.joined([pair.found])[0]):
            yield pair.desired, robot, ca.densify(path)


def _is_tool(claim: Claim, robot: Any, found: SX) -> bool:
    """True for the position of the robot's tool at a state of the plant, at random points."""
    loop = claim.loop
    for variable in loop.plant:
        if variable.symbol.numel() != robot.n or found.shape != (robot.m, 1):
            continue
        leaves = [leaf for leaf in ca.symvar(found) if not symbols_in([leaf]) <= symbols_in([loop.p, variable.symbol])]
        if leaves:
            continue
        function = ca.Function("apart", [variable.symbol, loop.p], [found - robot.position(variable.symbol)])
        rng = np.random.default_rng(0)
        sizes = [np.max(np.abs(function(rng.uniform(-3, 3, robot.n), loop.p_values).full())) for _ in range(3)]
        if max(sizes) < FLAT:
            return True
    return False


def _sphere(robot: Any) -> tuple[np.ndarray, float] | None:
    """The origin of the first joint and the reach about it; None with a joint that slides."""
    chain = robot.chain
    if any(joint.kind != "revolute" for joint in chain.joints):
        return None
    first, *others = [np.array([float(x) for x in joint.translation]) for joint in chain.joints]
    tool = np.array([float(x) for x in chain.tool])
    reach = OUTWARD * math.fsum(float(np.linalg.norm(offset)) for offset in (*others, tool))
    return first[["xyz".index(axis) for axis in chain.axes]], reach


def _too_far(robot: Any, places: np.ndarray, times: np.ndarray) -> Iterator[str]:
    found = _sphere(robot)
    if found is None:
        return
    center, reach = found
    away = np.linalg.norm(places - center[:, None], axis=0)
    k = int(np.argmax(np.nan_to_num(away, nan=0.0)))
    if away[k] > reach + FLAT:
        yield (
            f"is {plain(float(away[k]), 'm')} from the first joint at t = {times[k]:.6g} s, and the tool reaches no "
            f"farther than {plain(reach, 'm')}"
        )


def _still(robot: Any) -> tuple[np.ndarray, np.ndarray]:
    """Directions in which no joint moves the tool at any pose, column by column; and a place of the tool."""
    q = ca.SX.sym("q", robot.n)
    constants = stack([constant.symbol for constant in robot.constants])
    values = np.array([float(value) for constant in robot.constants for value in constant.values])
    function = ca.Function("J", [q, constants], [robot.jacobian(q), robot.position(q)])
    rng = np.random.default_rng(0)
    found = [[x.full() for x in function(rng.uniform(-3, 3, robot.n), values)] for _ in range(POSES)]
    left, sizes, _ = np.linalg.svd(np.hstack([J for J, _ in found]))
    return left[:, [k for k, size in enumerate(sizes) if size <= FLAT * max(sizes[0], FLAT)]], found[0][1]


def _off_plane(robot: Any, places: np.ndarray, times: np.ndarray) -> Iterator[str]:
    still, place = _still(robot)
    if not still.shape[1]:
        return
    off = np.linalg.norm(still.T @ (places - place), axis=0)
    k = int(np.argmax(np.nan_to_num(off, nan=0.0)))
    if off[k] > 1e-6:
        yield f"is {plain(float(off[k]), 'm')} outside of the plane or line of the tool at t = {times[k]:.6g} s"
