"""Initial state of a run as expressions in parameters or measurements."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca
import numpy as np

from dmframe.block.certificate import SX
from dmframe.block.model import symbols_in
from dmframe.diagram import Diagram, Variable
from dmframe.diagram.closed_loop import stack
from dmframe.simulate.block_starts import Made, at_start, block_starts, has_start, in_order
from dmframe.simulate.start import given_starts, start_state


def symbolic_start(
    diagram: Diagram, given: Mapping[str, Any], posed: Variable | None, drawn: np.ndarray | None = None
) -> tuple[SX, SX]:
    """`start_state` as an expression in the parameters, the period, and the pose: the symbol of `posed`.

    Two versions: as given, and projected onto boxes and balls; if they differ by more than rounding, `start_state`
    raises. `drawn` are the random numbers of the first tick, zero by default.
    """
    loop, made = diagram.loop, Made()
    symbols = {parameter.label: parameter.symbol for parameter in loop.parameters}
    first = ca.SX.zeros(loop.drawn.numel()) if drawn is None else ca.SX(ca.DM(drawn))
    values = dict[str, SX]()
    for label, number in given_starts(diagram, loop.variables, given).items():
        values[label] = ca.SX(ca.DM(number))
    for variable in loop.variables:
        if posed is not None and variable.label == posed.label:
            values[variable.label] = posed.symbol
        elif variable.label in values:
            continue
        elif variable.name in diagram.models[variable.block].values:
            number = diagram.models[variable.block].values[variable.name]
            values[variable.label] = symbols.get(variable.label, ca.SX(ca.DM(np.ravel(number, order="F"))))
    for variable in loop.plant:
        if not has_start(diagram, variable, made):
            values.setdefault(variable.label, ca.SX.zeros(variable.symbol.numel()))
    for variable, starts in in_order(diagram, [v for v in loop.variables if v.label not in values], made):
        known = [v for v in loop.variables if v.label in values]
        column = stack(values[v.label] for v in known)
        values[variable.label] = (
            ca.SX.zeros(variable.symbol.numel())
            if starts is None
            else at_start(diagram, starts, known)(0, loop.p, column, first, loop.period)
        )
    found = stack(values[variable.label] for variable in loop.variables)
    return found, ca.substitute(loop.held(loop.state), loop.state, found)


def measured_start(diagram: Diagram, given: Mapping[str, Any]) -> tuple[SX, tuple[str, ...]]:
    """Initial controller states as functions of measurements, t, T and parameters, as available on a robot.

    Also returns the states that depend on more, such as true parameters; they start at the values of a simulation.
    """
    loop, made = diagram.loop, Made()
    symbols = {parameter.label: parameter.symbol for parameter in loop.parameters}
    mine = {variable.label for variable in loop.controller}
    stated_values = given_starts(diagram, loop.variables, given)
    values = {
        label: ca.SX(ca.DM(np.ravel(number, order="F"))) for label, number in stated_values.items() if label in mine
    }
    waiting = dict[str, SX]()
    for variable in (variable for variable in loop.controller if variable.label not in values):
        model, stated = diagram.models[variable.block], block_starts(diagram, variable.block, made).get(variable.name)
        if variable.name in model.values:
            number = ca.SX(ca.DM(np.ravel(model.values[variable.name], order="F")))
            values[variable.label] = ca.vec(symbols.get(variable.label, number))
        elif stated is None:
            values[variable.label] = ca.SX.zeros(variable.symbol.numel())
        else:
            waiting[variable.label] = ca.vec(ca.densify(loop.on_path(stated)))
    own = {variable.label: ca.vec(variable.symbol) for variable in loop.controller}
    while ready := [
        label for label, starts in waiting.items() if not ca.depends_on(starts, stack(own[other] for other in waiting))
    ]:
        leaves, meanings = stack(own[label] for label in values), stack(values.values())
        for label in ready:
            values[label] = ca.substitute(waiting.pop(label), leaves, meanings)
    allowed = [*(leaf.symbol for leaf in loop.measured), loop.time, loop.period, loop.p]
    known = symbols_in([ca.vec(item) for item in allowed])
    unknown = [*waiting, *(label for label, value in values.items() if not symbols_in([value]) <= known)]
    if unknown:
        simulated = start_state(diagram, given, made)
        edges = np.cumsum([0, *(variable.symbol.numel() for variable in loop.controller)])
        for k, variable in enumerate(loop.controller):
            if variable.label in unknown:
                values[variable.label] = ca.SX(ca.DM(simulated[edges[k] : edges[k + 1]]))
    found = stack(values[variable.label] for variable in loop.controller)
    rest = stack(variable.symbol for variable in loop.plant)
    state = ca.vertcat(found, ca.SX.zeros(rest.numel()))
    return ca.substitute(loop.held(loop.state), loop.state, state)[: found.numel()], tuple(unknown)
