"""One sampling period (tick) of the closed loop as a CasADi function: sampled controller, continuous plant.

With a sampling period, a tick from t_k to t_{k+1} is:

1. trajectories, measurements and random numbers of the tick are evaluated at t_k;
2. outputs are evaluated from these and from the states at t_k;
3. discrete-time states take their next values; continuous-time controller states advance by one explicit Euler step of
   length T; all are projected onto their sets (`ClosedLoop.advanced`);
4. the plant is integrated to t_{k+1} with its inputs held (zero-order hold).

Without a sampling period, controller and plant are integrated together, and a tick is the interval of recording.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from typing import Any, final

import casadi as ca
import numpy as np

from dmframe.block.certificate import SX
from dmframe.block.linalg import nodes
from dmframe.common.errors import EngineError
from dmframe.diagram import ClosedLoop
from dmframe.diagram.closed_loop import columns, stack
from dmframe.diagram.parts import Parts
from dmframe.diagram.rosenbrock import ROS34PW2
from dmframe.simulate.block_starts import once
from dmframe.simulate.instants import DRAWN, LENGTH, TIME, Instants
from dmframe.simulate.solver import Solver, substeps_of

EXPANDED = 30_000
"""Largest number of instructions in a tick whose function is expanded; above, expansion takes longer than it saves."""


@final
@dataclass(frozen=True)
class Step:
    """Functions of a tick, with parameters p as a column; the controller states come first.

    Parameters
    ----------
    parts
        Functions that compose the tick.
    rate
        (state, t, p) -> rates of the plant, with the commands of that instant and without random numbers.
    solver
        Integrator of the plant.
    instants
        Times and random numbers of ticks.
    substeps
        Integrator steps in a tick.
    bounds
        Bounds of the states; beyond them a run has diverged.
    """

    parts: Parts
    rate: Any
    solver: Solver
    instants: Instants
    substeps: int
    bounds: np.ndarray

    @property
    def period(self) -> float:
        """T [s]."""
        return self.instants.period

    @property
    def implicit(self) -> bool:
        """True if each step solves linear systems."""
        return self.solver.method == "ros34pw2"

    @property
    def length(self) -> float:
        """h, the integrator's step in the longest tick [s]."""
        return self.instants.longest / self.substeps

    @cached_property
    def tick(self) -> Any:
        """(state, given, p) -> (state at the next tick, recorded outputs as one column), for the interpreter.

        `given` is the tick's row of `Instants`, as a column.
        """
        made = _tick(self.parts, self.solver, self.instants, self.substeps)
        rates = 4 * self.substeps * (self.parts.rate.n_instructions() + self.parts.trajectory.n_instructions())
        # expanded to scalar operations, the same results take three quarters of the time
        return made.expand() if self.solver.method == "rk4" and rates <= EXPANDED else made

    @cached_property
    def outputs(self) -> Any:
        """(state, given, p) -> recorded outputs as one column."""
        parts, (state, given, p) = self.parts, _columns_of(self.parts)
        w = parts.trajectory(given[TIME], p)
        return ca.Function("recorded", [state, given, p], [parts.outputs(state, w, given[DRAWN:], self.period, p)])

    def solved_by(self, solver: Solver, clock: float | None) -> Step:
        """The step with another solver."""
        longest = None if clock is None else self.instants.longest
        return replace(self, solver=solver, substeps=substeps_of(longest, solver))

    def with_period(self, period: float) -> Step:
        """The step with another period [s] and one integrator step per tick."""
        instants = replace(self.instants, period=period, jitter=0.0)
        return replace(self, instants=instants, substeps=1, solver=replace(self.solver, step=period))

    def recording(self, rows: np.ndarray) -> Step:
        """The step with only these rows of the recorded outputs."""
        outputs = self.parts.outputs
        seen = [ca.SX.sym("of", outputs.size_in(i)) for i in range(outputs.n_in())]
        some = ca.Function("outputs", seen, [outputs(*seen)[rows.tolist()]])
        return replace(self, parts=replace(self.parts, outputs=some))


def build_step(
    loop: ClosedLoop,
    clock: float | None,
    solver: Solver,
    recorded: SX,
    bounds: np.ndarray | None = None,
    *,
    seed: int = 0,
    jitter: float = 0.0,
) -> Step:
    """Step of a closed loop with sampling period `clock` [s], or in continuous time if it is None.

    Without `bounds`, only non-finite states count as divergence.
    """
    instants = Instants.of(loop, clock if clock is not None else solver.output, seed, jitter)
    substeps = substeps_of(None if clock is None else instants.longest, solver)
    parts = build_parts(loop, clock, recorded)
    flowing = once(
        loop.derived, ("flowing",), lambda: _evaluated("flowing", loop, [stack(loop.rates_of(loop.flowing))])
    )
    state, t, p = ca.MX.sym("state", loop.state.numel()), ca.MX.sym("t"), ca.MX.sym("p", loop.p.numel())
    still = ca.MX.zeros(loop.drawn.numel())
    rates = flowing(state, parts.trajectory(t, p), still, instants.period, p)
    rate = ca.Function("rate", [state, t, p], [rates])
    most = np.full(loop.state.numel(), np.finfo(float).max) if bounds is None else bounds
    return Step(parts, rate, solver, instants, substeps, most)


def build_parts(loop: ClosedLoop, clock: float | None, recorded: SX) -> Parts:
    """Functions of a tick; without a sampling period, all states are integrated and no input is held.

    The sampling period is an argument of the functions, which are cached per loop.
    """
    whole = clock is None

    def recording() -> tuple[Parts, SX]:
        parts: Parts = once(loop.derived, ("parts", whole), lambda: _unrecorded(loop, continuous=whole))
        return replace(parts, outputs=_evaluated("outputs", loop, [recorded])), recorded

    # the stored expression keeps the identities of its nodes unique
    found: tuple[Parts, SX] = once(loop.derived, ("recording", whole, nodes(recorded)), recording)
    return found[0]


def _unrecorded(loop: ClosedLoop, *, continuous: bool) -> Parts:
    """Functions of a tick without recorded outputs."""
    if continuous:
        stepped, (held, given) = ca.SX(0, 1), (ca.SX(0, 1), ca.SX(0, 1))
        integrated, (rate,) = loop.state, loop.acting([loop.rate])
    else:
        stepped, (held, given) = loop.advanced, loop.held_over_a_sample
        integrated = stack(variable.symbol for variable in loop.flowing)
        rate = loop.flow
    (rate,) = _pruned(loop, [rate])
    _, meanings = columns(loop.trajectories)
    after, given = _pruned(loop, loop.acting([stepped, given]))
    seen = [loop.state, loop.w, loop.drawn, loop.period, loop.p]
    return Parts(
        trajectory=ca.Function("trajectory", [loop.time, loop.p], [ca.vertcat(meanings, loop.time)]),
        sample=ca.Function("sample", seen, ca.cse([after if continuous else loop.put_back(after), given])),
        rate=ca.Function("plant", [integrated, held, loop.w, loop.p], [ca.cse(rate)]),
        outputs=None,
        clip=ca.Function("clip", [integrated, loop.p], [loop.held(integrated)]),
        explicit=integrated.numel() - stack(variable.symbol for variable in loop.flowing).numel(),
    )


def plant_step(
    loop: ClosedLoop, clock: float, solver: Solver, shown: SX, bounds: np.ndarray, instants: Instants
) -> Step:
    """Step of the plant alone, with its commands as inputs.

    The state is that of the plant; the commands follow the random numbers in the rows of `instants`. `shown`, an
    expression in symbols of the plant, is recorded.
    """
    first = loop.state.numel() - stack(variable.symbol for variable in loop.plant).numel()
    state, integrated = loop.state[first:], stack(variable.symbol for variable in loop.flowing)
    commands, _ = columns(loop.commanded)
    held, _ = loop.held_over_a_sample
    stepped, rate, shown = _pruned(
        loop,
        [*loop.projected([loop.advanced], joined=False), loop.flow, *loop.projected([shown], joined=False)],
    )
    _, meanings = columns(loop.trajectories)
    seen = [state, loop.w, ca.vertcat(loop.drawn, commands), loop.period, loop.p]
    parts = Parts(
        trajectory=ca.Function("trajectory", [loop.time, loop.p], [ca.vertcat(meanings, loop.time)]),
        sample=ca.Function("sample", seen, ca.cse([loop.put_back(stepped)[first:], held])),
        rate=ca.Function("plant", [integrated, held, loop.w, loop.p], [ca.cse(rate)]),
        outputs=ca.Function("outputs", seen, [ca.cse(shown)]),
        clip=ca.Function("clip", [integrated, loop.p], [loop.held(integrated)]),
    )
    return Step(parts, None, solver, instants, substeps_of(instants.longest, solver), bounds)


def _columns_of(parts: Parts) -> tuple[Any, Any, Any]:
    """Symbols of the state, of the row of `Instants`, and of p."""
    state, _, drawn, _, p = (parts.sample.numel_in(i) for i in range(5))
    return ca.MX.sym("state", state), ca.MX.sym("given", DRAWN + drawn), ca.MX.sym("p", p)


def _evaluated(name: str, loop: ClosedLoop, expressions: list[SX]) -> Any:
    """Function (state, w, drawn, T, p) -> expressions at one instant, with projections active."""
    acting = ca.cse(_pruned(loop, loop.acting(expressions)))
    return ca.Function(name, [loop.state, loop.w, loop.drawn, loop.period, loop.p], acting)


def _pruned(loop: ClosedLoop, expressions: list[SX]) -> list[SX]:
    """Expressions with zeros for the robot parameters that are zero: there are many, and no run changes them."""
    zeros = [
        p.symbol.nz[k]
        for p in loop.parameters
        if p.label.startswith("robot.")
        for k in np.flatnonzero(p.value.ravel(order="F") == 0)
    ]
    return list(ca.substitute(expressions, [ca.vertcat(*zeros)], [ca.SX.zeros(len(zeros))])) if zeros else expressions


def _tick(parts: Parts, solver: Solver, instants: Instants, substeps: int) -> Any:
    """Function (state, given, p) -> (state after the tick, outputs recorded before it), for the interpreter."""
    state, given, p = _columns_of(parts)
    t, rosenbrock = given[TIME], solver.method == "ros34pw2"
    hoisted = parts.implicit[0] if rosenbrock else parts.hoisted
    c = hoisted.constants(p)
    z, u, recorded = hoisted.sample(state, hoisted.trajectory(t, p, c), given[DRAWN:], instants.period, p, c)
    _, x = ca.vertsplit(state, [0, z.numel(), state.numel()])
    if solver.method == "cvodes":
        x = _cvodes(parts, x, given, u, p, solver, instants)
    else:
        # without jitter all ticks have the same length, a constant for CasADi
        h = given[LENGTH] / substeps if instants.jitter else instants.period / substeps
        step = _step_of(parts, _ros34pw2 if rosenbrock else _rk4, *(column.numel() for column in (x, u, p, c)))
        for j in range(substeps):
            x = step(x, t + j * h, h, u, p, c)
    return ca.Function("tick", [state, given, p], [ca.vertcat(z, hoisted.clip(x, p, c)), recorded])


def _step_of(parts: Parts, method: Callable[..., Any], x: int, u: int, p: int, c: int) -> Any:
    """Function (x, t, h, u, p, c) -> x after one integrator step, called for each step of a tick."""
    given = [ca.MX.sym(name, size) for name, size in zip("xthupc", (x, 1, 1, u, p, c), strict=True)]
    return ca.Function("step", given, [method(parts, *given)])


def _rk4(parts: Parts, x: Any, t: Any, h: Any, u: Any, p: Any, c: Any) -> Any:
    """One step of the classical Runge-Kutta method."""
    hoisted, moved = parts.hoisted, parts.moved
    still = ca.MX.zeros(hoisted.rate.size1_in(2))

    def at(x: Any, t: Any) -> Any:
        return hoisted.rate(x, u, hoisted.trajectory(t, p, c) if moved else still, p, c)

    k1 = at(x, t)
    k2 = at(x + h / 2 * k1, t + h / 2)
    k3 = at(x + h / 2 * k2, t + h / 2)
    k4 = at(x + h * k3, t + h)
    return x + h / 6 * (k1 + 2 * (k2 + k3) + k4)


def _ros34pw2(parts: Parts, x: Any, t: Any, h: Any, u: Any, p: Any, c: Any) -> Any:
    """(3) of `dmframe.diagram.rosenbrock`, in the order of `loop.c`."""
    (hoisted, implicit), moved, method = parts.implicit, parts.moved, ROS34PW2
    w, dw = implicit.moving(t, p, c) if moved else 2 * [ca.MX.zeros(hoisted.rate.size1_in(2))]
    factors, drift, first = implicit.begin(x, u, w, dw, h, p, c)
    stages = [first]
    for i in range(1, method.stages):
        if moved:
            w = hoisted.trajectory(t + float(method.nodes[i]) * h, p, c)
        rate = hoisted.rate(_sum(x, method.a[i], stages), u, w, p, c)
        right = _sum(h * rate + float(method.drifts[i]) * h * h * drift, method.c[i], stages)
        stages.append(implicit.solve(factors, float(method.gamma) * right, p, c))
    return _sum(x, method.m, stages)


def _sum(first: Any, factors: Sequence[Fraction], columns: Sequence[Any]) -> Any:
    for factor, column in zip(factors, columns, strict=True):
        first = first + float(factor) * column
    return first


def _cvodes(parts: Parts, x: Any, given: Any, u: Any, p: Any, solver: Solver, instants: Instants) -> Any:
    if not ca.has_integrator("cvodes"):
        raise EngineError("solver: CasADi was built without SUNDIALS' cvodes; choose solver.method: rk4")
    rate = parts.rate
    state, since = ca.MX.sym("x", rate.size1_in(0)), ca.MX.sym("since")
    held = ca.MX.sym("held", rate.size1_in(1) + 2 + p.numel())
    sizes = [0, rate.size1_in(1), rate.size1_in(1) + 1, rate.size1_in(1) + 2, held.numel()]
    commands, start, length, numbers = ca.vertsplit(held, sizes)
    # an integrator has a fixed horizon: with jitter, ticks are scaled to the interval 0 to 1
    span, end = (length, 1.0) if instants.jitter else (1, instants.period)
    ode = rate(state, commands, parts.trajectory(start + span * since, numbers), numbers)
    problem = {"x": state, "t": since, "p": held, "ode": span * ode}
    options = {"reltol": solver.tolerance, "abstol": solver.tolerance * 1e-3, "max_num_steps": 10_000}
    integrator = ca.integrator("integrator", "cvodes", problem, 0, end, options)
    return integrator(x0=x, p=ca.vertcat(u, given[TIME], given[LENGTH], p))["xf"]
