"""A block without its numbers: what its equations see of `self`.

A number that equations took from `self` would be a constant in them. A run with another number, in a sweep, a study
or a live page, would then run the equations of the first. So a block states its equations, certificate, conditions,
starts and directions on a copy that lacks the numbers: they are symbols in `p`, and nothing else is there to be read.

What a method could still find by another way, such as a global that a validator has written, is found by
`dmframe.block.steady`: each method is evaluated again after a block with other numbers was made.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final, TypeVar

from dmframe.errors import BlockError, DmframeError
from dmframe.gain import Prior
from dmframe.parameter import specs

if TYPE_CHECKING:
    from dmframe.block.base import AbstractBlock

B = TypeVar("B", bound="AbstractBlock")

OWNER: Final = "__owner__"
"""Under which a copy keeps the name of its block, for messages."""

LARGER: Final = (1000.0, 2.7, 1.0001)
SMALLER: Final = (0.001, 0.37, 0.9999)
"""By which numbers differ in `with_other_numbers`; the first that the block takes counts."""


def without_numbers(block: B, owner: str) -> B:
    """The block with its options alone; a parameter that is a number raises `BlockError` when it is read.

    So does what was computed of the numbers and kept: private attributes and cached properties.
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
    """What to raise where a copy without numbers is asked for one; None of another name or another block."""
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
            "p, or a property that is made of options"
        )
    return None


def with_other_numbers(block: B, factors: Sequence[float], only: str | None = None) -> Iterator[B]:
    """The same options with other numbers, or with one other number, as far as the block takes some.

    All are multiplied by the first factor that the block takes, which keeps boxes in order and matrices definite;
    zeros get it as value. Where the block takes no factor for all of them, one block is made for each half, and so on.
    """
    given = _given(block)
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
    """The block made once more: what its validators keep elsewhere is then of its own numbers."""
    return type(block)(**_given(block))


def _given(block: AbstractBlock) -> dict[str, Any]:
    return {key: value for key, value in vars(block).items() if key in type(block).model_fields and value is not None}


def _other(value: Any, factor: float) -> Any:
    if isinstance(value, tuple):
        return tuple(_other(item, factor) for item in value)
    return factor * value if value else factor
