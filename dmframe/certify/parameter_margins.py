"""Re-evaluates the conditions of a claim at other parameter values, as symbolic margins.

They include the checks without a line of their own (`dmframe.certify.tacit`). Each has a margin, or the
complete list of parameters and starts on which it depends, beyond which nothing is known of it. Where numbers of a
graph are known up to intervals, a margin is the least over these.
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
    """One thing that numbers decide, at any numbers and any starts.

    Judge it like this. With a `margin`: evaluate that; it holds where the least element is above zero, or, where
    ``checked.strict`` is false, not below it. Where it does not hold it fails, or, with `opens`, it is not known.
    Without one: it stays what it was decided to be (``checked.holds``) while all in `reads` keep the graph's values,
    and is not known as soon as one of them moves. `reads` None means that everything may decide it.

    Parameters
    ----------
    margin
        In the loop's parameters, and in the symbols `Claim.starts` of the states whose starts move; None where the
        graph's own numbers are all that it was decided for.
    reads
        The parameters, and the symbols of moved starts, on which it depends, where there is no margin.
    tacit
        It is not among the verdict's conditions, which name it only where it fails.
    opens
        Where it fails, `verify` would ask something else, or look in another way, so that nothing is decided.
    """

    checked: Checked
    margin: SX | None
    reads: SX | None = None
    tacit: bool = False
    opens: bool = False


def parameter_margins(
    conditions: Sequence[Checked], claim: Claim | None, uncertain: Intervals, starts: Container[str] = ()
) -> list[ParameterMargin]:
    """The conditions of a verdict, in their order, and then what is tacit.

    Parameters
    ----------
    uncertain
        The intervals that `verify` had.
    starts
        Labels, ``block.state``, of the states whose starts move: as in a graph whose key `start` gives these. Margins
        are in their symbols, ``claim.starts[label]``. All other starts stay those of the graph.
    """
    if claim is None:
        return []
    inside = _inside(claim, uncertain)
    found = [ParameterMargin(item, *_margin(claim, item, inside, starts), opens=item.sufficient) for item in conditions]
    return [*found, *_tacit(claim, uncertain, inside, starts)]


def least_kappa(claim: Claim, uncertain: Intervals) -> SX:
    """`Kappa.least` as an expression in the claim's parameters, where every dominating weight is above zero.

    Raises `ValueFault` where numbers known up to intervals enter by more than field operations.
    """
    (needs,) = claim.loop.joined([kappa_needs(claim)])
    return ca.mmax(_ends(needs, _inside(claim, uncertain)).upper)


def claims_alike(claim: Claim, changed: Diagram, name: str) -> bool:
    """True where a block states the same in a diagram with other numbers: it reads none of them as a number."""
    constants = dict[str, SX]()
    one, other = (
        stated_claims(remade(diagram.blocks[name]), view(claim.diagram, name, claim.truths), constants)
        for diagram in (claim.diagram, changed)
    )
    return same_statement(one, other)


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


def _margin(
    claim: Claim, item: Checked, inside: Mapping[int, tuple[float, float]], starts: Container[str]
) -> tuple[SX | None, SX | None]:
    """A margin of parameters and moved starts; where there is none, the parameters and starts that decide."""
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
