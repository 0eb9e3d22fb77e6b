"""Facts about each block of a graph: role, signals, states, estimates, law, robot parameters used."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import final

import numpy as np

from dmframe.block import AbstractBlock
from dmframe.block.port import Side
from dmframe.block.prose import about
from dmframe.certify import Verdict
from dmframe.certify.true_values import estimates_of
from dmframe.common.errors import DmframeError, visible
from dmframe.config import BaseGraph
from dmframe.diagram import Diagram
from dmframe.diagram.knowledge import WORDS, known_truths
from dmframe.diagram.pieces import rows_of
from dmframe.formula import Formula, PrintedLaw, laws_of
from dmframe.formula.unmarked import unmarked
from dmframe.report.exchange import Exchange, exchange_of
from dmframe.report.flow import Given, Taken, given, order, taken
from dmframe.simulate.start import start_state


@final
@dataclass(frozen=True)
class Estimated:
    """Adapted state: formula and value of its true value, and initial value; None where unknown."""

    name: str
    unit: str
    of: Formula | None
    true: np.ndarray | None
    start: np.ndarray | None


@final
@dataclass(frozen=True)
class BlockFacts:
    """One block in its graph.

    Parameters
    ----------
    does
        Summary of its docstring as plain text; may be empty.
    roles
        Its roles in this graph, in words.
    states
        Name and unit of each state that is not an estimate.
    law
        Printed law; None in a graph without a certificate.
    certified
        True for a block with a certificate.
    dominator
        Block whose dissipation dominates the cross term of this block; empty without a cross term or such a block.
    knows
        True robot parameters that its equations contain, in words.
    """

    name: str
    type: str
    side: Side
    does: str
    roles: tuple[str, ...]
    taken: tuple[Taken, ...]
    given: tuple[Given, ...]
    states: tuple[tuple[str, str], ...]
    estimates: tuple[Estimated, ...]
    law: PrintedLaw | None
    certified: bool
    dominator: str
    knows: tuple[str, ...]


def facts_of(graph: BaseGraph, verdict: Verdict) -> tuple[BlockFacts, ...]:
    """Facts about all blocks, in signal-flow order."""
    diagram = graph.diagram
    claim = verdict.flow_claim
    claimed = claim.laws if claim is not None else {}
    laws = claimed or _printed(diagram)
    dominators = (
        {} if claim is None else {part.block: other.block for part, other in claim.cross_terms if other is not None}
    )
    knows = {known.block: tuple(WORDS.get(group, group) for group in known.groups) for known in known_truths(diagram)}
    true, starts = estimates_of(diagram), _starts(graph)
    return tuple(
        BlockFacts(
            name=name,
            type=diagram.type_of(name),
            side=diagram.blocks[name].side,
            does=visible(unmarked(about(type(diagram.blocks[name])).summary)),
            roles=tuple(_roles(diagram, name, adapts=any(label.startswith(f"{name}.") for label in true))),
            taken=tuple(taken(diagram, name)),
            given=tuple(given(diagram, name)),
            states=tuple(state for state in _states(diagram, name) if f"{name}.{state[0]}" not in true),
            estimates=tuple(_estimates(diagram, name, laws.get(name), true, starts)),
            law=claimed.get(name),
            certified=type(diagram.blocks[name]).certificate is not AbstractBlock.certificate,
            dominator=dominators.get(name, ""),
            knows=knows.get(name, ()),
        )
        for name in order(diagram)
    )


def exchange(verdict: Verdict) -> Exchange | None:
    """Groups of cancelling supply rates; None without a certificate, or where the test is not applicable."""
    if verdict.flow_claim is None:
        return None
    try:
        return exchange_of(verdict.flow_claim)
    except (DmframeError, ZeroDivisionError):
        return None


def _printed(diagram: Diagram) -> Mapping[str, PrintedLaw]:
    """Printed laws of a diagram without a certificate; empty where source and behaviour differ."""
    try:
        return laws_of(diagram)
    except DmframeError:
        return {}


def _roles(diagram: Diagram, name: str, *, adapts: bool) -> list[str]:
    """Derive the roles of a block from its signals and states, not from its type."""
    block, model = diagram.blocks[name], diagram.models[name]
    if block.side is Side.SOURCE:
        return ["source"]
    if block.side is Side.PLANT:
        commanded = any(item.how == "commanded" for item in taken(diagram, name))
        robot = block.uses_robot and bool(model.states)
        found = ["takes the commands"] * commanded + ["the robot"] * robot
        return ["plant", *found]
    commands = any(
        diagram.blocks[reader].side is Side.PLANT for item in given(diagram, name) for reader, _ in item.readers
    )
    remembers = bool(model.states) and not adapts
    found = ["adapts"] * adapts + ["has a memory"] * remembers + ["commands the plant"] * commands
    return ["controller", *found]


def _states(diagram: Diagram, name: str) -> list[tuple[str, str]]:
    units = {state.name: state.unit for state in diagram.blocks[name].states}
    return [(state, units[state]) for state in diagram.models[name].states]


def _estimates(
    diagram: Diagram,
    name: str,
    law: PrintedLaw | None,
    true: Mapping[str, np.ndarray | None],
    starts: Mapping[str, np.ndarray],
) -> list[Estimated]:
    formulas = {line.name: line.right for line in law.estimates} if law is not None else {}
    units = {state.name: state.unit for state in diagram.models[name].block.states}
    states = [state for state in diagram.models[name].states if f"{name}.{state}" in true]
    return [
        Estimated(
            state,
            units[state],
            formulas.get(state),
            true[f"{name}.{state}"],
            starts.get(f"{name}.{state}"),
        )
        for state in states
    ]


def _starts(graph: BaseGraph) -> dict[str, np.ndarray]:
    """Initial states by label; empty for an unreachable start, which `run` reports."""
    try:
        whole = start_state(graph.diagram, graph.start)
    except DmframeError:
        return {}
    return {variable.label: whole[rows] for variable, rows in rows_of(graph.diagram.loop.variables)}
