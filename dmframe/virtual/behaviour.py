"""Attributes of a virtual robot that are checked when they are set."""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, TypeVar, final

from dmframe.common.errors import ValueFault

Value = TypeVar("Value")


@final
class Checked(Generic[Value]):
    """Attribute that may be set at any time; `check` converts the value or raises `ValueFault`."""

    def __init__(self, check: Callable[[str, Value], Value]) -> None:
        self._check = check

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    def __get__(self, instance: object, owner: type) -> Value:
        value: Value = vars(instance)[self._name]
        return value

    def __set__(self, instance: object, value: Value) -> None:
        vars(instance)[self._name] = self._check(self._name, value)


def fraction(name: str, value: float) -> float:
    """Check a number from 0 to 1. Raises `ValueFault`."""
    if not 0 <= value <= 1:
        raise ValueFault(f"{name}: expected a number from 0 to 1, found {value}")
    return float(value)


def count(name: str, value: int) -> int:
    """Check a whole number, 0 or more. Raises `ValueFault`."""
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise ValueFault(f"{name}: expected a whole number, 0 or more, found {value}")
    return value
