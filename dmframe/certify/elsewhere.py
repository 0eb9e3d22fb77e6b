"""A claim at other numbers than the graph's: each thing that `verify` decided by numbers, as margins of the same loop.

Beside its conditions `verify` looks at what says nothing while it holds: that nothing divides by zero, that a clipped
term has a width, that an equation is stable of which its block would otherwise ask more, that a path does not jump.
Where numbers of a graph are known up to intervals, a margin is the least over these.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, is_dataclass
from typing import Any, final

import casadi as ca

from dmframe.block import AbstractBlock
from dmframe.block.model import same_expressions, symbols_in
from dmframe.certificate import SX, Assumption, Clipped, Driven
from dmframe.certify.checked import Checked
from dmframe.certify.claim import Claim
from dmframe.certify.divisors import written
from dmframe.certify.payment import kappa_needs
from dmframe.certify.smoothness import followed_by_numbers
from dmframe.diagram import Diagram
from dmframe.diagram.closed_loop import stack
from dmframe.diagram.view import View, view
from dmframe.errors import DmframeError, ValueFault
from dmframe.exact.ends import Ends, enclosing
from dmframe.exact.rational import Interval, as_float
from dmframe.program import DIVISIONS, OPERATIONS

Intervals = Mapping[str, Sequence[Interval]]


@final
@dataclass(frozen=True)
class Elsewhere:
    """One thing that numbers decide, at any numbers.

    Parameters
    ----------
    margin
        Its least element decides; None where the graph's own numbers are all that it was decided for.
    reads
        The parameters on which it depends, where there is no margin: while these stay, so does what was decided.
    tacit
        It is not among the verdict's conditions, which name it only where it fails.
    opens
        Where it fails, `verify` would ask something else, so that nothing is decided.
    """

    checked: Checked
    margin: SX | None
    reads: SX | None = None
    tacit: bool = False
    opens: bool = False


def elsewhere(conditions: Sequence[Checked], claim: Claim | None, uncertain: Intervals) -> list[Elsewhere]:
    """The conditions of a verdict, in their order, and then what is tacit."""
    if claim is None:
        return []
    inside = _inside(claim, uncertain)
    found = [Elsewhere(item, *_margin(claim, item.margin, inside)) for item in conditions]
    return [*found, *_tacit(claim, uncertain, inside)]


def least_kappa(claim: Claim, uncertain: Intervals) -> SX:
    """`Kappa.least` as an expression in the claim's parameters, where every weight that pays is above zero.

    Raises `ValueFault` where numbers known up to intervals enter by more than field operations.
    """
    (needs,) = claim.loop.joined([kappa_needs(claim)])
    return ca.mmax(_ends(needs, _inside(claim, uncertain)).upper)


def claims_alike(claim: Claim, changed: Diagram, name: str) -> bool:
    """True where a block states the same in a diagram with other numbers: it reads none of them as a number."""
    (ones, said), (others, too) = (
        _stated_by(diagram.blocks[name], view(claim.diagram, name, claim.truths))
        for diagram in (claim.diagram, changed)
    )
    return said == too and same_expressions(ones, others)


def _stated_by(block: AbstractBlock, seen: View) -> tuple[list[SX], list[str]]:
    """The expressions of a block's certificate and conditions, and all else that is in them, as texts."""
    expressions, rest = list[SX](), list[str]()

    def collect(item: Any) -> None:
        if isinstance(item, ca.SX | ca.DM | float | int):
            expressions.append(ca.SX(item))
        elif is_dataclass(item):
            rest.append(type(item).__name__)
            collect([getattr(item, each.name) for each in fields(item)])
        elif isinstance(item, Mapping):
            collect(list(item.items()))
        elif isinstance(item, list | tuple):
            rest.append(str(len(item)))
            for inner in item:
                collect(inner)
        else:
            rest.append(str(item))

    try:
        collect(block.conditions(seen.p, seen.truth))
        if type(block).certificate is not AbstractBlock.certificate:
            collect(block.composed_certificate(seen.u, seen.x, seen.p, seen.truth))
    except DmframeError as error:
        rest.append(error.text)
    return expressions, rest


def _inside(claim: Claim, uncertain: Intervals) -> dict[int, tuple[float, float]]:
    """The intervals, by the identity of the symbol that they are of."""
    return {
        ca.SX(symbol).element_hash(): (as_float(interval.lower), as_float(interval.upper))
        for parameter in claim.loop.parameters
        for symbol, interval in zip(
            ca.vertsplit(stack([parameter.symbol])), uncertain.get(parameter.label, ()), strict=False
        )
    }


def _ends(expression: SX, inside: Mapping[int, tuple[float, float]]) -> Ends:
    if not symbols_in([expression]) & inside.keys():
        return Ends.of(expression)
    return enclosing(expression, inside)


def _margin(claim: Claim, margin: SX | None, inside: Mapping[int, tuple[float, float]]) -> tuple[SX | None, SX | None]:
    """A margin of parameters alone; where there is none, but only such are read, those that are no interval."""
    if margin is None:
        return None, None
    (joined,) = claim.loop.joined([ca.vec(ca.densify(margin))])
    known = symbols_in(parameter.symbol for parameter in claim.loop.parameters)
    if symbols_in([joined]) <= known:
        with suppress(ValueFault):
            return _ends(joined, inside).lower, None
    read = [symbol for symbol in ca.symvar(joined) if symbol.element_hash() in known - inside.keys()]
    return None, ca.vertcat(ca.SX(0, 1), *read)


def _tacit(claim: Claim, uncertain: Intervals, inside: Mapping[int, tuple[float, float]]) -> Iterator[Elsewhere]:
    for text, margin, strict, opens in (*_domains(claim), *_widths(claim), *_stable(claim)):
        known, read = _margin(claim, margin, inside)
        yield Elsewhere(_held(text, strict), known, read, tacit=True, opens=opens)
    for parameter in claim.loop.parameters:
        if parameter.label in uncertain:
            text = f"{parameter.label} lies in the interval that the graph gives"
            yield Elsewhere(_held(text, strict=False), _room(stack([parameter.symbol]), inside), tacit=True)
    for name, read in followed_by_numbers(claim.diagram, claim):
        yield Elsewhere(_held(f"{name} is continuous"), None, read, tacit=True)


def _held(name: str, strict: bool = True) -> Checked:
    return Checked(name, "", None, True, "", strict=strict)


def _room(symbols: SX, inside: Mapping[int, tuple[float, float]]) -> SX:
    ends = [(symbol, *inside[symbol.element_hash()]) for symbol in ca.vertsplit(symbols)]
    return ca.vertcat(*(side for symbol, low, high in ends for side in (symbol - low, high - symbol)))


Told = Iterator[tuple[str, SX, bool, bool]]
"""Name, margin, whether it is strict, and whether it opens."""


def _domains(claim: Claim) -> Told:
    """As `undefined` looks at divisors and arguments made of parameters alone."""
    for name, model in claim.diagram.models.items():
        for code, part in claim.risks[name]:
            if symbols_in([part]) & model.moving or not symbols_in([part]) or code == ca.OP_TAN:
                continue
            if code in (*DIVISIONS, ca.OP_FMOD, ca.OP_REMAINDER):
                # of an interval it has to be of one sign, which its square does not forget
                yield f"{name}: {written(part)} is not zero", part * part, True, False
                continue
            text = f"{name}: {OPERATIONS[code].name} of {written(part)} is defined"
            if code == ca.OP_SQRT:
                yield text, part, False, False
            elif code == ca.OP_ACOSH:
                yield text, part - 1, False, False
            elif code in (ca.OP_ASIN, ca.OP_ACOS, ca.OP_ATANH, ca.OP_ERFINV):
                yield text, ca.vertcat(1 - part, 1 + part), True, False
            else:
                yield text, part + 1 if code == ca.OP_LOG1P else part, True, False


def _widths(claim: Claim) -> Told:
    """As `bounds_of` looks at clipped terms."""
    for part in claim.parts:
        for term in part.certificate.excess:
            if isinstance(term, Clipped):
                yield f"{part.block}: width of the clipped {term.of} > 0", ca.SX(term.width), True, False


def _stable(claim: Claim) -> Told:
    """As the closure looks at equations of which a block says what stands in where they are not stable."""
    for part in claim.parts:
        for item in part.certificate.driven:
            if all(isinstance(condition, Assumption) for condition in item.otherwise):
                continue
            yield f"{part.block}: the linear equation of {', '.join(item.of)} is stable", _stability(item), True, True


def _stability(item: Driven) -> SX:
    if len(item.rates) == 1:
        return -ca.SX(item.rates[0][0])
    (a, b), (c, d) = [[ca.SX(rate) for rate in row] for row in item.rates]
    return ca.vertcat(ca.vec(-(a + d)), ca.vec(a * d - b * c))
