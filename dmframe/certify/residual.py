"""Bounds on the residual of dV/dt (ultimate-boundedness terms)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import final

from dmframe.block.certificate import SX, Bounded, Clipped, NormSquare, Square
from dmframe.certify.checked import Numbers
from dmframe.certify.claim import Claim, Part
from dmframe.certify.symbols import Symbols
from dmframe.common.errors import ValueFault
from dmframe.common.text import Text, around, square_of
from dmframe.exact.rational import as_float
from dmframe.prove.definite import upper


@final
@dataclass(frozen=True)
class Bound:
    """Bound on one term of the residual.

    Parameters
    ----------
    of
        Signals in the term.
    term
        The term.
    value
        Bound at the graph's numbers, or over its intervals; None if parameters alone do not determine it.
    constant
        True if it depends on the initial state and is constant along the motion.
    times
        Factor of the bound: none, or a signal, ``|sigma|``.
    weight
        Weight of the block's storage in V: ``"1"`` or ``"kappa"``.
    """

    block: str
    of: Text
    term: Text
    value: float | None
    times: Text
    weight: str
    constant: bool = False

    @property
    def known(self) -> bool:
        """True if there is a bound."""
        return self.value is not None or self.constant


def bounds_of(claim: Claim, numbers: Numbers, symbols: Symbols) -> list[Bound]:
    """Each term of the residual with its bound.

    A clipped term has one only if its width consists of parameters and is positive: `clip` with a negative or varying
    width has no known bounds.
    """
    return list(_bounds(claim, numbers, symbols))


def _bounds(claim: Claim, numbers: Numbers, symbols: Symbols) -> Iterator[Bound]:
    for part in claim.parts:
        for term in part.certificate.residual:
            value, constant = (
                _width(term, numbers) if isinstance(term, Clipped) else _size(part.block, term, numbers, symbols)
            )
            yield Bound(part.block, term.of, _shown(term), value, _times(term), _weight(claim, part), constant)


def _width(term: Clipped, numbers: Numbers) -> tuple[float | None, bool]:
    """The largest width, if every width is positive."""
    try:
        return (_most(term.width, numbers) if numbers.least(term.width) > 0 else None), False
    except (ValueFault, ZeroDivisionError):
        return None, False


def _size(block: str, term: Square | NormSquare, numbers: Numbers, symbols: Symbols) -> tuple[float | None, bool]:
    """Value of the square in parameters only; without one, whether it is constant."""
    expression = term.square.value if isinstance(term, NormSquare) else term.value
    try:
        return _most(expression, numbers), False
    except (ValueFault, ZeroDivisionError):
        return None, _is_constant(numbers.claim, expression, symbols, f"{block}: the bounded residual of {term.of}")


def _most(expression: SX, numbers: Numbers) -> float:
    return as_float(max(upper(number) for number in numbers.of(expression)))


def _is_constant(claim: Claim, expression: SX, symbols: Symbols, of: str) -> bool:
    """True for an expression that is identically constant along every motion."""
    return symbols.vanishes("rate", claim.flow.D(expression, of))


def _shown(term: Bounded) -> Text:
    if isinstance(term, Clipped):
        return term.of
    square = square_of(term.of, "W")
    return Text(around(term.by_of, "|{}|"), " ", square) if isinstance(term, NormSquare) else square


def _times(term: Bounded) -> Text:
    if isinstance(term, NormSquare):
        return around(term.by_of, "|{}|")
    return around(term.of, "|{}|_1") if isinstance(term, Clipped) else Text()


def _weight(claim: Claim, part: Part) -> str:
    return "kappa" if claim.cascaded and not part.cascade else "1"


def total_bound(bounds: list[Bound], kappa: float) -> float | None:
    """Bound on the whole residual; None if a signal multiplies a term, or a bound is unknown."""
    if any(bound.times or bound.value is None for bound in bounds):
        return None
    return sum((bound.value or 0.0) * (kappa if bound.weight == "kappa" else 1.0) for bound in bounds)
