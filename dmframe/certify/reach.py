r"""Whether a desired path leaves the reach of the tool: a refutation, never a proof of reachability.

The tool is within a shell about the first joint's origin, see `dmframe.certify.shell`. If the rows of J have a
combination c with :math:`c^\top J(q) = 0`, as for an arm that moves in a plane, :math:`c^\top x` is constant. One
instant at which the path violates this is sufficient. The cost is a few milliseconds.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from typing import Any, Final

import casadi as ca
import numpy as np

from dmframe.block.certificate import SX
from dmframe.block.model import symbols_in
from dmframe.certify.checked import Checked
from dmframe.certify.claim import Claim
from dmframe.certify.sampler import HORIZON, SAMPLES, Sampler
from dmframe.certify.shell import shell_of
from dmframe.common.errors import ValueFault
from dmframe.common.text import Label, Text
from dmframe.common.units import plain
from dmframe.diagram import Diagram
from dmframe.diagram.closed_loop import ClosedLoop, stack
from dmframe.exact.ends import enclosing

POSES: Final = 12
FLAT: Final = 1e-9
"""Largest relative singular value, and distance [m], that are due to rounding."""

SOURCE: Final = "x goes to x_d only where the tool can be"


def reach_conditions(claim: Claim) -> Iterator[Checked]:
    """A failing condition for each desired path that is out of the tool's reach at some instant."""
    for text in out_of_reach(claim.diagram, HORIZON):
        yield Checked(text, "within the reach of the tool", None, False, SOURCE, reads=claim.loop.p)


def out_of_reach(diagram: Diagram, horizon: float) -> Iterator[Text]:
    """Text for each desired path of a tool that leaves the tool's reach within that time [s]."""
    loop = diagram.loop
    for name, robot, path in _paths(diagram):
        times, places = _places(loop, path, horizon)
        yield from (
            Text(Label(name), f" {why}") for why in (*_too_far(robot, places, times), *_off_plane(robot, places, times))
        )


def largest_tube(diagram: Diagram, desired: str, horizon: float) -> float | None:
    """Upper bound of the distance from a tool's path at which its Jacobian loses rank somewhere [m]; None if unknown.

    A straight line from the path to the boundary of the shell leaves the set of reachable positions, on whose boundary
    the rank is lost.
    """
    for name, robot, path in _paths(diagram):
        shell = shell_of(robot) if name == desired else None
        if shell is not None:
            _, places = _places(diagram.loop, path, horizon)
            away = np.linalg.norm(shell.across @ (places - shell.center[:, None]), axis=0)
            rooms = [shell.outer - np.max(away), *([np.min(away) - shell.inner] if shell.inner else [])]
            return max(0.0, float(min(rooms)))
    return None


def _places(loop: ClosedLoop, path: SX, horizon: float) -> tuple[np.ndarray, np.ndarray]:
    """Instants, and a path at each of them, column by column."""
    times = np.linspace(0.0, horizon, SAMPLES)
    return times, Sampler(ca.Function("path", [loop.time, loop.p], [path]), loop.p_values).over(times)


def kept_within(claim: Claim) -> Iterator[tuple[Text, SX | None, SX]]:
    """Each path checked by `reach_conditions`: name, a margin in parameters, and the parameters that it depends on.

    A positive margin keeps the path in reach at all evaluated times; a negative one decides nothing. It is None if it
    is not positive at the graph's own numbers, or if no bounds of the path were found.
    """
    loop = claim.loop
    for name, robot, path in _paths(claim.diagram):
        known = symbols_in([loop.p])
        read = ca.vertcat(ca.SX(0, 1), *(x for x in ca.symvar(path) if x.element_hash() in known))
        margin = _room(loop, robot, path) if not _fixed_directions(robot)[0].shape[1] else None
        if margin is not None and not float(ca.Function("room", [loop.p], [margin])(loop.p_values)) > 0:
            margin = None
        yield Text(Label(name), " is within the reach of the tool"), margin, read


def _room(loop: ClosedLoop, robot: Any, path: SX) -> SX | None:
    """The least of two margins over a box about the path: to the outer and to the inner radius of the shell."""
    shell = shell_of(robot)
    if shell is None:
        return ca.SX(1)
    with suppress(ValueFault):
        away = ca.DM(shell.across) @ (path - shell.center)
        ends = enclosing(away, {loop.time.element_hash(): (0.0, HORIZON)}, waves=True)
        far = ca.fmax(ends.lower * ends.lower, ends.upper * ends.upper)
        outside = shell.outer**2 - ca.sum1(far)
        if not shell.inner:
            return ca.SX(outside)
        near = ca.fmax(0, ca.fmax(ends.lower, -ends.upper))
        return ca.fmin(outside, ca.sum1(near * near) - shell.inner**2)
    return None


def _paths(diagram: Diagram) -> Iterator[tuple[str, Any, SX]]:
    """Desired paths of a robot's tool that depend on parameters and time only: label, robot, path."""
    loop = diagram.loop
    for pair in loop.followed:
        robot = diagram.models[pair.actual.partition(".")[0]].robot
        path = loop.on_path(pair.wanted)
        if robot is None or not symbols_in([path]) <= symbols_in([loop.time, loop.p]):
            continue
        if _is_tool(loop, robot, loop.joined([pair.found])[0]):
            yield pair.desired, robot, ca.densify(path)


def _is_tool(loop: ClosedLoop, robot: Any, found: SX) -> bool:
    """True for the position of the robot's tool at a state of the plant, at random points."""
    for variable in loop.plant:
        if variable.symbol.numel() != robot.n or found.shape != (robot.m, 1):
            continue
        if symbols_in([found]) - loop.constants - variable.identities:
            continue
        function = ca.Function("apart", [variable.symbol, loop.p], [found - robot.position(variable.symbol)])
        rng = np.random.default_rng(0)
        sizes = [np.max(np.abs(function(rng.uniform(-3, 3, robot.n), loop.p_values).full())) for _ in range(3)]
        if max(sizes) < FLAT:
            return True
    return False


def _too_far(robot: Any, places: np.ndarray, times: np.ndarray) -> Iterator[str]:
    shell = shell_of(robot)
    if shell is None:
        return
    away = np.linalg.norm(shell.across @ (places - shell.center[:, None]), axis=0)
    from_where = "from the first joint" + ", across the directions in which it slides," * shell.slides
    k, near = int(np.argmax(np.nan_to_num(away, nan=0.0))), int(np.argmin(np.nan_to_num(away, nan=np.inf)))
    if away[k] > shell.outer + FLAT:
        yield (
            f"is {plain(float(away[k]), 'm')} {from_where} at t = {times[k]:.6g} s, and the tool reaches no "
            f"farther than {plain(shell.outer, 'm')}"
        )
    if away[near] < shell.inner - FLAT:
        yield (
            f"is {plain(float(away[near]), 'm')} {from_where} at t = {times[near]:.6g} s, and the tool comes no "
            f"nearer than {plain(shell.inner, 'm')}"
        )


def _fixed_directions(robot: Any) -> tuple[np.ndarray, np.ndarray]:
    """Directions in which no joint moves the tool at any pose, column by column; and a position of the tool."""
    q = ca.SX.sym("q", robot.n)
    constants = stack([constant.symbol for constant in robot.constants])
    values = np.array([float(value) for constant in robot.constants for value in constant.values])
    function = ca.Function("J", [q, constants], [robot.jacobian(q), robot.position(q)])
    rng = np.random.default_rng(0)
    found = [[x.full() for x in function(rng.uniform(-3, 3, robot.n), values)] for _ in range(POSES)]
    left, sizes, _ = np.linalg.svd(np.hstack([J for J, _ in found]))
    return left[:, [k for k, size in enumerate(sizes) if size <= FLAT * max(sizes[0], FLAT)]], found[0][1]


def _off_plane(robot: Any, places: np.ndarray, times: np.ndarray) -> Iterator[str]:
    still, place = _fixed_directions(robot)
    if not still.shape[1]:
        return
    off = np.linalg.norm(still.T @ (places - place), axis=0)
    k = int(np.argmax(np.nan_to_num(off, nan=0.0)))
    if off[k] > 1e-6:
        yield f"is {plain(float(off[k]), 'm')} outside of the plane or line of the tool at t = {times[k]:.6g} s"
