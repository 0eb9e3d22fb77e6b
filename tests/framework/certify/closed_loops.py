"""Closed loops to verify: every servo with every reference generator, on a planar arm and on a chain with odd axes."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin

from dmframe.block import AbstractBlock
from dmframe.block.port import Side
from dmframe.catalogue import block_types
from dmframe.certify import Claim
from dmframe.diagram import Diagram
from dmframe.diagram.closed_loop import stack
from dmframe.graph.graph import Graph
from dmframe.robot.chain import SerialChain
from dmframe.robot.library import load
from dmframe.simulate.solver import Solver
from dmframe.simulate.step import build_step

sys.path.append(str(Path(__file__).parents[1]))  # as in a command, the search path is this folder only
from structures import packaged

Spec = tuple[str, Mapping[str, Any]]
"""A block's type and its parameters."""


@cache
def known_blocks() -> dict[str, type[AbstractBlock]]:
    """The catalogue, read once."""
    return block_types()


FILTERS = {"safe_reference": "dq_wish"}
"""Types of blocks behind which the signal of this input is no longer the tracked one."""


def counting(types: Mapping[str, str], wires: Mapping[str, str]) -> set[str]:
    """The types of the blocks, without those whose certificates a filter removes."""
    ends = (f"{name}.{FILTERS[kind]}" for name, kind in types.items() if kind in FILTERS)
    silent = {wires[end].partition(".")[0] for end in ends if end in wires}
    return {kind for name, kind in types.items() if name not in silent}


class Built:
    """The robot, blocks and wires of a loop."""

    name: str
    robot: Any
    specs: Mapping[str, Spec]
    wires: Mapping[str, str]

    @property
    def start(self) -> Mapping[str, Any]:
        """The initial values of a graph, at which some conditions are decided."""
        return {}

    @property
    def types(self) -> set[str]:
        """The blocks whose certificates count; without those of which a filter changes the output."""
        return counting({name: kind for name, (kind, _) in self.specs.items()}, self.wires)

    def build(
        self, mutants: Mapping[str, Any] | None = None, mutated: Callable[..., type[AbstractBlock]] | None = None
    ) -> Diagram:
        """The diagram, with a fault in the blocks of some types."""
        known, blocks = known_blocks(), dict[str, AbstractBlock]()
        for name, (kind, values) in self.specs.items():
            block = known[kind]
            if mutants and mutated and kind in mutants:
                block = mutated(block, mutants[kind])
            blocks[name] = block(**values)
        return Diagram.build(blocks, self.wires, self.robot)

    @cached_property
    def diagram(self) -> Diagram:
        return self.build()


@dataclass(frozen=True, eq=False)
class Loop(Built):
    """A closed loop that is to be proved."""

    name: str
    robot: Any
    specs: Mapping[str, Spec]
    wires: Mapping[str, str] = field(default_factory=dict)


class PackagedLoop(Built):
    """A packaged graph's loop, read when it is built: only its name is needed in a list."""

    def __init__(self, name: str) -> None:
        self.name = name

    @cached_property
    def _graph(self) -> Any:
        return Graph.read(self.name)

    @property
    def robot(self) -> Any:  # type: ignore[override]
        return self._graph.robot

    @property
    def start(self) -> Mapping[str, Any]:
        start: Mapping[str, Any] = self._graph.start
        return start

    @property
    def wires(self) -> Mapping[str, str]:  # type: ignore[override]
        wires: Mapping[str, str] = self._graph.file.wires
        return wires

    @cached_property
    def specs(self) -> Mapping[str, Spec]:  # type: ignore[override]
        blocks = self._graph.data["blocks"]
        return {block: (str(entry["type"]), _parameters(entry)) for block, entry in blocks.items()}


def odd_chain(n: int, seed: int, axes: str = "xyz", kinds: Sequence[str] = ()) -> SerialChain:
    """Joints about axes without zero coordinates, none at a right angle to the previous one."""
    rng = np.random.default_rng(seed)
    model, parent = pin.Model(), 0
    model.name = f"odd{n}"
    model.gravity.linear = rng.normal(size=3)
    for i in range(n):
        axis = rng.normal(size=3)
        axis /= np.linalg.norm(axis)
        slides = bool(kinds) and kinds[i] == "prismatic"
        joint = pin.JointModelPrismaticUnaligned(axis) if slides else pin.JointModelRevoluteUnaligned(axis)
        placement = pin.SE3(pin.exp3(rng.normal(size=3)), rng.normal(size=3))
        parent = model.addJoint(parent, joint, placement, f"joint{i + 1}")
        model.addJointFrame(parent)
        inertia = pin.Inertia.FromEllipsoid(rng.uniform(0.5, 5), *rng.uniform(0.05, 0.5, size=3))
        model.appendBodyToJoint(parent, inertia, pin.SE3(np.eye(3), rng.normal(size=3)))
    return SerialChain.from_model(model, tool=list(rng.normal(size=3)), axes=axes)


FRICTION = {"both": ("viscous", "coulomb"), "viscous": ("viscous",), "coulomb": ("coulomb",), "none": ()}


def loop_of(
    robot: Any, task: str, servo: str, *, friction: str = "both", boxes: bool = False, source: str = ""
) -> Loop:
    """{task, joint} x {PI, PID}."""
    n, m = robot.n, robot.m
    source = source or {"task": "circle" if m > 1 else "setpoint", "joint": "sinusoid"}[task]
    specs = {"path": (source, _path(source, task, n, m))}
    if task == "task":
        specs |= {"geometry": ("kinematics", {}), "task": ("known_tracking", {"gamma": 0.8})}
    else:
        specs |= {"task": ("joint_tracking", {"alpha_bar": 2})}
    kinds = FRICTION[friction]
    compensator = {"Gamma": 1} | ({"a_d_hat_box": [-1e6, 1e6]} if boxes else {})
    specs |= {"model": ("regressor", {"friction": kinds}), "dynamics": ("dynamic_compensator", compensator)}
    if servo == "PI":
        box = {"w_box": [0, 1], "w_I_box": [0.5, 20]} if boxes else {}
        specs["inverse"] = ("pi_inverse", {"Lambda": 0.01, "Lambda_I": 1, "w_I": 2} | box)
        specs["servo"] = ("pi_servo", {"K_P": 60, "K_I": 240})
    else:
        box = {"w_box": [0, 1], "w_P_box": [1, 3], "w_I_box": [0.5, 2]} if boxes else {}
        gains = {"K_c": 0.8, "Lambda": 0.01, "Lambda_P": 10, "Lambda_I": 10, "w_P": 2, "w_I": 0.6}
        specs["inverse"] = ("pid_inverse", gains | box)
        specs["servo"] = ("pid_servo", {"K_D": 80, "K_P": 176, "K_I": 56})
    arm = {"K": 1.5} | dict.fromkeys(kinds, 2.0)
    specs["arm"] = ("manipulator", arm)
    return Loop(f"{robot.name} {task} {servo}", robot, specs)


def _path(source: str, task: str, n: int, m: int) -> dict[str, Any]:
    name, size = ("x_d", m) if task == "task" else ("q_d", n)
    if source == "circle":
        return {"center": [0.3] * m, "radius": 0.1, "rate": 1.1}
    if source == "sinusoid":
        return {"center": [0.3] * n, "amplitude": 0.2, "rate": 1.3, "phase": 0.4}
    if source == "setpoint":
        return {name: [0.3] * size}
    return {"times": [0, 2, 5], name: [[0.1] * size, [0.4] * size, [0.2] * size]}


@cache
def loops() -> tuple[Built, ...]:
    """The loops for every fault of the mutation suite; one of each pair if a fault belongs to one only."""
    return tuple(_loops())


def _loops() -> Iterator[Built]:
    robots = (load("arm2"), odd_chain(3, 5, "xy"))
    sources = {"task": ("circle", "setpoint"), "joint": ("sinusoid", "waypoints")}
    for robot in robots:
        for task in ("task", "joint"):
            for servo, source in zip(("PI", "PID"), sources[task], strict=True):
                yield loop_of(robot, task, servo, source=source, boxes=robot.n == 3)
    yield _fitted(robots[0])
    yield _robust(robots[0])
    yield _rotors(robots[0])
    yield from _full(robots[0])
    yield _posture(load("arm2", axes="x"))
    further = (_contact(robots[0]), _loaded(robots[0]), _grasping(robots[0]))
    yield from further
    held = {kind for loop in further for kind in loop.types}
    yield from _packaged(held | {"circle", "setpoint", "sinusoid", "waypoints", "null_space_posture"})


def _fitted(robot: Any) -> Loop:
    """Kinematics estimated by least squares with forgetting: an option that no default graph uses."""
    known = loop_of(robot, "task", "PI").specs
    fitted: dict[str, Spec] = {
        "geometry": ("adaptive_kinematics", {"Gamma_k": 2, "start_error": 0.03, "R": 5, "forgetting": 0.2}),
        "observer": ("task_observer", {"beta": 2}),
        "task": ("observed_tracking", {"gamma": 2}),
    }
    return Loop(f"{robot.name} fitted kinematics PI", robot, {**known, **fitted})


ADAPTATION = frozenset(("R", "forgetting", "leak", "error_leak", "dead_zone"))
"""Parameters that change the law of an estimate."""


def _robust(robot: Any) -> Loop:
    """Leaks and a dead zone, which no default graph has."""
    known = loop_of(robot, "joint", "PI").specs
    options: dict[str, Spec] = {
        "dynamics": ("dynamic_compensator", {"Gamma": 1, "leak": 0.2, "dead_zone": 0.1}),
        "inverse": ("pi_inverse", {**known["inverse"][1], "error_leak": 0.3}),
    }
    return Loop(f"{robot.name} leaks and dead zone PI", robot, {**known, **options})


def _rotors(robot: Any) -> Loop:
    """Rotor inertia in plant and regressor, and position feedback of the reference, which no packaged graph has."""
    known = loop_of(robot, "joint", "PI").specs
    options: dict[str, Spec] = {
        "model": ("regressor", {**known["model"][1], "rotors": True, "bias": True}),
        "inverse": ("pi_inverse", {**known["inverse"][1], "K_c": 0.8}),
        "arm": ("manipulator", {**known["arm"][1], "rotor": 0.3}),
    }
    return Loop(f"{robot.name} rotors PI", robot, {**known, **options})


def _posture(robot: Any) -> Loop:
    """The smallest redundant robot: two joints for one coordinate."""
    known = loop_of(robot, "task", "PI").specs
    posture = {"posture": ("null_space_posture", {"K_null": 0.5, "q_0": [0.3, 0.4]})}
    return Loop(f"{robot.name} posture PI", robot, {**known, **posture})


def _contact(robot: Any) -> Loop:
    """A tool in contact with a compliant wall."""
    known = loop_of(robot, "task", "PID").specs
    contact: dict[str, Spec] = {
        "compliance": ("admittance", {"M_a": 10, "D_a": 200, "K_a": 400}),
        "wall": ("wall", {"point": [0.3, 0.3], "normal": [-3, -4], "stiffness": 1000, "damping": 100}),
    }
    return Loop(f"{robot.name} contact PID", robot, {**known, **contact}, {"task.x_d": "compliance.x_c"})


def _loaded(robot: Any) -> Loop:
    """A load whose parameters are unknown to the controller."""
    known = loop_of(robot, "joint", "PI").specs
    load: dict[str, Spec] = {
        "model": ("payload_regressor", {"gravity": "share", "friction": FRICTION["both"]}),
        "holds": ("payload_estimate", {}),
        "arm": ("loaded_manipulator", {"K": 1.5, "viscous": 2.0, "coulomb": 2.0}),
        "load": ("payload", {"mass": [1, 0], "at": [1, 2]}),
    }
    return Loop(f"{robot.name} loaded PI", robot, {**known, **load})


def _grasping(robot: Any) -> Loop:
    """The same with a gripper that reports the load and its parameters."""
    gripper: dict[str, Spec] = {
        "dynamics": ("reset_compensator", {"Gamma": 3, "clearing": 2}),
        "gripper": ("gripper", {"at": [1, 2], "mass": [0.5, 0]}),
    }
    return Loop(f"{robot.name} grasping PI", robot, {**_loaded(robot).specs, **gripper})


FULL = "full gains"


def _full(robot: Any) -> Iterator[Loop]:
    """The adaptation gains as full matrices, with and without forgetting; no default graph has them."""
    fitted, known = _fitted(robot).specs, loop_of(robot, "joint", "PI").specs
    gain, gain_k = _positive(12 * robot.n), _positive(3 * (robot.n + 1))
    geometry = {**fitted["geometry"][1], "Gamma_k": gain_k}
    yield Loop(f"{robot.name} {FULL} fitted", robot, {**fitted, "geometry": ("adaptive_kinematics", geometry)})
    yield Loop(f"{robot.name} {FULL}", robot, {**known, "dynamics": ("dynamic_compensator", {"Gamma": gain})})


def _positive(n: int) -> list[list[float]]:
    root = np.random.default_rng(n).normal(size=(n, n))
    matrix = root @ root.T / n + np.eye(n)
    rows: list[list[float]] = ((matrix + matrix.T) / 2).tolist()
    return rows


def _packaged(held: set[str]) -> Iterator[Built]:
    """A packaged graph for each block that no other loop contains, so new blocks are included automatically."""
    blocks = known_blocks()
    held = held | loop_of(load("arm2"), "task", "PI").types | loop_of(load("arm2"), "joint", "PID").types
    for name, data in sorted(packaged().items()):
        named = {block: str(entry["type"]) for block, entry in data["blocks"].items()}
        types = counting(named, data.get("wires", {}))
        claims = all("certificate" in vars(blocks[kind]) or blocks[kind].side is Side.SOURCE for kind in named.values())
        if not types - held or not claims:
            continue
        held |= types
        yield PackagedLoop(name)


def _parameters(entry: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in entry.items() if key != "type"}


# Independent evaluation of dV/dt: the rates come from the functions of a run, the derivatives of V from reverse mode.

PERIOD = 1e-3


def field_of(diagram: Diagram) -> Callable[[np.ndarray, float], np.ndarray]:
    """Rates of all states at (state, t), from the simulation's functions, inside the boxes."""
    loop = diagram.loop
    split = sum(variable.symbol.numel() for variable in loop.controller)
    p = _unbounded(diagram)
    periods = [PERIOD]
    if any(variable.own_second is not None for variable in loop.controller):  # a step has T^2 terms
        periods.append(2 * PERIOD)
    steps = [build_step(loop, period, Solver(step=period), ca.SX(0, 1)) for period in periods]

    def rates(state: np.ndarray, t: float) -> np.ndarray:
        moved = [
            (step.tick(state, [t, period], p)[0].full().ravel() - state)[:split] / period
            for step, period in zip(steps, periods, strict=True)
        ]
        own = moved[0] if len(moved) == 1 else 2 * moved[0] - moved[1]
        return np.concatenate([own, steps[0].rate(state, t, p).full().ravel()])

    return rates


def _unbounded(diagram: Diagram) -> np.ndarray:
    """The parameters with boxes so wide that no sample leaves them, for any rates."""
    boxes = {projection.parameter for projection in diagram.loop.projections}
    values = []
    for parameter in diagram.loop.parameters:
        value = np.array(parameter.value, dtype=float)
        if parameter.label in boxes:
            value[..., 0], value[..., 1] = -1e15, 1e15
        values.append(value.ravel(order="F"))
    return np.concatenate(values)


def states_of(diagram: Diagram, count: int, seed: int) -> Iterator[tuple[np.ndarray, float]]:
    """Random states, with those of a box well inside it, and times."""
    rng, loop = np.random.default_rng(seed), diagram.loop
    boxes = {p.label: p.value for p in loop.parameters}
    held = {projection.name: boxes[projection.parameter] for projection in loop.projections}
    for _ in range(count):
        parts = []
        for variable in loop.variables:
            size = variable.symbol.numel()
            share = rng.uniform(-1, 1, size)
            if variable.label in held:
                lower, upper = (np.clip(end, -5, 5) for end in held[variable.label].T)
                share = (lower + upper) / 2 + 0.45 * (upper - lower) * share
            parts.append(share)
        yield np.concatenate(parts), rng.uniform(0.1, 4.9)


def true_in_numbers(diagram: Diagram, claim: Claim, tolerance: float = 1e-8) -> bool:
    """True if dV/dt + dissipation - cross terms - residual is zero, up to rounding, with the rates of a run.

    Raises `FloatingPointError` if it has no value at the graph's numbers.
    """
    loop, kappa = diagram.loop, ca.SX.sym("kappa")
    weigh = claim.kappa if not claim.kappa.is_constant() else kappa
    spent = [claim.weight(part) * part.dissipation for part in claim.parts]
    corrections = stack(projection.correction for projection in loop.projections)

    def of_time(expression: Any) -> Any:
        inside = ca.substitute(ca.SX(expression), corrections, ca.SX.zeros(corrections.shape))
        return loop.on_path(inside)

    V = of_time(claim.V)
    slopes = [ca.gradient(V, loop.state), ca.gradient(V, loop.time)]
    left = [claim.weight(part) * part.residual for part in claim.parts]
    rest = ca.vertcat(
        *(of_time(term) for term in spent), -of_time(claim.consumption), -of_time(ca.sum1(ca.vertcat(*left)))
    )
    inputs = [loop.state, loop.time, loop.p, weigh]
    try:
        function = ca.Function("V", inputs, [*slopes, rest])
    except RuntimeError:  # a trajectory's derivative that the run does not need
        return False
    rates = field_of(diagram)
    for state, t in states_of(diagram, 4, 3):
        slope, by_time, others = (np.ravel(x.full()) for x in function(state, t, loop.p_values, 0.7))
        terms = np.concatenate([slope * rates(state, t), by_time, others])
        if not np.isfinite(terms).all():
            raise FloatingPointError("dV/dt has no value at the graph's numbers")
        if not abs(terms.sum()) <= tolerance * np.abs(terms).sum():
            return False
    return True


def negative_in_numbers(diagram: Diagram, claim: Claim) -> list[str]:
    """The terms of V and of the dissipation that are negative at a random state, by block and place."""
    terms = {
        f"{part.block}, {role} {place}": ca.SX(term.value)
        for part in claim.parts
        for role, found in (("storage", part.certificate.storage), ("dissipation", part.certificate.dissipation))
        for place, term in enumerate(found, start=1)
    }
    loop = diagram.loop
    values = loop.on_path(ca.vertcat(*terms.values()))
    function = ca.Function("terms", [loop.state, loop.time, loop.p], [values])
    points = [function(state, t, loop.p_values).full().ravel() for state, t in states_of(diagram, 8, 5)]
    return [name for name, values in zip(terms, np.transpose(points), strict=True) if (values < -1e-9).any()]


def same_field(diagram: Diagram, other: Diagram) -> bool:
    """True if two closed loops have the same rates, up to rounding, at random states."""
    mine, theirs = field_of(diagram), field_of(other)
    if diagram.loop.state.numel() != other.loop.state.numel():
        return False
    return all(
        np.allclose(mine(state, t), theirs(state, t), rtol=1e-9, atol=1e-9) for state, t in states_of(diagram, 3, 4)
    )
