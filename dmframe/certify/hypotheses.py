"""Hypotheses of a theorem, derived from the closed loop, so that no block has to state them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import casadi as ca

from dmframe.block.certificate import SX, Assumption
from dmframe.block.linalg import Inverted
from dmframe.block.model import BlockModel, depending, symbols_in
from dmframe.block.port import Access, Side
from dmframe.certify.checked import Checked, Numbers
from dmframe.certify.claim import Claim
from dmframe.certify.closure import Closure
from dmframe.certify.definite import is_mass_matrix, is_mass_matrix_of_bodies
from dmframe.certify.divisors import additional_divisors, domains, written
from dmframe.common.errors import listed
from dmframe.common.text import Label, Text, joined, listed_text, name_of, sentence
from dmframe.diagram import Diagram
from dmframe.diagram.knowledge import known_truths
from dmframe.diagram.wiring import Wire
from dmframe.program import DIVISIONS, OPERATIONS

BETWEEN: Final = "is constant between its steps; the proof holds between two steps, each of which starts a new {V}"
"""Text of the assumption on a piecewise constant source."""

ORDERS: Final = ("", "first ", "first two ", "first three ", "first four ", "first five ")


def hypotheses(claim: Claim, closure: Closure) -> list[Assumption]:
    """All facts that cannot be decided from the graph, in the order of a theorem's statement."""
    found = [
        *of_the_plant(claim.diagram),
        *_known(claim.diagram),
        *_ranks(claim),
        *(item for name in claim.diagram.blocks for item in _divisors(claim, name)),
        *(Assumption(text, "the proof needs it") for text in additional_divisors(claim, closure)),
        *_open(closure),
        *_trajectories(claim),
        *_measured(claim.diagram),
        Assumption("time is continuous; `dmframe analyse` examines the sampled loop", "Section II"),
    ]
    return list(dict.fromkeys(found))


def of_the_plant(diagram: Diagram) -> Iterator[Assumption]:
    """The model of the servo and of the robot."""
    plant = [name for name, block in diagram.blocks.items() if block.side is Side.PLANT]
    if plant:
        text = f"the robot and its servo are as in the graph, rigid, with constant parameters: {', '.join(plant)}"
        yield Assumption(text, "eqs. (3), (6), (7)")


def _known(diagram: Diagram) -> Iterator[Assumption]:
    """True numbers of the robot that a controller uses."""
    for known in known_truths(diagram):
        yield Assumption(
            f"{known.block} ({known.kind}) uses exact values of {known.words}", "its equations contain them"
        )


def _ranks(claim: Claim) -> Iterator[Assumption]:
    """Matrices of full row rank that some block reads."""
    read = {(source.block, source.port) for source in claim.diagram.sources.values() if isinstance(source, Wire)}
    for name, model in claim.diagram.models.items():
        for port in model.block.outputs:
            if port.full_rank and (name, port.name) in read:
                text = Text(name_of(port.name), f" ({name}) keeps full row rank along the motion, uniformly")
                yield Assumption(text, "Theorems 1 to 4, Remark 2")


def _divisors(claim: Claim, name: str) -> Iterator[Assumption]:
    """Matrices and numbers that a block's equations divide by, if they contain more than parameters."""
    model = claim.diagram.models[name]
    for inverted in model.inverted:
        text = _definite(claim, model, inverted)
        if text:
            yield Assumption(Text(f"{name}: ", text), "its equations invert it")
    known = {pivot.element_hash() for inverted in model.inverted for pivot in inverted.pivots}
    seen = dict[Text, None]()
    moves = depending([divisor for _, divisor in claim.risks[name]], model.moving)
    for (code, divisor), moved in zip(claim.risks[name], moves, strict=True):
        if divisor.element_hash() in known or not moved:
            continue
        if code in DIVISIONS:
            seen[Text(written(divisor), " stays away from zero")] = None
        else:
            text = Text(f"{OPERATIONS[code].name} of ", written(divisor), " stays where it is defined and finite")
            seen[text] = None
    yield from (Assumption(Text(f"{name}: ", text), "its equations need it") for text in seen)


def undefined(claim: Claim, numbers: Numbers) -> Iterator[Checked]:
    """Divisors and arguments, made of parameters only, that are outside their domain at the graph's numbers."""
    for name, model in claim.diagram.models.items():
        items = list(domains(name, claim.risks[name], model.moving))
        for item, least in zip(items, numbers.leasts([item.margin for item in items]), strict=True):
            # None if it contains more than parameters, or another divisor is reported
            if least is not None and not (least > 0 if item.strict else least >= 0):
                yield Checked(item.name, "defined and finite", None, False, "its equations need it", "undecided")


def _definite(claim: Claim, model: BlockModel, inverted: Inverted) -> Text:
    """Text of the invertibility of a matrix; empty if it follows, or is a separate condition."""
    A = ca.SX(inverted.matrix)
    if not symbols_in([A]) & model.moving:
        return Text()
    for port in model.block.inputs:
        symbol = model.inputs.get(port.name)
        if symbol is None:
            continue
        if symbol.shape[0] == A.shape[0] and _equal(A, symbol @ symbol.T):
            if _declared_full_rank(claim.diagram, model.name, port.name):
                return Text()  # assumed for the matrix itself
            return Text(name_of(port.name), " keeps full row rank along the motion, uniformly")
        if symbol.shape == A.shape and _equal(A, symbol):
            given = claim.loop.joined([claim.diagram.resolver.expand(model.name, symbol)])[0]
            if is_mass_matrix_of_bodies(claim, given):
                return Text()  # V keeps these parameters physically consistent
            return Text(name_of(port.name), " stays positive definite, uniformly")
    resolver = claim.diagram.resolver
    (given,) = claim.loop.joined([resolver.expand(model.name, A)])
    if model.robot is not None and is_mass_matrix(claim, given):
        return Text()  # M(q) > 0 is a condition
    named = sorted({symbol.name().split("[")[0].rpartition("_")[0] or symbol.name() for symbol in ca.symvar(A)})
    made = joined([name_of(name) for name in named[:4]])
    return Text("a symmetric matrix that it inverts, made of ", made, ", stays positive definite, uniformly")


def _equal(one: SX, other: SX) -> bool:
    return one.shape == other.shape and bool(ca.is_equal(ca.densify(one), ca.densify(other), 9))


def _declared_full_rank(diagram: Diagram, block: str, port: str) -> bool:
    source = diagram.sources[block, port]
    if not isinstance(source, Wire):
        return False
    return any(out.name == source.port and out.full_rank for out in diagram.models[source.block].block.outputs)


def _open(closure: Closure) -> Iterator[Assumption]:
    """States that neither V nor another argument bounds, if the rates of the loop depend on them."""
    left = [Text(Label(variable.label)) for variable in closure.open_states()] or [sentence("the time {t}")]
    if closure.isolated():
        return
    text = "a solution exists for all time: {V} does not contain all of {names}, and the rates of {felt} depend on them"
    felt = listed_text([Label(v.label) for v in closure.affected()])
    yield Assumption(sentence(text, names=listed_text(left), felt=felt), "not shown")


def _trajectories(claim: Claim) -> Iterator[Assumption]:
    resolver, orders = claim.diagram.resolver, dict[tuple[str, str], int]()
    for block, port, order in resolver.trajectories:
        orders[block, port] = max(order, orders.get((block, port), 0))
    for (block, port), order in orders.items():
        name = Label(f"{block}.{port}")
        if resolver.steps(block, port):
            if Wire(block, port) not in claim.diagram.sources.values():
                continue  # unused
            text = "{name} is bounded, and " + BETWEEN.removeprefix("is ") + _stepping(claim, block, port)
            yield Assumption(sentence(text, name=name), sentence("{V} contains it"))
            continue
        if order == 0 and resolver.trajectory_rate(block, port, 0).is_zero():
            yield Assumption(Text(name, " is constant"), "it does not read the time")
            continue
        count = ORDERS[order] if order < len(ORDERS) else f"first {order} "
        rates = f" and its {count}derivative{'s' * (order > 1)}" if order else ""
        yield Assumption(Text(name, f"{rates} {'are' if order else 'is'} bounded"), "Theorems 1 to 4")


def _stepping(claim: Claim, block: str, port: str) -> str:
    """The part of V that jumps at a step: states are continuous, so that only parts that contain the signal jump."""
    leaf = symbols_in([claim.diagram.resolver.trajectory(block, port, 0).symbol])
    holding = [part.block for part in claim.parts if symbols_in([part.storage]) & leaf]
    if not holding:
        return "; no storage function jumps at a step"
    name, jump = ("function", "jumps") if len(holding) == 1 else ("functions", "jump")
    return f"; at a step only the storage {name} of {listed(holding)} {jump}"


def _measured(diagram: Diagram) -> Iterator[Assumption]:
    """Signals of the plant that the controller reads."""
    found = dict[str, None]()
    for (reader, _), source in diagram.sources.items():
        if isinstance(source, Wire) and diagram.blocks[reader].side is Side.CONTROLLER:
            port = next(p for p in diagram.models[source.block].block.outputs if p.name == source.port)
            if port.access is Access.MEASURED:
                found[f"{source.block}.{source.port}"] = None
    for leaf in diagram.loop.sampled_signals:  # signals of derived rates have no wire
        if leaf.side is Side.PLANT:
            found[leaf.name] = None
    if found:
        frame = "; positions of the tool are those of the path's frame" if any(n.endswith(".x") for n in found) else ""
        named = joined(list(map(Label, sorted(found))))
        yield Assumption(Text("what is measured is exact and without delay: ", named, frame), "Section II")
