"""Conditions decided exactly: at the graph's own numbers, or over its intervals."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property, partial
from typing import final

import casadi as ca

from dmframe.block.certificate import SX, Assumption
from dmframe.block.linalg import ldl
from dmframe.block.model import symbols_in
from dmframe.certify.begun import START, Begun
from dmframe.certify.claim import Claim
from dmframe.certify.symbols import exact_values
from dmframe.certify.uncertain import tie_of
from dmframe.common.errors import ValueFault
from dmframe.common.text import Text
from dmframe.diagram.closed_loop import stack
from dmframe.exact.ranges import ranges
from dmframe.exact.rational import Interval, as_float, evaluate, known_values
from dmframe.program import TO_READ, read
from dmframe.prove.definite import Number, lower, pivots


@final
@dataclass(frozen=True)
class Checked:
    """A condition with its margin.

    Parameters
    ----------
    expression
        Decided relation; for a condition stated by an author, printed from the code.
    value
        Least value that must be positive, the margin; None if it could not be computed.
    how
        Method: ``exact``; ``cases``, all of a few; ``sampled``; or ``undecided``, which never counts as true.
    strict
        True if the value must be positive; otherwise it may be zero.
    margin
        Expression in the claim's symbols whose least element is `value`, for an evaluation at other numbers of the same
        loop; empty if the graph's numbers do not matter, None if the condition is not the sign of an expression.
    reads
        Without a margin: all parameters and all symbols of initial values (`Claim.starts`) on which the result depends.
        A condition that is met has a margin or this list.
    begun
        Quantity that must be positive at the start, if the condition depends on initial values.
    sufficient
        A positive margin is sufficient; a negative margin decides nothing.
    """

    name: Text
    expression: str
    value: float | None
    holds: bool
    source: str
    how: str = "exact"
    strict: bool = True
    margin: SX | None = field(default=None, compare=False)
    reads: SX | None = field(default=None, compare=False)
    begun: Begun | None = field(default=None, compare=False)
    sufficient: bool = field(default=False, compare=False)


@final
@dataclass(frozen=True)
class _Tie:
    """A parameter that is a product: of a ratio and another parameter, or of a factor and its own value.

    `symbols`: the new symbols in the product, with their values.
    """

    parameter: SX
    product: SX
    symbols: tuple[tuple[SX, Sequence[Number]], ...]


@final
class Numbers:
    """Exact values of expressions in parameters only, at the graph's numbers or over its intervals.

    Parameters
    ----------
    uncertain
        Intervals by ``block.parameter``, of initial values by ``start.block.state``, and of ratios and factors of
        parameters (`dmframe.certify.uncertain`), which `of` and `enclosed` use.
    """

    def __init__(self, claim: Claim, uncertain: Mapping[str, Sequence[Interval]]) -> None:
        self.claim = claim
        values: dict[str, Sequence[Number]] = dict(exact_values(claim.diagram))
        self.starts = {
            label.removeprefix(START): given for label, given in uncertain.items() if label.startswith(START)
        }
        given = {label: values for label, values in uncertain.items() if not label.startswith(START)}
        self.values, self._p = values | given, claim.loop.parameters
        self.uncertain = frozenset(label for label in given if tie_of(label) is None)
        self.stated = tuple(label for label in uncertain if tie_of(label) is None or all(tie_of(label) or ()))
        self._columns = [stack([p.symbol]) for p in self._p]

    @cached_property
    def _ties(self) -> tuple[_Tie, ...]:
        """Ratios of parameters, then factors, which may be those of a ratio's second parameter."""
        columns = {p.label: column for p, column in zip(self._p, self._columns, strict=True)}
        own, found = exact_values(self.claim.diagram), list[_Tie]()
        for label, given in self.values.items():
            first, second = tie_of(label) or ("", "")
            symbol = ca.SX.sym(label, len(given))
            if second:
                found.append(_Tie(columns[first], symbol * columns[second], ((symbol, given),)))
            elif first:
                value = ca.SX.sym(f"own {first}", columns[first].numel())
                found.append(_Tie(columns[first], symbol * value, ((symbol, given), (value, own[first]))))
        return tuple(sorted(found, key=lambda tie: len(tie.symbols)))

    def tied(self, expression: SX) -> SX:
        """The expression with parameters that depend on each other replaced by products; see `uncertain`."""
        for tie in self._ties:
            expression = ca.substitute(expression, tie.parameter, tie.product)
        return expression

    @cached_property
    def known(self) -> set[int]:
        """Identities of the parameters' symbols."""
        return symbols_in(p.symbol for p in self._p)

    def of(self, expression: SX) -> list[Number]:
        """Elements of an expression, dense; raises `ValueFault` if it depends on more than parameters."""
        joined = self.tied(ca.vec(ca.densify(self.claim.loop.joined([ca.SX(expression)])[0])))
        symbols = ca.symvar(joined)
        try:  # faster than a function of all parameters
            given = [self._elements[symbol.element_hash()] for symbol in symbols]
        except KeyError:
            function = ca.Function("value", self._columns, [joined], {"allow_free": True})
            free = ", ".join(str(symbol) for symbol in function.get_free())
            raise ValueFault(f"expected an expression in parameters alone, found {free}") from None
        return evaluate(ca.Function("value", [stack(symbols)], [joined], TO_READ), [given])[0]

    @cached_property
    def _elements(self) -> Mapping[int, Number]:
        """Values of the parameters by the identities of their symbols."""
        columns = [(p.label, column) for p, column in zip(self._p, self._columns, strict=True)]
        pairs = [(column, self.values[label]) for label, column in columns]
        pairs += [pair for tie in self._ties for pair in tie.symbols]
        return {
            symbol.element_hash(): value
            for column, values in pairs
            for symbol, value in zip(ca.vertsplit(column), values, strict=True)
        }

    def value_of(self, symbol: SX) -> Number:
        """The value of a parameter's scalar symbol."""
        return self._elements[symbol.element_hash()]

    @cached_property
    def open(self) -> set[int]:
        """Identities of the symbols with intervals: parameters, and initial values (`Claim.starts`)."""
        parameters = [parameter.symbol for parameter in self._p if parameter.label in self.uncertain]
        return symbols_in([*parameters, *(self.claim.starts[label] for label in self.starts)])

    @cached_property
    def given(self) -> tuple[list[SX], list[Sequence[Number]]]:
        """Columns of symbols that a margin may contain, and their values: parameters, ties, starts with intervals."""
        tied = [pair for tie in self._ties for pair in tie.symbols]
        columns = [
            *self._columns,
            *(symbol for symbol, _ in tied),
            *(self.claim.starts[label] for label in self.starts),
        ]
        values = [*(self.values[p.label] for p in self._p), *(each for _, each in tied), *self.starts.values()]
        return columns, values

    def enclosed(self, expression: SX) -> list[Number]:
        """Enclosures of the elements of an expression in parameters and initial values with intervals, any operations.

        Raises `UndecidedError` if none is found, `ValueFault` if the expression contains other symbols.
        """
        joined = self.tied(ca.vec(ca.densify(expression)))
        columns, given = self.given
        function = ca.Function("value", columns, [joined], {"allow_free": True})
        if function.has_free():
            raise ValueFault("expected an expression in parameters and starts alone")
        try:
            return evaluate(function, given)[0]
        except (ValueFault, ZeroDivisionError):
            return list(ranges(read(function), given))

    def reads(self, expression: SX) -> SX:
        """Parameters in an expression, with its trajectories replaced by functions of time."""
        loop = self.claim.loop
        (joined,) = loop.joined([ca.vec(ca.densify(expression))])
        found = [symbol for symbol in ca.symvar(loop.on_path(joined)) if symbol.element_hash() in self.known]
        return ca.vertcat(ca.SX(0, 1), *found)

    def with_states(self, expression: SX, state: SX, values: Sequence[Number]) -> list[Number] | None:
        """Elements of an expression in parameters and one state, for all values of the state in its intervals."""
        joined = ca.vec(ca.densify(expression))
        function = ca.Function("value", [*self._columns, state], [joined], {"allow_free": True})
        return (
            None if function.has_free() else evaluate(function, [*(self.values[p.label] for p in self._p), values])[0]
        )

    def least(self, expression: SX) -> Fraction:
        """Least element; of an interval, its lower end. Raises `ValueFault` without elements."""
        values = self.of(expression)
        if not values:
            raise ValueFault("expected an expression with elements, found an empty one")
        return min(map(lower, values))

    def leasts(self, expressions: Sequence[SX]) -> list[Fraction | None]:
        """Least element of each expression, in one pass over common subexpressions; None where `least` raises."""
        if not expressions:
            return []
        joined = [ca.vec(ca.densify(item)) for item in self.claim.loop.joined(list(map(ca.SX, expressions)))]
        function = ca.Function("values", self._columns, [stack(joined)], {"allow_free": True, **TO_READ})
        values = iter(known_values(read(function), [self.values[p.label] for p in self._p]))
        found = [[next(values) for _ in range(item.numel())] for item in joined]
        decided = [[value for value in each if value is not None] for each in found]
        pairs = zip(decided, found, strict=True)
        return [min(map(lower, least)) if least and len(least) == len(each) else None for least, each in pairs]

    def least_pivot(self, matrix: SX) -> Fraction:
        """Least diagonal element of LDL' of a symmetric matrix, up to the first that is not positive."""
        values, n = self.of(matrix), matrix.shape[0]
        if not values:
            raise ValueFault("expected a matrix with elements, found an empty one")
        return min(pivots([values[column * n : (column + 1) * n] for column in range(n)]))

    def above(self, expression: SX, *, matrix: bool = False) -> bool:
        """True if the least element, or the least pivot of a matrix, is known to be positive."""
        try:
            return (self.least_pivot if matrix else self.least)(expression) > 0
        except (ValueFault, ZeroDivisionError):
            return False

    def decide(
        self,
        name: Text,
        text: str,
        source: str,
        margin: SX,
        strict: bool = True,
        *,
        matrix: bool = False,
        least: Callable[[], Fraction] | None = None,
    ) -> Checked:
        """A condition on the least element of a margin, or on the pivots of a matrix; undecided if there is none.

        `least` computes the value, if it is not the least element.
        """
        margin = ca.SX(margin)
        least = least or partial(self.least_pivot if matrix else self.least, margin)
        margin = ca.vertcat(*ldl(margin)[1]) if matrix else margin
        try:
            value = least()
        except ZeroDivisionError:
            text = Text(text, "; undecided: a divisor is zero, or its interval contains zero")
        except ValueFault as error:
            text = Text(text, f"; undecided: {error.text}")
        else:
            holds = value > 0 if strict else value >= 0
            return Checked(name, text, as_float(value), holds, source, strict=strict, margin=margin)
        return Checked(name, text, None, False, source, "undecided", strict, margin)


Finding = Checked | Assumption


def sorted_out(findings: Iterable[Finding]) -> tuple[list[Checked], list[Assumption]]:
    """Decided conditions and remaining assumptions, each in order."""
    found = list(findings)
    return [x for x in found if isinstance(x, Checked)], [x for x in found if isinstance(x, Assumption)]
