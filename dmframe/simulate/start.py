"""Initial state of a run: at rest, on the path, commands at the robot position."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import casadi as ca
import numpy as np

from dmframe.block.model import symbols_in
from dmframe.block.port import Side
from dmframe.common.errors import DmframeError, StartError, UnknownNameError, ValueFault, raise_all
from dmframe.common.units import plain
from dmframe.diagram import ClosedLoop, Diagram, Variable
from dmframe.diagram.bodies import Bodies
from dmframe.diagram.closed_loop import Followed, stack
from dmframe.diagram.projection import Projection
from dmframe.simulate.block_starts import Made, at_start, block_starts, has_start, in_order, once
from dmframe.simulate.instants import DRAWN, Instants
from dmframe.simulate.keep import rotation_distance_of

NEAR = "near"
"""Key under `start` that selects a branch of the inverse kinematics."""

REACHED = 1e-9
"""Tolerance of a start pose on the path [m or rad]."""

TURNED = "R_d"
"""Port name of the desired orientation of a tool."""

BEST = 1e8
"""Condition number below which a matrix counts as regular."""

FARTHEST = 1e100
"""Limit above which the square of a distance overflows."""

ROUNDING = 1e-9
"""Tolerance of a start in its box, relative to one plus its size."""


def start_state(
    diagram: Diagram, given: Mapping[str, Any], made: Made | None = None, instants: Instants | None = None
) -> np.ndarray:
    """Initial state as one column, controller states first.

    Sources of an initial value, in order of precedence:

    1. `given`, by the name of the state or ``block.name``;
    2. the block's parameter of the same name;
    3. the block's `start` expression, which may read measured signals, with the random numbers of the first tick from
       `instants` (zeros without them);
    4. for a plant state whose measured signal ``s`` follows a trajectory ``s_d``: the solution of s = s_d(0), with the
       orientation of the task if it has one, nearest to ``given["near"]``;
    5. zero.

    Raises `StartError` for a state outside its box or ball. `made` caches functions between diagrams that differ only
    in parameter values.
    """
    loop, made = diagram.loop, {} if made is None else made
    variables = loop.variables
    values = fixed_starts(diagram, given)
    _onto_path(diagram, values, given.get(NEAR), made)
    for variable in loop.plant:
        if not has_start(diagram, variable, made):
            values.setdefault(variable.label, np.zeros(variable.symbol.shape))
    _start_expressions(diagram, values, made, instants or Instants.of(loop, 1.0))
    _check_finite(variables, values)
    _into_sets(loop, values)
    return _column(variables, values)


def pose_on_path(diagram: Diagram, given: Mapping[str, Any], made: Made, variable: Variable) -> np.ndarray:
    """Initial value of a state that follows a trajectory; errors as in `start_state`."""
    values = fixed_starts(diagram, given)
    _onto_path(diagram, values, given.get(NEAR), made)
    return values[variable.label]


def fixed_starts(diagram: Diagram, given: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """Initial values from `given` or from block parameters; see `start_state`."""
    values = given_starts(diagram, diagram.loop.variables, given)
    for variable in diagram.loop.variables:
        model = diagram.models[variable.block]
        if variable.label not in values and variable.name in model.values:
            values[variable.label] = model.values[variable.name]
    return values


def check_start(diagram: Diagram, given: Mapping[str, Any]) -> None:
    """Raise `DmframeError` for initial values of unknown states, of the wrong size, or outside the joint limits."""
    given_starts(diagram, diagram.loop.variables, given)
    for name in diagram.blocks:
        block_starts(diagram, name, {})


def _into_sets(loop: ClosedLoop, values: dict[str, np.ndarray]) -> None:
    """Project initial values onto their boxes and balls; raise `StartError` beyond the rounding tolerance."""
    faults = list[DmframeError]()
    for projection in loop.projections:
        start = np.ravel(values[projection.name])
        values[projection.name] = evaluate(loop, projection.set.held(projection.state), {projection.name: start})
        missed = np.abs(start - values[projection.name]) > ROUNDING * (1 + np.abs(start))
        if missed.any():
            faults.append(_outside(loop, projection, start, int(np.argmax(missed))))
    raise_all(faults)


def _outside(loop: ClosedLoop, projection: Projection, start: np.ndarray, k: int) -> StartError:
    block, parameter = projection.parameter.split(".")
    label = f"{projection.name}[{k}]" if start.size > 1 else projection.name
    room = evaluate(loop, projection.set.room(projection.state), {projection.name: start})
    if isinstance(projection.set, Bodies):
        link = int(np.argmin(room)) // 4 + 1
        found = (
            f"{projection.name}: expected each link's pseudo-inertia to start at {parameter} times its nominal one or "
            f"above, found that of link {link} below"
        )
    elif projection.kind == "ball":
        found = f"{projection.name}: expected a start inside {parameter}, found {np.sqrt(1 - room[0]):.4g} radii away"
    else:
        lower, upper = start - room[: start.size], start + room[start.size :]
        found = f"{label}: expected a start inside {parameter}, {lower[k]:.6g} to {upper[k]:.6g}, found {start[k]:.6g}"
    return StartError(f"{found}; move the start or the {projection.kind}", path=("blocks", block, parameter))


def _check_finite(variables: Sequence[Variable], values: Mapping[str, np.ndarray]) -> None:
    raise_all(
        [
            StartError(
                f"{v.label}: expected a finite start, found {np.ravel(values[v.label]).tolist()}",
                path=("blocks", v.block),
            )
            for v in variables
            if not np.all(np.isfinite(values[v.label]))
        ]
    )


def given_starts(diagram: Diagram, variables: Sequence[Variable], given: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """Initial values in `given`, by state label. Raises `DmframeError` as `check_start` does."""
    values, faults = dict[str, np.ndarray](), list[DmframeError]()
    plant_first = sorted(variables, key=lambda v: diagram.blocks[v.block].side is not Side.PLANT)
    for key, value in given.items():
        if key == NEAR:
            continue
        found = next((v for v in plant_first if key in (v.label, v.name)), None)
        if found is None:
            choices = [NEAR, *(v.label for v in variables)]
            faults.append(UnknownNameError(f"start.{key}", "state", key, choices, path=("start", key)))
            continue
        numbers = _numbers(value)
        rows, columns = found.symbol.shape
        shape = (rows,) if columns == 1 else (rows, columns)
        if numbers.shape not in ((), shape):
            expected = f"{rows} numbers" if columns == 1 else f"one number, or {rows} rows of {columns}"
            size = " x ".join(map(str, numbers.shape)) if numbers.size and numbers.ndim > 1 else numbers.size
            faults.append(ValueFault(f"start.{key}: expected {expected}, found {size}", path=("start", key)))
            continue
        faults += _other_units(diagram, found, value, key)
        values[found.label] = np.broadcast_to(numbers, shape).ravel(order="F")  # matrices are column-major
        faults += _outside_limits(diagram, found, values[found.label], key)
    raise_all(faults)
    return values


def _other_units(diagram: Diagram, variable: Variable, value: Any, key: str) -> list[DmframeError]:
    """Faults of numbers whose unit is not that of the state, or of the joint type (m for prismatic)."""
    of_joints = diagram.robot is not None and variable.shape == "n" and variable.unit == "rad"
    joints = diagram.robot.joints if of_joints else ()
    items = value if isinstance(value, list | tuple) else [value] * max(1, len(joints))
    faults = list[DmframeError]()
    for k, item in enumerate(items):
        unit = getattr(item, "unit", None)
        slides = k < len(joints) and joints[k].kind == "prismatic"
        wanted = "m" if slides else variable.unit
        if unit is not None and unit != wanted:
            whose = f" of {joints[k].name}" if k < len(joints) else ""
            text = f"start.{key}: expected a number in {wanted or '1'}{whose}, found {float(item):.6g} {unit}"
            faults.append(ValueFault(text, path=("start", key)))
    return faults


def _numbers(value: Any) -> np.ndarray:
    """The value as an array; (0, 0) if it is not numeric, a shape that no state has."""
    try:
        return np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        return np.zeros((0, 0))


def _outside_limits(diagram: Diagram, variable: Variable, q: np.ndarray, key: str) -> list[DmframeError]:
    if diagram.robot is None or variable.name != "q" or diagram.blocks[variable.block].side is not Side.PLANT:
        return []
    return [
        StartError(
            f"start.{key}: expected {joint.name} between {joint.lower:.4g} and {joint.upper:.4g}, found {angle:.6g}",
            path=("start", key),
        )
        for joint, angle in zip(diagram.robot.joints, q, strict=True)
        if not joint.lower <= angle <= joint.upper
    ]


def on_path(diagram: Diagram, known: Collection[str], made: Made) -> Iterator[tuple[Followed, Variable]]:
    """Plant states without another initial value that follow a trajectory, with the signal pair that determines them.

    With a desired orientation, its rows follow those of the position.
    """
    open_states = [v for v in diagram.loop.plant if v.label not in known and not has_start(diagram, v, made)]
    for followed in diagram.loop.followed if open_states else ():
        used = [v for v in open_states if ca.depends_on(ca.vec(followed.found), ca.vec(v.symbol))]
        if len(used) == 1:
            yield turned(diagram, followed, used[0]), used[0]
            open_states.remove(used[0])


def turned(diagram: Diagram, followed: Followed, unknown: Variable) -> Followed:
    """Signal pair of a tool, extended by the rotation matrices if a block has a desired orientation."""
    loop, distance, robot = diagram.loop, rotation_distance_of(diagram.loop), diagram.models[unknown.block].robot
    if (
        distance is None
        or robot is None
        or followed.actual.rpartition(".")[2] != "x"
        or unknown.symbol.numel() != robot.n
    ):
        return followed
    label = f"{distance.rpartition('.')[0]}.{TURNED}"
    wanted = [loop.on_path(ca.vec(signal.expression)) for signal in loop.outputs if signal.label == label]
    if not wanted or not symbols_in(wanted) <= symbols_in([loop.time, loop.p]):  # not a function of time only
        return followed
    found = ca.vec(robot.rotation(unknown.symbol))
    goal, place = ca.vertcat(ca.vec(followed.wanted), wanted[0]), ca.vertcat(ca.vec(followed.found), found)
    return Followed(followed.desired, followed.actual, goal, place)


def goal_and_place(loop: ClosedLoop, followed: Followed, unknown: Variable, made: Made) -> tuple[Any, Any]:
    """Functions (t, p) -> desired value, and (state, p) -> value of the plant's signal.

    Raises `StartError` if a block scales the time of the path.
    """
    if (source := followed.desired.partition(".")[0]) in loop.paced:
        text = (
            f"start: expected {unknown.label}, found none; {source} scales the time of its path, so that the initial "
        )
        raise StartError(f"{text}pose is not computed from the path; give {unknown.label} under start")
    goal = once(made, ("goal", followed.desired), partial(_goal, loop, followed.wanted))
    key = ("residual", followed.actual, unknown.label)
    return goal, once(made, key, partial(ca.Function, "residual", [unknown.symbol, loop.p], [ca.vec(followed.found)]))


def _onto_path(diagram: Diagram, values: dict[str, np.ndarray], near: Any, made: Made) -> None:
    loop = diagram.loop
    for followed, unknown in on_path(diagram, values, made):
        goal_now, residual = goal_and_place(loop, followed, unknown, made)
        goal = goal_now(0, loop.p_values).full().ravel()
        jacobian = once(made, ("jacobian", followed.actual, unknown.label), residual.jacobian)
        desired, actual = f"{followed.desired}(0)", followed.actual
        rows = next(pair.wanted.numel() for pair in loop.followed if pair.actual == actual)
        values[unknown.label] = _solve(diagram, residual, jacobian, goal, near, desired, actual, rows)


def _solve(
    diagram: Diagram, residual: Any, jacobian: Any, goal: np.ndarray, near: Any, desired: str, label: str, rows: int
) -> np.ndarray:
    """Pose at the goal by least squares; the rows after the first `rows` are the orientation."""
    p, size = diagram.loop.p_values, residual.size1_in(0)
    if not np.max(np.abs(goal), initial=0.0) < FARTHEST:  # nan too
        text = f"start: expected {desired} below {FARTHEST:g}, found {goal.tolist()}; take numbers nearer to 1"
        raise StartError(text, path=("start",))
    lower, upper = _limits(diagram, size)
    nearby = None if near is None else _near(near, size)
    alone = joint_goal(residual, jacobian, goal, p)
    if alone is not None and np.all((lower <= alone) & (alone <= upper)):
        return alone
    from scipy.optimize import least_squares  # deferred: slow import

    middle = (np.maximum(lower, -np.pi) + np.minimum(upper, np.pi)) / 2
    rng = np.random.default_rng(0)
    seeds = [middle + 0.3 if nearby is None else nearby]
    seeds += [rng.uniform(np.maximum(lower, -np.pi), np.minimum(upper, np.pi)) for _ in range(20)]
    best = None
    for seed in seeds:
        found = least_squares(
            lambda q: residual(q, p).full().ravel() - goal,
            np.clip(seed, lower + 1e-9, upper - 1e-9),
            jac=lambda q: jacobian(q, p, 0)[0].full(),
            bounds=(lower, upper),
            xtol=1e-15,
            ftol=1e-15,
            gtol=1e-15,
        )
        if best is None or found.cost < best.cost:
            best = found
        if np.linalg.norm(best.fun) < REACHED:
            return np.asarray(best.x)
    assert best is not None  # there is always a seed
    shown, distance = ", ".join(f"{number:.4g}" for number in goal[:rows]), float(np.linalg.norm(best.fun[:rows]))
    unit = next(signal.unit for signal in diagram.loop.outputs if signal.label == label)
    angle = np.degrees(2 * np.arcsin(min(np.linalg.norm(best.fun[rows:]) / np.sqrt(8), 1.0)))
    oriented, away = (" with its orientation", f" and {angle:.3g} deg") if rows < len(goal) else ("", "")
    raise StartError(
        f"start: {label} cannot reach {desired} = [{shown}]{oriented}; the nearest pose is {plain(distance, unit)}"
        f"{away} away; "
        "move the path, or give the pose under start: {q: [...]}",
        path=("start",),
    )


def joint_goal(residual: Any, jacobian: Any, goal: np.ndarray, p: np.ndarray) -> np.ndarray | None:
    """Pose at a goal in joint coordinates, by Newton's method; None for other goals.

    In joint coordinates ``residual`` is affine in the pose with a regular matrix, so that the solution is unique. A
    goal in task coordinates has several solutions, and the seed of the search selects one.
    """
    symbols = [ca.SX.sym(name, residual.numel_in(place)) for place, name in enumerate(("pose", "p"))]
    if residual.numel_out(0) != residual.numel_in(0) or not ca.is_linear(residual(*symbols), symbols[0]):
        return None
    pose, matrix = np.zeros(residual.numel_in(0)), jacobian(np.zeros(residual.numel_in(0)), p, 0)[0].full()
    if not np.linalg.cond(matrix) < BEST:
        return None
    for _ in range(3):  # further steps reduce the rounding error of a long first step
        pose = pose + np.linalg.solve(matrix, goal - residual(pose, p).full().ravel())
    return pose if np.linalg.norm(residual(pose, p).full().ravel() - goal) < REACHED else None


def _near(near: Any, size: int) -> np.ndarray:
    numbers = _numbers(near)
    if numbers.shape not in ((), (size,)) or not np.all(np.isfinite(numbers)):
        text = f"start.{NEAR}: expected {size} finite numbers, found {numbers.size}"
        raise ValueFault(text, path=("start", NEAR))
    return np.broadcast_to(numbers, (size,))


def _limits(diagram: Diagram, size: int) -> tuple[np.ndarray, np.ndarray]:
    if diagram.robot is None or diagram.robot.n != size:
        return np.full(size, -np.inf), np.full(size, np.inf)
    joints = diagram.robot.joints
    return np.array([joint.lower for joint in joints]), np.array([joint.upper for joint in joints])


def _start_expressions(diagram: Diagram, values: dict[str, np.ndarray], made: Made, instants: Instants) -> None:
    """Evaluate the `start` expressions of the blocks, which may depend on the initial state of the plant."""
    loop, drawn = diagram.loop, instants.rows(0, 1)[0, DRAWN:]
    for variable, expression in in_order(diagram, [v for v in loop.variables if v.label not in values], made):
        if expression is None:
            values[variable.label] = np.zeros(variable.symbol.shape)
            continue
        known = [v for v in loop.variables if v.label in values]
        key = ("start", variable.label, *(v.label for v in known))
        function = once(made, key, partial(at_start, diagram, expression, known))
        now = function(0, loop.p_values, _column(known, values), drawn, instants.period)
        values[variable.label] = np.asarray(now.full().ravel())


def _goal(loop: ClosedLoop, wanted: Any) -> Any:
    """Function (t, p) -> trajectory."""
    return ca.Function("goal", [loop.time, loop.p], [ca.vec(loop.on_path(wanted))])


def _column(variables: Sequence[Variable], values: Mapping[str, np.ndarray]) -> np.ndarray:
    """Values as one column; matrices are column-major."""
    return np.concatenate([np.zeros(0), *(np.ravel(values[v.label], order="F") for v in variables)])


def evaluate(loop: ClosedLoop, expression: Any, values: Mapping[str, np.ndarray]) -> np.ndarray:
    """Value at t = 0 of an expression of states and parameters."""
    known = [v for v in loop.variables if v.label in values]
    inputs = [loop.time, loop.p, stack(v.symbol for v in known)]
    function = ca.Function("at_start", inputs, [ca.vec(expression)])
    return np.asarray(function(0, loop.p_values, _column(known, values)).full().ravel())
