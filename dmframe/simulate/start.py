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
from dmframe.simulate.keep import apart_of

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
    """Every state at t = 0, the controller's first, as one column.

    A state starts, in this order of precedence, where `given` says (by name, or by ``block.name``); at the block's
    parameter of the same name; where the block's `start` says; for a plant whose measured signal ``s`` follows a
    trajectory ``s_d``, where s = s_d(0), and the tool has the orientation of a task that gives one, the solution
    nearest to ``given["near"]``; at zero. A state with a box or
    a ball must start inside it. Diagrams that differ in numbers alone may share `made`, which is then filled. A block
    may start at what it measures: `instants` say what is drawn for the first tick; without them, zeros are.
    """
    loop, made = diagram.loop, {} if made is None else made
    variables = loop.variables
    values = fixed_starts(diagram, given)
    _onto_path(diagram, values, given.get(NEAR), made)
    for variable in loop.plant:
        if not has_start(diagram, variable, made):
            values.setdefault(variable.label, np.zeros(variable.symbol.shape))
    _as_blocks_say(diagram, values, made, instants or Instants.of(loop, 1.0))
    _check_finite(variables, values)
    _into_sets(loop, values)
    return _column(variables, values)


def pose_on_path(diagram: Diagram, given: Mapping[str, Any], made: Made, variable: Variable) -> np.ndarray:
    """Where a state begins that a trajectory decides: a part of `start_state`, with its faults."""
    values = fixed_starts(diagram, given)
    _onto_path(diagram, values, given.get(NEAR), made)
    return values[variable.label]


def fixed_starts(diagram: Diagram, given: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """The states that `given` or a parameter of their block says; see `start_state`."""
    values = given_starts(diagram, diagram.loop.variables, given)
    for variable in diagram.loop.variables:
        model = diagram.models[variable.block]
        if variable.label not in values and variable.name in model.values:
            values[variable.label] = model.values[variable.name]
    return values


def check_start(diagram: Diagram, given: Mapping[str, Any]) -> None:
    """Refuse start values of states that there are not, of another size or outside the joints' limits."""
    given_starts(diagram, diagram.loop.variables, given)
    for name in diagram.blocks:
        block_starts(diagram, name, {})


def _into_sets(loop: ClosedLoop, values: dict[str, np.ndarray]) -> None:
    """A start on the rim of its box or ball, missed by rounding, is put on it; one outside is a fault."""
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
    """The states that `given` says, by label. Raises `DmframeError` for what `check_start` refuses there."""
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
        values[found.label] = np.broadcast_to(numbers, shape).ravel(order="F")  # a matrix is kept as a column
        faults += _outside_limits(diagram, found, values[found.label], key)
    raise_all(faults)
    return values


def _other_units(diagram: Diagram, variable: Variable, value: Any, key: str) -> list[DmframeError]:
    """Numbers with a unit that is not the state's; of the joints' places and speeds, not that of the joint's kind."""
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
    """The value as an array; one of another shape than any state's where it holds no numbers."""
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
    """The plant's states that nothing else says and that a trajectory decides, each with what it follows.

    Where the tool's orientation is led too, its rows stand below those of the position.
    """
    open_states = [v for v in diagram.loop.plant if v.label not in known and not has_start(diagram, v, made)]
    for followed in diagram.loop.followed if open_states else ():
        used = [v for v in open_states if ca.depends_on(ca.vec(followed.found), ca.vec(v.symbol))]
        if len(used) == 1:
            yield turned(diagram, followed, used[0]), used[0]
            open_states.remove(used[0])


def turned(diagram: Diagram, followed: Followed, unknown: Variable) -> Followed:
    """A tool's position and goal with its orientation, where a block is to lead that too, as rotation matrices."""
    loop, apart, robot = diagram.loop, apart_of(diagram.loop), diagram.models[unknown.block].robot
    if apart is None or robot is None or followed.actual.rpartition(".")[2] != "x" or unknown.symbol.numel() != robot.n:
        return followed
    label = f"{apart.rpartition('.')[0]}.{TURNED}"
    wanted = [loop.on_path(ca.vec(signal.expression)) for signal in loop.outputs if signal.label == label]
    if not wanted or not symbols_in(wanted) <= symbols_in([loop.time, loop.p]):  # on a time of its own
        return followed
    found = ca.vec(robot.rotation(unknown.symbol))
    goal, place = ca.vertcat(ca.vec(followed.wanted), wanted[0]), ca.vertcat(ca.vec(followed.found), found)
    return Followed(followed.desired, followed.actual, goal, place)


def goal_and_place(loop: ClosedLoop, followed: Followed, unknown: Variable, made: Made) -> tuple[Any, Any]:
    """(t, p) -> where a trajectory is, and (state, p) -> where the plant is.

    Raises `StartError` where the path is on a time of its own.
    """
    if (source := followed.desired.partition(".")[0]) in loop.paced:
        text = f"start: expected {unknown.label}, found none; of a path whose time a block keeps, as that of {source}, "
        raise StartError(f"{text}the beginning is not looked for")
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
    """The pose at the goal, of which the first `rows` are no orientation."""
    p, size = diagram.loop.p_values, residual.size1_in(0)
    if not np.max(np.abs(goal), initial=0.0) < FARTHEST:  # nan too
        text = f"start: expected {desired} below {FARTHEST:g}, found {goal.tolist()}; take numbers nearer to 1"
        raise StartError(text, path=("start",))
    lower, upper = _limits(diagram, size)
    nearby = None if near is None else _near(near, size)
    alone = joint_goal(residual, jacobian, goal, p)
    if alone is not None and np.all((lower <= alone) & (alone <= upper)):
        return alone
    from scipy.optimize import least_squares  # takes as long to import as a short run takes

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
    shown, apart = ", ".join(f"{number:.4g}" for number in goal[:rows]), float(np.linalg.norm(best.fun[:rows]))
    unit = next(signal.unit for signal in diagram.loop.outputs if signal.label == label)
    angle = np.degrees(2 * np.arcsin(min(np.linalg.norm(best.fun[rows:]) / np.sqrt(8), 1.0)))
    led, away = (" with its orientation", f" and {angle:.3g} deg") if rows < len(goal) else ("", "")
    raise StartError(
        f"start: {label} cannot reach {desired} = [{shown}]{led}; the nearest pose is {plain(apart, unit)}{away} away; "
        "move the path, or give the pose under start: {q: [...]}",
        path=("start",),
    )


def joint_goal(residual: Any, jacobian: Any, goal: np.ndarray, p: np.ndarray) -> np.ndarray | None:
    """The pose at a goal that is given in the joints' own coordinates; None for one that is not.

    There ``residual`` is affine in the pose and its matrix is regular: one pose alone is at the goal, and Newton's
    method ends at it. A task's goal has several poses, of which the seed of a search chooses one.
    """
    symbols = [ca.SX.sym(name, residual.numel_in(place)) for place, name in enumerate(("pose", "p"))]
    if residual.numel_out(0) != residual.numel_in(0) or not ca.is_linear(residual(*symbols), symbols[0]):
        return None
    pose, matrix = np.zeros(residual.numel_in(0)), jacobian(np.zeros(residual.numel_in(0)), p, 0)[0].full()
    if not np.linalg.cond(matrix) < BEST:
        return None
    for _ in range(3):  # again: a long first step is rounded
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


def _as_blocks_say(diagram: Diagram, values: dict[str, np.ndarray], made: Made, instants: Instants) -> None:
    """Evaluate the blocks' own starts, which may depend on the plant's pose and rest."""
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
    """(t, p) -> a trajectory."""
    return ca.Function("goal", [loop.time, loop.p], [ca.vec(loop.on_path(wanted))])


def _column(variables: Sequence[Variable], values: Mapping[str, np.ndarray]) -> np.ndarray:
    """Values as one column, a matrix column by column, as which one may be kept already."""
    return np.concatenate([np.zeros(0), *(np.ravel(values[v.label], order="F") for v in variables)])


def evaluate(loop: ClosedLoop, expression: Any, values: Mapping[str, np.ndarray]) -> np.ndarray:
    """An expression of states and parameters at t = 0."""
    known = [v for v in loop.variables if v.label in values]
    inputs = [loop.time, loop.p, stack(v.symbol for v in known)]
    function = ca.Function("at_start", inputs, [ca.vec(expression)])
    return np.asarray(function(0, loop.p_values, _column(known, values)).full().ravel())
