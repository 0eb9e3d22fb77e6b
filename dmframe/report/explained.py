"""What there is to say of each block of a graph, as facts: role, signals, states, estimates, law, knowledge."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import final

import numpy as np

from dmframe.block import AbstractBlock
from dmframe.block.prose import about
from dmframe.certify import Verdict
from dmframe.certify.true_values import estimates_of
from dmframe.config import Experiment
from dmframe.diagram import Diagram
from dmframe.diagram.knowledge import WORDS, known_truths
from dmframe.errors import DmframeError, visible
from dmframe.formula import Formula, PrintedLaw, laws_of
from dmframe.formula.unmarked import unmarked
from dmframe.port import Side
from dmframe.report.exchange import Exchange, exchange_of
from dmframe.report.flow import Given, Taken, given, order, taken
from dmframe.simulate.start import start_state


@final
@dataclass(frozen=True)
class Estimated:
    """An estimate: the formula of its true value, that value, and its start; None for what is not known."""

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
        Its summary, plain text; empty where its file says nothing.
    roles
        What it is in this graph, in words.
    states
        Name and unit of each state that is no estimate.
    law
        As it prints; None in a graph that claims nothing.
    certified
        True for a block that states a certificate.
    payer
        The block that pays for what it consumes; empty where it consumes nothing, or nobody could pay.
    knows
        The true numbers of the robot that its equations hold, in words.
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
    payer: str
    knows: tuple[str, ...]


def facts_of(experiment: Experiment, diagram: Diagram, verdict: Verdict) -> tuple[BlockFacts, ...]:
    """All blocks, in the order in which signals pass them."""
    claim = verdict.claim
    claimed = claim.laws if claim is not None else {}
    laws = claimed or _printed(diagram)
    payers = {} if claim is None else {part.block: payer.block for part, payer in claim.payments if payer is not None}
    knows = {known.block: tuple(WORDS.get(group, group) for group in known.groups) for known in known_truths(diagram)}
    true, starts = estimates_of(diagram), _starts(experiment, diagram)
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
            payer=payers.get(name, ""),
            knows=knows.get(name, ()),
        )
        for name in order(diagram)
    )


def exchange(verdict: Verdict) -> Exchange | None:
    """Which supplies cancel; None where there is no claim, or no way to decide."""
    if verdict.claim is None:
        return None
    try:
        return exchange_of(verdict.claim)
    except (DmframeError, ZeroDivisionError):
        return None


def _printed(diagram: Diagram) -> Mapping[str, PrintedLaw]:
    """The laws of a diagram that claims nothing; none where what is read is not what runs."""
    try:
        return laws_of(diagram)
    except DmframeError:
        return {}


def _roles(diagram: Diagram, name: str, *, adapts: bool) -> list[str]:
    """From what a block reads, hands on and keeps: no block is known by its type."""
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


def _starts(experiment: Experiment, diagram: Diagram) -> dict[str, np.ndarray]:
    """Where states start, by label; none of a graph whose start cannot be reached, which a run tells."""
    try:
        whole = start_state(diagram, experiment.start)
    except DmframeError:
        return {}
    found, place = dict[str, np.ndarray](), 0
    for variable in diagram.loop.variables:
        size = variable.symbol.numel()
        found[variable.label] = whole[place : place + size]
        place += size
    return found
