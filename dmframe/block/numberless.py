"""Copies of a block without its numbers, on which its methods are evaluated.

A number that equations read from `self` would be a constant in them. A sweep, a study or a live page would then use
the first number for all values. The methods that state equations, certificate, conditions, initial values and
directions therefore run on a copy without numbers, and read them as symbols from `p`.

`dmframe.block.steady` finds numbers that a method reads by other means, such as a global variable that a validator has
written: it evaluates each method again after creating a block with other numbers.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final, TypeVar

from dmframe.block.gain import Prior
from dmframe.block.parameter import specs
from dmframe.common.errors import BlockError, DmframeError

if TYPE_CHECKING:
    from dmframe.block.base import AbstractBlock

B = TypeVar("B", bound="AbstractBlock")

OWNER: Final = "__owner__"
"""Attribute of a copy that contains the name of its block, for messages."""

LARGER: Final = (1000.0, 2.7, 1.0001)
SMALLER: Final = (0.001, 0.37, 0.9999)
"""Factors for `with_other_numbers`; it uses the first that the block accepts."""


def without_numbers(block: B, owner: str) -> B:
    """A copy of the block with its options only; reading a numeric parameter raises `BlockError`.

    Reading a value computed from numbers, a private attribute or a cached property, raises it too.
    """
    kind, numbers = type(block), specs(type(block))
    kept = {key: value for key, value in vars(block).items() if key in kind.model_fields and key not in numbers}
    bare = kind.__new__(kind)
    object.__setattr__(bare, "__dict__", {**kept, OWNER: owner})
    object.__setattr__(bare, "__pydantic_fields_set__", set(kept))
    object.__setattr__(bare, "__pydantic_extra__", None)
    object.__setattr__(bare, "__pydantic_private__", None)
    return bare


def unreadable(block: AbstractBlock, name: str) -> BlockError | None:
    """The error for reading a number from a copy without numbers; None for other names and other blocks."""
    owner = vars(block).get(OWNER)
    if owner is None:
        return None
    if name in specs(type(block)):
        return BlockError(
            f"{owner}: its methods read the number {name} from self, where it would be a constant; expected p.{name}, "
            f"a symbol, or '{name}' in p for whether it is given; an option that shapes the equations is a bool, a str "
            "or an int"
        )
    if name in type(block).__private_attributes__:
        return BlockError(
            f"{owner}: its methods read the private attribute {name}, which may hold numbers; expected parameters from "
            "p, or a property computed from options"
        )
    return None


def with_other_numbers(block: B, factors: Sequence[float], only: str | None = None) -> Iterator[B]:
    """Blocks with the same options and other numbers, or with one other number, that the block's checks accept.

    All numbers are multiplied by the first factor that the block accepts, which keeps boxes ordered and matrices
    definite; zeros are set to the factor. If the block accepts no factor for all numbers, the numbers are divided into
    halves, recursively, with one block for each.
    """
    given = given_values(block)
    varied = [key for key in specs(type(block)) if key in given and not isinstance(given[key], Prior)]
    waiting = [[key for key in varied if only in (None, key)]]
    while waiting:
        keys = waiting.pop(0)
        other = _with_other(type(block), given, keys, factors) if keys else None
        if other is not None:
            yield other
        elif len(keys) > 1:
            waiting += [keys[: len(keys) // 2], keys[len(keys) // 2 :]]


def _with_other(kind: type[B], given: Mapping[str, Any], keys: Sequence[str], factors: Sequence[float]) -> B | None:
    for factor in factors:
        try:
            return kind(**{**given, **{key: _other(given[key], factor) for key in keys}})
        except DmframeError:
            continue
    return None


def remade(block: B) -> B:
    """The block created again, so that values that its validators store elsewhere are those of its own numbers."""
    return type(block)(**given_values(block))


def given_values(block: AbstractBlock) -> dict[str, Any]:
    """Parameters and options that have values."""
    return {key: value for key, value in vars(block).items() if key in type(block).model_fields and value is not None}


def _other(value: Any, factor: float) -> Any:
    if isinstance(value, tuple):
        return tuple(_other(item, factor) for item in value)
    return factor * value if value else factor
