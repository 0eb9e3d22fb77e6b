"""Re-evaluates the conditions of a claim at other parameter values, as symbolic margins.

They include the checks without a line of their own (`dmframe.certify.tacit`). Each has a margin, or the complete list
of parameters and initial values on which it depends; if one of these changes, its result is unknown. For numbers of a
graph with intervals, a margin is the least over these.
"""

from __future__ import annotations

from collections.abc import Container, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import final

import casadi as ca

from dmframe.block.certificate import SX
from dmframe.block.model import symbols_in
from dmframe.block.numberless import remade
from dmframe.block.steady import same_statement
from dmframe.certify.checked import Checked, Numbers
from dmframe.certify.claim import Claim
from dmframe.certify.small_gain import kappa_needs
from dmframe.certify.steady import stated_claims
from dmframe.certify.tacit import tacit
from dmframe.common.errors import ValueFault
from dmframe.common.text import Label, Text
from dmframe.diagram import Diagram
from dmframe.diagram.closed_loop import stack
from dmframe.diagram.view import view
from dmframe.exact.ends import Ends, enclosing
from dmframe.exact.rational import Interval, as_float

Intervals = Mapping[str, Sequence[Interval]]


@final
@dataclass(frozen=True)
class ParameterMargin:
    """A condition that numbers decide, for any numbers and any initial values.

    Evaluation with a `margin`: the condition is met if the least element is positive, or nonnegative if
    ``checked.strict`` is false. Otherwise it fails or, with `opens`, is unknown. Without a margin: its result is
    ``checked.holds`` as long as all in `reads` have the graph's values, and unknown otherwise. If `reads` is None, it
    may depend on everything.

    Parameters
    ----------
    checked
        The condition at the graph's own numbers.
    margin
        Expression in the loop's parameters, and in the symbols `Claim.starts` of states whose initial values vary; None
        if the condition was decided for the graph's own numbers only.
    reads
        Without a margin: the parameters, and the symbols of varied initial values, on which the condition depends.
    tacit
        True if it is not among the verdict's conditions, which list it only if it fails.
    opens
        If it fails, `verify` would check another condition or use another method, so that nothing is decided.
    """

    checked: Checked
    margin: SX | None
    reads: SX | None = None
    tacit: bool = False
    opens: bool = False


def parameter_margins(
    conditions: Sequence[Checked], claim: Claim | None, uncertain: Intervals, starts: Container[str] = ()
) -> list[ParameterMargin]:
    """The conditions of a verdict, in their order, followed by the checks without a line.

    Parameters
    ----------
    uncertain
        Intervals used by `verify`.
    starts
        Labels, ``block.state``, of states whose initial values vary, as with a graph's key `start`. Margins contain
        their symbols, ``claim.starts[label]``. All other initial values are those of the graph.
    """
    if claim is None:
        return []
    inside = _inside(claim, uncertain)
    found = [ParameterMargin(item, *_margin(claim, item, inside, starts), opens=item.sufficient) for item in conditions]
    return [*found, *_tacit(claim, uncertain, inside, starts)]


def least_kappa(claim: Claim, uncertain: Intervals) -> SX:
    """`Kappa.least` as an expression in the claim's parameters, if every dominating weight is positive.

    Raises `ValueFault` if numbers with intervals enter by more than field operations.
    """
    (needs,) = claim.loop.joined([kappa_needs(claim)])
    return ca.mmax(_ends(needs, _inside(claim, uncertain)).upper)


def same_claims(claim: Claim, changed: Diagram, name: str) -> bool:
    """True if a block states the same in a diagram with other numbers, so that it uses none of them as a number."""
    constants = dict[str, SX]()
    one, other = (
        stated_claims(remade(diagram.blocks[name]), view(claim.diagram, name, claim.truths), constants)
        for diagram in (claim.diagram, changed)
    )
    return same_statement(one, other)


def _inside(claim: Claim, uncertain: Intervals) -> dict[int, tuple[float, float]]:
    """Intervals, by the identity of their symbol."""
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


def _margin(
    claim: Claim, item: Checked, inside: Mapping[int, tuple[float, float]], starts: Container[str]
) -> tuple[SX | None, SX | None]:
    """A margin in parameters and varied initial values; without one, the parameters and initial values that decide."""
    given = symbols_in(claim.starts[label] for label in claim.starts if label in starts)
    known = claim.loop.constants
    margin = item.margin
    if item.begun is not None and any(label in starts for label in item.begun.symbols):
        begun = item.begun.at(starts)
        margin = margin if begun is None else begun
    read = item.reads if margin is None else margin
    if read is None:
        return None, None
    (joined,) = claim.loop.joined([ca.vec(ca.densify(read))])
    if margin is not None and symbols_in([joined]) <= known | given:
        with suppress(ValueFault):
            return _ends(joined, inside).lower, None
    used = symbols_in([joined])
    boxes = [item.set for item in claim.loop.projections if used & symbols_in([item.state])]
    joined = ca.vertcat(joined, *(ca.vec(ca.densify(end)) for box in boxes for end in box.ends))
    left = [symbol for symbol in ca.symvar(joined) if symbol.element_hash() in (known - inside.keys()) | given]
    return None, ca.vertcat(ca.SX(0, 1), *left)


def _tacit(
    claim: Claim, uncertain: Intervals, inside: Mapping[int, tuple[float, float]], starts: Container[str]
) -> Iterator[ParameterMargin]:
    for item in tacit(claim, Numbers(claim, uncertain)):
        margin, reads = _margin(claim, item, inside, starts)
        checked = replace(item, margin=margin, reads=reads, begun=None, sufficient=False)
        yield ParameterMargin(checked, margin, reads, tacit=True, opens=item.sufficient)
    for parameter in claim.loop.parameters:
        if parameter.label in uncertain:
            text = Text(Label(parameter.label), " lies in the interval that the graph gives")
            margin = _room(stack([parameter.symbol]), inside)
            checked = Checked(text, "", None, True, "", strict=False, margin=margin)
            yield ParameterMargin(checked, margin, tacit=True)


def _room(symbols: SX, inside: Mapping[int, tuple[float, float]]) -> SX:
    ends = [(symbol, *inside[symbol.element_hash()]) for symbol in ca.vertsplit(symbols)]
    return ca.vertcat(*(side for symbol, low, high in ends for side in (symbol - low, high - symbol)))
