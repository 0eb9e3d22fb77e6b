"""Domain conditions: divisors that must be nonzero, and arguments of roots and logarithms."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Final

import casadi as ca

from dmframe.block.certificate import SX
from dmframe.block.model import depending, symbols_in
from dmframe.block.port import Side
from dmframe.certify.checked import Checked
from dmframe.certify.claim import Claim
from dmframe.certify.closure import Closure
from dmframe.certify.points import in_random_field
from dmframe.certify.sign import Sign, sign_after
from dmframe.certify.symbols import Group, symbols_of
from dmframe.common.text import Label, Text, joined, name_of, sentence, square_of
from dmframe.exact import Tape, Trial
from dmframe.program import CONST, DIVISIONS, INPUT, OPERATIONS

AWAY: Final = "{of} stays away from zero"
_PARTIAL: Final = frozenset(code for code, operation in OPERATIONS.items() if operation.domain is not None)
SHOWN = 60
"""Largest number of characters of a divisor that is printed completely."""


def written(divisor: SX) -> Text:
    """Text of a divisor; of a long one, the signals in it."""
    symbols = ca.vertcat(ca.SX(0, 1), *ca.symvar(divisor))
    names = {symbol.name().rpartition("_")[0] for symbol in ca.symvar(divisor)}
    if len(names) == 1 < symbols.numel() and ca.is_equal(divisor, ca.sumsqr(symbols), symbols.numel() + 2):
        return square_of(Text(name_of(names.pop())))
    text = str(divisor)
    if len(text) <= SHOWN:
        return Text(Label(text))
    made = sorted({s.name() for s in ca.symvar(divisor)})[:4]
    return Text("a divisor made of ", joined(list(map(Label, made))))


def domains(name: str, risks: Iterable[tuple[int, SX]], moving: set[int]) -> Iterator[Checked]:
    """Domain conditions of divisors and arguments that consist of parameters only, by their margins.

    A divisor over an interval must have one sign; its square is then positive.
    """
    risks = list(risks)
    moves = depending([part for _, part in risks], moving)
    for (code, part), moved in zip(risks, moves, strict=True):
        if moved or code == ca.OP_TAN or not symbols_in([part]):
            continue
        text, margin = Text(f"{name}: {OPERATIONS[code].name} of ", written(part), " is defined"), part
        if code in (*DIVISIONS, ca.OP_FMOD, ca.OP_REMAINDER):
            margin = part * part
        elif code == ca.OP_ACOSH:
            margin = part - 1
        elif code == ca.OP_LOG1P:
            margin = part + 1
        elif code in (ca.OP_ASIN, ca.OP_ACOS, ca.OP_ATANH, ca.OP_ERFINV):
            margin = ca.vertcat(1 - part, 1 + part)
        if code in DIVISIONS:
            text = Text(f"{name}: ", written(part), " is not zero")
        strict = code not in (ca.OP_SQRT, ca.OP_ACOSH)
        yield Checked(text, "", None, True, "", strict=strict, margin=margin)


def additional_divisors(claim: Claim, closure: Closure) -> Iterable[Text]:
    """Divisors in certificates and in derivatives of the proof that appear in no block's equations.

    Two divisors are equal if they agree at a random point of a prime field. Raises `ValueFault` if one vanishes at
    every such point.
    """
    symbols = symbols_of(claim, closure.uncertain)
    known = Tape.from_function(symbols.function("known", list(_of_equations(claim))))
    stated = Tape.from_function(
        symbols.function("stated", [p for part in claim.parts for p in part.certificate.pieces])
    )

    def unlisted(trial: Trial) -> dict[Text, None]:
        point, found = dict[str, list[int]](), dict[Text, None]()
        listed = {residue for (residue,) in known.evaluate(_at(point, symbols.groups, trial), trial)}
        for groups, tape in [(symbols.groups, stated), *closure.tapes]:
            values = tape.values(_at(point, groups, trial), trial)
            found |= dict.fromkeys(_unlisted(tape, groups, values, listed))
        return found

    return in_random_field("the divisors", closure.seed + 4, unlisted)


def _at(point: dict[str, list[int]], groups: Sequence[Group], trial: Trial) -> list[list[int]]:
    """One point, extended when further symbols appear."""
    for group in groups:
        if group.label not in point:
            point[group.label] = [trial.random() for _ in range(group.symbol.numel())]
    return [point[group.label] for group in groups]


def _of_equations(claim: Claim) -> Iterator[SX]:
    """All divisors in the blocks' own equations, in the independent variables of the closed loop."""
    resolver = claim.diagram.resolver
    for name, model in claim.diagram.models.items():
        if resolver.side(name) is Side.SOURCE:  # a trajectory is a leaf
            continue
        parts = [part for _, part in claim.risks[name]]
        parts += [pivot for inverted in model.inverted for pivot in inverted.pivots]
        yield from claim.loop.joined([resolver.expand(name, part) for part in parts])


def _unlisted(tape: Tape, groups: Sequence[Group], values: Sequence[int], listed: set[int]) -> Iterator[Text]:
    needed = [
        (k, text)
        for place, node in enumerate(tape.nodes)
        if node.code in _PARTIAL
        for k, text in _needs(tape, place)
        if values[k] not in listed
    ]
    if not needed:
        return
    fixed = {group.label for group in groups if group.kind in ("parameter", "weight")}
    made, signs = dict[int, frozenset[str]](), dict[int, Sign]()
    for place in _below(tape, [k for k, _ in needed]):
        node = tape.nodes[place]
        of = [made[k] for k in node.operands]
        made[place] = frozenset().union(*of) if node.code != INPUT else frozenset({groups[node.a].label})
        positive = node.code == CONST and tape.numbers[node.constant] > 0
        signs[place] = sign_after(node.code, [signs[k] for k in node.operands], positive=positive)
    for k, text in needed:
        moving = sorted(made[k] - fixed)
        if moving and signs[k] is not Sign.ABOVE:
            yield sentence(text, of=Text("something made of ", joined(list(map(Label, moving[:4])))))


def _below(tape: Tape, places: Sequence[int]) -> list[int]:
    """Instructions on which others depend, including these, in the order of the tape."""
    found, todo = set[int](), list(places)
    while todo:
        place = todo.pop()
        if place not in found:
            found.add(place)
            todo += tape.nodes[place].operands
    return sorted(found)


def _needs(tape: Tape, place: int) -> Iterator[tuple[int, str]]:
    """Domain condition of an instruction's operands."""
    node, exponent = tape.nodes[place], tape.exponent(place)
    operation = OPERATIONS.get(node.code)
    if exponent is not None:
        if exponent < 0:
            yield node.a, AWAY
    elif node.code in DIVISIONS:
        yield node.b, AWAY
    elif operation is not None and operation.domain is not None:
        yield node.operands[operation.domain], f"{operation.name} of {{of}} stays where it is defined and finite"
