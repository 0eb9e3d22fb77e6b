"""Check that a block's methods return the same expressions when its numbers differ.

A number that a method reads from outside `p`, such as a global variable that a validator has written, is a constant
in the returned expressions. Each method is evaluated again after a block with other numbers was created; an expression
that differs contains such a constant.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from functools import cached_property
from hashlib import blake2b
from types import CodeType, FunctionType
from typing import Any, Final, final
from weakref import WeakKeyDictionary

import casadi as ca

from dmframe.block.base import AbstractBlock, Equations
from dmframe.block.certificate import SX
from dmframe.block.numberless import LARGER, SMALLER, given_values, remade, with_other_numbers
from dmframe.block.parameter import specs
from dmframe.block.reloaded import STEADY, made_again
from dmframe.common.errors import BlockError

Stating = Callable[[AbstractBlock], Mapping[str, Any]]
"""Evaluates a method of a block; returns its results with a description of each."""

_PARTS: Final = {"outputs": "output", "rates": "rate", "next": "next value", "second": "second term"}
"""Fields of `Equations` with the description of each."""


def stated_equations(equations: Equations) -> dict[str, SX]:
    """Equations by the description of each, such as ``rate of y``."""
    return {
        f"{word} of {key}": value for part, word in _PARTS.items() for key, value in getattr(equations, part).items()
    }


def check_steady(name: str, block: AbstractBlock, statement: str, first: Mapping[str, Any], stating: Stating) -> None:
    """Reject a method whose expressions differ at other numbers, or when it is evaluated again: `Steadiness`."""
    Steadiness(name, block, statement, first, stating).settle()


@final
class Steadiness:
    """Check that a method's expressions are the same at other numbers, and when it is evaluated again.

    Parameters
    ----------
    name
        The block's name in the diagram.
    statement
        The method with its verb, ``equations() state``.
    first
        The expressions of the first evaluation.
    stating
        Evaluates the method of a block.
    """

    def __init__(
        self, name: str, block: AbstractBlock, statement: str, first: Mapping[str, Any], stating: Stating
    ) -> None:
        self.name, self._block, self._statement, self._stating = name, block, statement, stating
        self._known = _Flat(first)
        self._held, self._key = _CONFIRMED.setdefault(type(block), set()), _key(statement, block, self._known)

    @property
    def confirmed(self) -> bool:
        """True if the same statement was checked before in this process."""
        return self._key in self._held

    def confirm(self) -> None:
        """Keep the result of a check that raised nothing."""
        if self._key is not None:
            self._held.add(self._key)

    def settle(self) -> None:
        """Check, unless the same statement was checked before, and keep the result."""
        if not self.confirmed:
            self.check()
            self.confirm()

    def check(self) -> None:
        """Evaluate the method of blocks with other numbers.

        Raises
        ------
        BlockError
            The message lists the parameters that the expressions depend on as Python numbers.
        """
        try:
            for factors in (LARGER, SMALLER):
                for other in _others(self._block, factors):
                    if changed := self._known.changed(_Flat(self._stating(other))):
                        raise _unsteady(self.name, self._block, self._statement, changed, self._stating)
            again = made_again(self.name, self._block)
            if again is not None and (changed := self._known.changed(_Flat(self._stating(again)))):
                text = f"{self.name}: {self._statement} another {changed} when its file is loaded again; {STEADY}"
                raise BlockError(text)
        finally:
            remade(self._block)  # restores the values stored by validators


_Key = tuple[tuple[CodeType, ...], bytes]
_CONFIRMED: WeakKeyDictionary[type[AbstractBlock], set[_Key]] = WeakKeyDictionary()
"""Statements that were equal at other numbers in this process: a study builds each block many times."""


def _key(statement: str, block: AbstractBlock, first: _Flat) -> _Key | None:
    """The code of a class, its block's numbers and options, and the expressions of the first evaluation.

    None if a statement may depend on more than these: a class with code that runs at the creation of a block, which can
    store its numbers anywhere; a method with a closure; a value that is neither a number nor text. Without such code
    two blocks differ in their symbols only; results of helper functions are part of the expressions.
    """
    kind, given = type(block), given_values(block)
    if _hooks(kind) or not all(map(_plain, given.values())):
        return None
    codes = list[CodeType]()
    for name, item in (
        (*each,) for base in kind.__mro__ if issubclass(base, AbstractBlock) for each in vars(base).items()
    ):
        function = getattr(item, "__func__", getattr(item, "fget", getattr(item, "func", item)))
        if isinstance(function, FunctionType) and name != "__hash__":  # defined by pydantic
            if set(function.__code__.co_freevars) - {"__class__"}:
                return None
            codes.append(function.__code__)
    return tuple(codes), blake2b(repr((statement, given)).encode() + first.text.encode(), digest_size=32).digest()


def _hooks(kind: type[AbstractBlock]) -> bool:
    """True for a class with its own code that runs at the creation of a block."""
    stated, base = kind.__pydantic_decorators__, AbstractBlock.__pydantic_decorators__
    if stated.field_validators.keys() - base.field_validators.keys() or stated.model_validators or stated.validators:
        return True
    if stated.root_validators or any(field.metadata or field.default_factory for field in kind.model_fields.values()):
        return True
    return any(getattr(kind, name) is not getattr(AbstractBlock, name) for name in _MAKING)


_MAKING: Final = ("__init__", "__new__", "__setattr__", "model_post_init", "__getattr__", "__getattribute__")


def _plain(value: Any) -> bool:
    if isinstance(value, tuple):
        return all(map(_plain, value))
    return isinstance(value, bool | int | float | str)


def _others(block: AbstractBlock, factors: Sequence[float]) -> Iterator[AbstractBlock]:
    """Blocks with other numbers, each created just before its evaluation; the block itself if it accepts none."""
    accepted = False
    for other in with_other_numbers(block, factors):
        accepted = True
        yield other
    if not accepted:
        yield block


def same_statement(one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    """True if two evaluations of a method returned the same expressions."""
    return not _Flat(one).changed(_Flat(other))


def same_expression(one: SX, other: SX) -> bool:
    """True for two structurally identical expressions of the same symbols and constants."""
    one, other = ca.densify(ca.SX(one)), ca.densify(ca.SX(other))
    return one.shape == other.shape and same_expressions([one], [other])


def same_expressions(ones: Sequence[SX], others: Sequence[SX]) -> bool:
    """The same for lists of equal length."""
    symbols = ca.symvar(ca.vertcat(ca.SX(0, 1), *(ca.vec(ca.densify(item)) for item in (*ones, *others))))
    given = [ca.vertcat(ca.SX(0, 1), *symbols)]
    one, other = (ca.Function("same", given, list(items)).serialize() for items in (ones, others))
    return bool(one == other)


def _unsteady(name: str, block: AbstractBlock, statement: str, what: str, stating: Stating) -> BlockError:
    own = _Flat(stating(remade(block)))

    def differs(others: Iterator[AbstractBlock]) -> bool:
        return any(own.changed(_Flat(stating(other))) for other in others)

    known = specs(type(block)) if not differs(iter([remade(block)])) else {}
    found = [
        item
        for item in known
        if any(differs(with_other_numbers(block, factors, item)) for factors in (LARGER, SMALLER))
    ]
    if found:
        return BlockError(
            f"{name}: {statement} another {what} where {' or '.join(found)} has another value, read as a Python "
            f"number; expected p.{found[0]}"
        )
    return BlockError(
        f"{name}: {statement} another {what} when evaluated again; expected the same expression each time, from "
        "its arguments alone"
    )


@final
class _Flat:
    """Returned parts as expressions and texts, by the description of each part."""

    def __init__(self, stated: Mapping[str, Any]) -> None:
        self._parts = {key: collected(value) for key, value in stated.items()}

    @cached_property
    def _symbols(self) -> list[SX]:
        return list(ca.symvar(ca.veccat(ca.SX(0, 1), *self._expressions)))

    @cached_property
    def _expressions(self) -> list[SX]:
        return [item for part in self._parts.values() for item in part[0]]

    def _written(self, symbols: list[SX]) -> str:
        """The expressions as CasADi writes a function of these symbols; empty if they contain other symbols."""
        try:
            given = [ca.vertcat(ca.SX(0, 1), *symbols)]
            return str(ca.Function("same", given, self._expressions).serialize())
        except RuntimeError:  # free symbols
            return ""

    @cached_property
    def _own(self) -> str:
        return self._written(self._symbols)

    @property
    def text(self) -> str:
        """All parts as text, with the names of symbols."""
        symbols = [str(symbol) for symbol in self._symbols]
        return repr([symbols, [(key, part[1]) for key, part in self._parts.items()], self._own])

    def changed(self, other: _Flat) -> str:
        """Description of the first part that differs; empty if none does."""
        one, two = self._parts, other._parts
        equal = one.keys() == two.keys() and all(one[key][1] == two[key][1] for key in one)
        # equal texts imply equal expressions; the converse may fail, since zeros may be stored or not
        if equal and self._own and self._own == other._written(self._symbols):
            return ""
        return next((key for key in {**one, **two} if _differ(one.get(key), two.get(key))), "")


_Part = tuple[Sequence[SX], Sequence[str]]


def _differ(one: _Part | None, other: _Part | None) -> bool:
    if one is None or other is None or one[1] != other[1]:
        return True
    return not all(map(same_expression, one[0], other[0]))


def collected(value: Any) -> _Part:
    """The expressions in a value, and its other parts as texts."""
    expressions, rest = list[SX](), list[str]()

    def collect(item: Any) -> None:
        if isinstance(item, ca.SX | ca.DM | float | int):
            expressions.append(ca.SX(item))
            rest.append(str(expressions[-1].shape))  # equal texts then imply equal numbers of expressions
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

    collect(value)
    return expressions, rest
