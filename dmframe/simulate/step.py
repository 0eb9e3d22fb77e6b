"""One tick of the closed loop as one CasADi function: the sampled controller over the continuous plant.

Within a tick from t_k = k T to t_{k+1}, in this order, with a sampled clock:

1. the trajectories and what the plant measures are read at t_k;
2. the controller's outputs follow from them and from its states at t_k;
3. its states advance by one explicit Euler step of length T, and are then projected onto their sets;
4. the plant runs to t_{k+1} with the commands held (zero-order hold).

With a continuous clock controller and plant are integrated together, and a tick only says how often to log.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal, final, get_args

import casadi as ca
import numpy as np

from dmframe.certificate import SX
from dmframe.diagram import ClosedLoop
from dmframe.diagram.closed_loop import columns, stack
from dmframe.diagram.parts import Parts
from dmframe.errors import EngineError, ValueFault
from dmframe.port import Side

Method = Literal["rk4", "cvodes"]
"""Fixed-step fourth-order Runge-Kutta, or SUNDIALS' variable-step backward differentiation."""

RK4_STABLE = 2.785
"""Classical RK4 is stable on the negative real axis for h |lambda| below this [Hairer1996]_."""

MOST_SUBSTEPS = 2000
"""Steps of rk4 in a tick; they are written out one by one in the tick's function."""


PLAIN_STEP = 0.001
"""The longest step of rk4 where nothing says otherwise [s]."""


@final
@dataclass(frozen=True)
class Solver:
    """How the continuous part is integrated.

    Parameters
    ----------
    method
        ``rk4`` or ``cvodes``.
    step
        Of rk4, the longest step [s]; a tick is divided into equal ones. None: `PLAIN_STEP`, or less where the plant is
        too stiff for it.
    output
        With a continuous clock, how often a result is kept [s].
    tolerance
        Of cvodes, relative; absolute is a thousandth of it.
    """

    method: Method = "rk4"
    step: float | None = None
    output: float = 0.01
    tolerance: float = 1e-9

    def __post_init__(self) -> None:
        """Refuse what cannot integrate."""
        if self.method not in get_args(Method):
            raise ValueFault(f"solver.method: expected {' or '.join(get_args(Method))}, found {self.method!r}")
        for name in ("step", "output", "tolerance"):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value > 0):
                raise ValueFault(f"solver.{name}: expected a positive number, found {value}")


@final
@dataclass(frozen=True)
class Step:
    """The tick's functions, all with the parameters p as a column; the state holds the controller's part first.

    Parameters
    ----------
    parts
        What the tick is made of.
    rate
        (state, t, p) -> the plant's rate with the commands of that instant.
    solver
        How the plant is integrated.
    period
        T [s].
    substeps
        Integrator steps in a tick.
    bounds
        How large each state may get; beyond it the run has blown up.
    """

    parts: Parts
    rate: Any
    solver: Solver
    period: float
    substeps: int
    bounds: np.ndarray

    @cached_property
    def tick(self) -> Any:
        """(state, k, p) -> (state at (k + 1) T, recorded outputs at k T as one column), for the interpreter."""
        return _tick(self.parts, self.solver, self.period, self.substeps)

    @cached_property
    def outputs(self) -> Any:
        """(state, t, p) -> recorded outputs as one column."""
        parts, (state, t, p) = self.parts, _columns_of(self.parts)
        return ca.Function("recorded", [state, t, p], [parts.outputs(state, parts.trajectory(t, p), p)])

    def with_period(self, period: float) -> Step:
        """The same with another period [s], in one step of the integrator."""
        return replace(self, period=period, substeps=1, solver=Solver(step=period))

    def recording(self, rows: np.ndarray) -> Step:
        """The same, but of the recorded outputs only some."""
        state, _, p = (ca.SX.sym("of", symbol.shape) for symbol in _columns_of(self.parts))
        w = ca.SX.sym("w", self.parts.outputs.numel_in(1))
        some = ca.Function("outputs", [state, w, p], [self.parts.outputs(state, w, p)[rows.tolist()]])
        return replace(self, parts=replace(self.parts, outputs=some))


def build_step(
    loop: ClosedLoop, clock: float | None, solver: Solver, recorded: SX, bounds: np.ndarray | None = None
) -> Step:
    """The tick of a closed loop on a clock, or in continuous time where `clock` is None.

    Without `bounds`, a state may be any finite number.
    """
    period = clock if clock is not None else solver.output
    substeps = substeps_of(clock, solver)
    parts = build_parts(loop, clock, recorded)
    measured = _function("plant_rate", loop, [loop.state], [stack(variable.rate for variable in loop.plant)])
    state, t, p = _columns_of(parts)
    rate = ca.Function("rate", [state, t, p], [measured(state, parts.trajectory(t, p), p)])
    most = np.full(loop.state.numel(), np.finfo(float).max) if bounds is None else bounds
    return Step(parts, rate, solver, period, substeps, most)


def build_parts(loop: ClosedLoop, clock: float | None, recorded: SX) -> Parts:
    """The functions of a closed loop's tick; without a clock everything is integrated, and nothing is commanded."""
    every, sampled = (*loop.controller, *loop.plant), clock is not None
    integrated = stack(v.symbol for v in (loop.plant if sampled else every))
    held, command = columns([leaf for leaf in loop.crossings if sampled and leaf.side is Side.CONTROLLER])
    advanced = stack(variable.rate for variable in loop.controller if sampled)
    if sampled:
        (rate,) = project(loop, [stack(variable.rate for variable in loop.plant)], joined=False)
    else:
        (rate,) = project(loop, loop.joined([stack(variable.rate for variable in every)]))
    (rate,) = _pruned(loop, [rate])
    _, meanings = columns(loop.trajectories)
    return Parts(
        trajectory=ca.Function("trajectory", [loop.time, loop.p], [ca.vertcat(meanings, loop.time)]),
        control=_function("control", loop, [loop.state], [advanced, command]),
        rate=ca.Function("plant", [integrated, held, _signals(loop), loop.p], [ca.cse(rate)]),
        outputs=_function("outputs", loop, [loop.state], [recorded]),
        clip=ca.Function("clip", [loop.state, loop.p], [inside(loop, loop.state)]),
    )


def substeps_of(clock: float | None, solver: Solver) -> int:
    """Integrator steps in a tick. Raises `EngineError` where they are too many to write out."""
    if solver.method != "rk4":
        return 1
    period = clock if clock is not None else solver.output
    if solver.step is None:
        return min(MOST_SUBSTEPS, max(1, math.ceil(round(period / PLAIN_STEP, 9))))
    steps = period / solver.step
    if steps > MOST_SUBSTEPS * (1 + 1e-9):
        tick, shorter = ("", "a shorter clock") if clock is not None else ("solver.output, ", "a shorter output")
        raise EngineError(
            f"solver.step: expected at most {MOST_SUBSTEPS} steps in a tick of {tick}{period:g} s, found {steps:.3g}; "
            f"take a longer step, {shorter}, or solver.method cvodes",
            path=("solver", "step"),
        )
    return max(1, math.ceil(round(steps, 9)))


def _columns_of(parts: Parts) -> tuple[Any, Any, Any]:
    """State, t and p."""
    return ca.MX.sym("state", parts.control.numel_in(0)), ca.MX.sym("t"), ca.MX.sym("p", parts.control.numel_in(2))


def _function(name: str, loop: ClosedLoop, inputs: list[SX], expressions: list[SX]) -> Any:
    """Joined expressions as a function of (inputs..., w, p); projections act as their law says."""
    joined = _pruned(loop, project(loop, loop.joined(expressions)))
    return ca.Function(name, [*inputs, _signals(loop), loop.p], ca.cse(joined))


def _pruned(loop: ClosedLoop, expressions: list[SX]) -> list[SX]:
    """Without the terms of the robot's numbers that are zero: a file has many, and no run changes them."""
    zeros = [
        p.symbol.nz[k]
        for p in loop.parameters
        if p.label.startswith("robot.")
        for k in np.flatnonzero(p.value.ravel(order="F") == 0)
    ]
    return list(ca.substitute(expressions, [ca.vertcat(*zeros)], [ca.SX.zeros(len(zeros))])) if zeros else expressions


def _signals(loop: ClosedLoop) -> SX:
    """w: what moves by itself, the trajectories and, for blocks that read it, the time."""
    return stack([*(leaf.symbol for leaf in loop.trajectories), loop.time])


def project(loop: ClosedLoop, expressions: list[SX], *, joined: bool = True) -> list[SX]:
    """Put in each projection's correction: it stops a rate that leads out of the set at the set's end.

    Not `joined`, a correction keeps the crossings as leaves, as the rates of one side alone need it.
    """
    for projection in reversed(loop.projections):
        correction = projection.law
        if joined:
            correction = loop.joined([correction])[0]
        expressions = list(ca.substitute(expressions, [projection.correction], [correction]))
    return expressions


def inside(loop: ClosedLoop, state: SX) -> SX:
    """A column of states projected onto their boxes and balls."""
    for projection in loop.projections:
        state = ca.substitute(state, projection.state, projection.set.held(projection.state))
    return state


def _tick(parts: Parts, solver: Solver, period: float, substeps: int) -> Any:
    """(state, k, p) -> the state one tick later, and what is recorded before it, for the interpreter."""
    state, k, p = _columns_of(parts)
    t, hoisted = k * period, parts.hoisted
    c = hoisted.constants(p)
    dz, u, recorded = hoisted.sample(state, hoisted.trajectory(t, p, c), p, c)
    z, x = ca.vertsplit(state, [0, dz.numel(), state.numel()])
    if solver.method == "cvodes":
        x = _cvodes(parts, x, t, u, p, solver, period)
    else:
        x = _rk4(parts, x, t, u, p, c, period / substeps, substeps)
    return ca.Function("tick", [state, k, p], [hoisted.clip(ca.vertcat(z + period * dz, x), p, c), recorded])


def _rk4(parts: Parts, x: Any, t: Any, u: Any, p: Any, c: Any, h: float, substeps: int) -> Any:
    hoisted, moved = parts.hoisted, parts.moved
    still = ca.MX.zeros(hoisted.rate.size1_in(2))

    def at(x: Any, t: Any) -> Any:
        return hoisted.rate(x, u, hoisted.trajectory(t, p, c) if moved else still, p, c)

    half, whole, sixth = ca.MX(h / 2), ca.MX(h), ca.MX(h / 6)
    for j in range(substeps):
        now = t + j * h
        k1 = at(x, now)
        k2 = at(x + half * k1, now + h / 2)
        k3 = at(x + half * k2, now + h / 2)
        k4 = at(x + whole * k3, now + h)
        x = x + sixth * (k1 + 2 * (k2 + k3) + k4)
    return x


def _cvodes(parts: Parts, x: Any, t: Any, u: Any, p: Any, solver: Solver, period: float) -> Any:
    if not ca.has_integrator("cvodes"):
        raise EngineError("solver: CasADi was built without SUNDIALS' cvodes; choose method: rk4")
    rate = parts.rate
    state, since = ca.MX.sym("x", rate.size1_in(0)), ca.MX.sym("since")
    held = ca.MX.sym("held", rate.size1_in(1) + 1 + p.numel())
    commands, start, numbers = ca.vertsplit(held, [0, rate.size1_in(1), rate.size1_in(1) + 1, held.numel()])
    ode = rate(state, commands, parts.trajectory(start + since, numbers), numbers)
    problem = {"x": state, "t": since, "p": held, "ode": ode}
    options = {"reltol": solver.tolerance, "abstol": solver.tolerance * 1e-3, "max_num_steps": 10_000}
    integrator = ca.integrator("integrator", "cvodes", problem, 0, period, options)
    return integrator(x0=x, p=ca.vertcat(u, t, p))["xf"]
