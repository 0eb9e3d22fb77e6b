"""Robot and servo of a graph, separated from the controller, for simulation elsewhere."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, final
from weakref import WeakKeyDictionary

import casadi as ca

from dmframe.block.model import symbols_in
from dmframe.block.port import Side
from dmframe.common.errors import EngineError, listed
from dmframe.config import BaseGraph
from dmframe.diagram import Diagram
from dmframe.diagram.closed_loop import stack
from dmframe.diagram.pieces import rows_of
from dmframe.export.program import Member, identifier, members
from dmframe.simulate import simulate
from dmframe.simulate.solver import substeps_of
from dmframe.simulate.start import start_state
from dmframe.simulate.step import build_parts


@final
@dataclass(frozen=True)
class Robot:
    """A robot as functions of vectors.

    Parameters
    ----------
    rate
        (x, commanded, p) -> dx.
    shown
        (x, p) -> measurements.
    torque
        (x, commanded, p) -> motor torques at the joints [N m]; None if the graph does not have them.
    substeps
        RK4 steps in a sampling period.
    states
        States with their initial values.
    """

    name: str
    title: str
    period: float
    substeps: int
    commanded: tuple[Member, ...]
    measured: tuple[Member, ...]
    parameters: tuple[Member, ...]
    states: tuple[Member, ...]
    rate: Any
    shown: Any
    torque: Any


_ROBOTS: Final[WeakKeyDictionary[BaseGraph, Robot]] = WeakKeyDictionary()
"""A graph does not change, and its robot takes a run to find the integrator's step."""


def robot_of(graph: BaseGraph) -> Robot:
    """Robot of a graph; the same one for the same graph.

    Raises
    ------
    EngineError
        The robot has sampled or random parts, reads a source such as a load, or is not integrated by RK4.
    """
    if graph not in _ROBOTS:
        _ROBOTS[graph] = _robot_of(graph)
    return _ROBOTS[graph]


def _robot_of(graph: BaseGraph) -> Robot:
    diagram = graph.diagram
    loop, clock, name = diagram.loop, graph.file.clock, graph.name
    if not isinstance(clock, float):
        raise EngineError(f"{name}: expected a clock such as 8 ms, found continuous; an exported robot is sampled")
    recorded = stack(stack([loop.joined([leaf.symbol])[0]]) for leaf in loop.measured)
    parts = build_parts(loop, clock, recorded)
    commands = stack(leaf.symbol for leaf in loop.commanded)
    held, _ = loop.held_over_a_sample
    states = list(loop.flowing)
    sampled = [variable.label for variable in loop.plant if variable.sampled]
    if sampled or loop.noises:
        what = sampled[0] if sampled else loop.noises[0].label
        raise EngineError(f"{name}: its robot has {what}, which is sampled; export it without reality")
    x = stack(variable.symbol for variable in states)
    rate = parts.rate(x, held, loop.w, loop.p)
    shown = parts.outputs(loop.state, loop.w, loop.drawn, loop.period, loop.p)
    own, rest = symbols_in([x, commands, loop.p]), symbols_in([loop.state, loop.w, held, loop.period])
    for expression, allowed in ((rate, own), (shown, own - symbols_in([commands]))):
        if unknown := (symbols_in([expression]) & rest) - allowed:
            leaves = [(leaf.name, leaf.symbol) for leaf in loop.trajectories]
            leaves += [(variable.label, variable.symbol) for variable in loop.variables]
            names = [label for label, symbol in leaves if symbols_in([symbol]) & unknown]
            raise EngineError(
                f"{name}: expected a robot that depends only on its state and its commands, found one that reads "
                f"{listed(names or ['the time'])}; export only the controller, with --c, or a robot without it"
            )
    if any(
        projection.state.is_dense() and symbols_in([projection.state]) & symbols_in([x])
        for projection in loop.projections
    ):
        raise EngineError(f"{name}: a state of its robot is projected to a box, which an export does not support")
    run = simulate(diagram, clock, **{**graph.settings, "solver": graph.solver.automatic})
    if run.solver.method != "rk4":
        raise EngineError(f"{name}: expected the method rk4 for an exported robot, found {run.solver.method}")
    torque = _torque(diagram)
    torque = None if torque is None or symbols_in([torque]) & rest - own else torque
    used = symbols_in([rate, shown, *([] if torque is None else [torque])])
    kept = [parameter for parameter in loop.parameters if used & symbols_in([parameter.symbol])]
    p = stack(parameter.symbol for parameter in kept)
    units = {signal.label: signal.unit for signal in loop.outputs}
    starts = start_state(diagram, graph.start)[loop.state.numel() - x.numel() :]
    return Robot(
        name=f"{identifier(name)}_robot",
        title=graph.file.title or "",
        period=clock,
        substeps=substeps_of(clock, run.solver),
        commanded=members((leaf.name, leaf.symbol, units[leaf.name]) for leaf in loop.commanded),
        measured=members((leaf.name, leaf.symbol, units[leaf.name]) for leaf in loop.measured),
        parameters=members((item.label, item.symbol, item.unit, item.value.ravel(order="F").tolist()) for item in kept),
        states=members(
            (variable.label, variable.symbol, variable.unit, starts[rows].tolist())
            for variable, rows in rows_of(states)
        ),
        rate=ca.Function("rate", [x, commands, p], [rate]),
        shown=ca.Function("shown", [x, p], [shown]),
        torque=None if torque is None else ca.Function("torque", [x, commands, p], [torque]),
    )


def _torque(diagram: Diagram) -> Any:
    """Torque K u of the block with an input in V and an output in N m/V; else the input in N m of a block."""
    loop = diagram.loop
    for label, block in diagram.blocks.items():
        if block.side is not Side.PLANT:
            continue
        volts = [port for port in block.inputs if port.unit == "V" and not port.optional]
        factors = [port for port in block.outputs if port.unit == "N m/V"]
        torques = [port for port in block.inputs if port.unit == "N m" and not port.optional]
        if len(volts) == len(factors) == 1:
            found = diagram.resolver.output(label, factors[0].name) * diagram.resolver.input(label, volts[0].name)
        elif len(torques) == 1:
            found = diagram.resolver.input(label, torques[0].name)
        else:
            continue
        (projected,) = loop.projected([found], joined=False)
        return projected
    return None
