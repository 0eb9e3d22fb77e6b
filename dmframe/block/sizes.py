"""Sizes of a diagram: one number for each letter in the shapes of its blocks."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from fractions import Fraction
from typing import Any, Final, final

import numpy as np

from dmframe.block.base import AbstractBlock
from dmframe.block.faults import fault_context
from dmframe.block.gain import Prior, Rows, check_definite
from dmframe.block.numberless import without_numbers
from dmframe.block.parameter import PAIRS, array, joint_faults, specs
from dmframe.block.port import Signal, State
from dmframe.common.errors import (
    BlockError,
    DmframeError,
    MissingError,
    ShapeError,
    SizeError,
    UnknownNameError,
    ValueFault,
)
from dmframe.common.names import Element
from dmframe.common.units import shorten
from dmframe.robot.rational import decimal

LARGEST: Final = 10_000
"""Largest number that a letter can be bound to; graphs with larger expressions are not built."""


@final
class Sizes:
    """The number bound to each letter, and the name of the block or robot that bound it first."""

    def __init__(self) -> None:
        self.bound: dict[str, tuple[int, str]] = {}

    def bind(self, letter: str, size: int, by: str, path: tuple[str, ...] = ()) -> ShapeError | None:
        """Bind a letter; return the fault if it is bound to another number."""
        known, first = self.bound.setdefault(letter, (size, by))
        if known == size:
            return None
        return ShapeError(f"{by}: expected {letter} = {known} (bound by {first}), found {size}", path=path)

    def of(self, shape: str) -> tuple[int, ...]:
        """The numbers of a shape: ``"n p"`` -> (3, 36). Raises KeyError for an unbound letter."""
        return tuple(int(word) if word.isdigit() else self.bound[word][0] for word in shape.split())

    def has_sizes_of(self, item: Signal | State) -> bool:
        """Whether all letters of its shape are bound."""
        return all(word.isdigit() or word in self.bound for word in item.shape.split())

    def matrix(self, shape: str) -> tuple[int, int]:
        """Rows and columns: ``"n"`` -> (3, 1)."""
        rows, columns, *_ = (*self.of(shape), 1, 1)
        return rows, columns

    def explain(self, shape: str) -> str:
        """``(n p) with n = 3 (bound by robot ur10), p = 36 (bound by model)``."""
        letters = [word for word in dict.fromkeys(shape.split()) if not word.isdigit()]
        reasons = [f"{letter} = {self.bound[letter][0]} (bound by {self.bound[letter][1]})" for letter in letters]
        return f"({shape})" + (" with " + ", ".join(reasons) if reasons else "")


def bind_sizes(
    blocks: Mapping[str, AbstractBlock], robot: Any, bound: Sizes | None = None
) -> tuple[Sizes, list[DmframeError]]:
    """Bind all letters from the robot, from blocks that define a size, and from parameters given as full lists.

    `bound` contains letters that are bound already.
    """
    sizes, faults = bound or Sizes(), list[DmframeError | None]()
    if robot is not None:
        for letter in "nmk":
            faults.append(sizes.bind(letter, getattr(robot, letter), f"robot {robot.name}"))
    for name, block in blocks.items():
        if block.uses_robot and robot is None:
            faults.append(
                MissingError(
                    f"{name}: this block needs a robot; add the key robot: {{model: ...}}", path=("blocks", name)
                )
            )
            continue
        faults += [sizes.bind(letter, size, name) for letter, size in _own(name, block, robot).items()]
    for name, block in blocks.items():
        faults += _from_parameters(name, block, sizes)
    if not any(isinstance(fault, MissingError) for fault in faults):  # a robot would bind most letters
        faults += [_unbound(name, letter) for name, letter in _unbound_letters(blocks, sizes)]
    return sizes, [fault for fault in faults if fault is not None]


def _own(name: str, block: AbstractBlock, robot: Any) -> Mapping[str, int]:
    """Letters that a block binds by itself."""
    try:
        bare = without_numbers(block, name)  # sizes must not depend on numbers, which a sweep changes
        with fault_context(name, "elements()"):
            _check_elements(name, bare.elements(robot))
        with fault_context(name, "sizes()"):
            found = bare.sizes(robot)
        if not isinstance(found, Mapping) or not all(
            isinstance(letter, str) and isinstance(size, int) for letter, size in found.items()
        ):
            raise BlockError(f"{name}: expected sizes() to return a whole number for each letter, found {found!r:.60}")
        for letter, size in found.items():
            if not 0 <= size <= LARGEST:
                text = f"expected at most {LARGEST}" if size > LARGEST else "expected 0 or more"
                raise BlockError(f"{name}: {text} for the size {letter}, found {shorten(str(size), 20)}")
    except BlockError as fault:
        fault.path = fault.path or ("blocks", name)
        raise
    return found


def _check_elements(name: str, stated: Any) -> None:
    """Reject anything but a mapping of letters to elements with unique names."""
    if not isinstance(stated, Mapping):
        raise BlockError(f"{name}: expected elements() to return elements by letter, found {type(stated).__name__}")
    for letter, items in stated.items():
        if isinstance(items, str) or not all(isinstance(item, Element) for item in items):
            raise BlockError(f"{name}: expected elements() to return Elements for {letter}, found {items!r:.60}")
        names = [item.name for item in items]
        if twice := sorted({item for item in names if names.count(item) > 1}):
            raise BlockError(f"{name}: elements() names several of {letter} {twice[0]}; each needs a unique name")


def _from_parameters(name: str, block: AbstractBlock, sizes: Sizes) -> Iterable[DmframeError | None]:
    for parameter, spec in specs(type(block)).items():
        value, letters = getattr(block, parameter), spec.shape.split()
        if value is None or not letters:
            continue
        shapes = [np.shape(end) for end in (value if spec.form in PAIRS else (value,))]
        for shape in dict.fromkeys(shape[:1] if spec.form == "gain" else shape for shape in shapes):
            if shape and len(shape) == len(letters) and letters[-1] != "*" and not letters[-1].isdigit():
                yield sizes.bind(letters[-1], shape[-1], f"{name}.{parameter}", ("blocks", name, parameter))


def _unbound_letters(blocks: Mapping[str, AbstractBlock], sizes: Sizes) -> Iterable[tuple[str, str]]:
    for name, block in blocks.items():
        needed = [port for port in block.outputs if not port.optional]
        used: list[Signal | State] = [*block.inputs, *needed, *block.states]
        words = {word for item in used for word in item.shape.split() if not word.isdigit()}
        yield from ((name, letter) for letter in sorted(words - sizes.bound.keys()))


def _unbound(name: str, letter: str) -> DmframeError:
    return SizeError(
        f"{name}: the size {letter} is undetermined; add a robot, or write a parameter of that size as a list",
        letter,
        path=("blocks", name),
    )


def parameter_arrays(
    name: str,
    block: AbstractBlock,
    sizes: Sizes,
    blocks: Mapping[str, AbstractBlock] | None = None,
    robot: Any = None,
) -> tuple[dict[str, np.ndarray], list[DmframeError]]:
    """The block's numeric parameters as arrays of their bound sizes; `blocks` and `robot` determine a `Prior`."""
    values, faults = dict[str, np.ndarray](), list[DmframeError]()
    for parameter, spec in specs(type(block)).items():
        value = getattr(block, parameter)
        if value is None:
            continue
        if spec.of_joints:
            joints = () if robot is None else robot.joints
            faults += (
                ValueFault(f"{name}.{parameter}: {text}", path=("blocks", name, parameter))
                for text in joint_faults(value, spec, joints)
            )
        try:
            if isinstance(value, Prior):
                value = prior_rows(value, blocks or {name: block}, robot)
            words = spec.shape.split()
            size = (len(value), *sizes.of(" ".join(words[1:]))) if words[:1] == ["*"] else sizes.of(spec.shape)
            values[parameter] = array(value, spec, size)
        except DmframeError as fault:
            fault.text, fault.path = f"{name}.{parameter}.{fault.text}", ("blocks", name, parameter)
            faults.append(fault)
        except ValueError as error:
            faults.append(ShapeError(f"{name}.{parameter}: {error}", path=("blocks", name, parameter)))
        except KeyError as error:
            raise BlockError(f"{name}.{parameter}: the shape {spec.shape!r} uses the unbound letter {error}") from None
    return values, faults


def prior_rows(prior: Prior, blocks: Mapping[str, AbstractBlock], robot: Any) -> Rows:
    """The gain computed from another block's model, as decimal numbers for which it is positive definite."""
    if prior.inverse_of not in blocks:
        raise UnknownNameError("inverse_of", "block", prior.inverse_of, blocks)
    exact = blocks[prior.inverse_of].prior(robot, decimal(prior.others))
    if exact is None:
        able = "; ".join(name for name, block in blocks.items() if block.prior(robot, Fraction(1)) is not None)
        raise ValueFault(
            f"inverse_of: expected a block that models its parameters, found {prior.inverse_of}; the graph has "
            f"{able or 'none'}"
        )
    try:
        rows = tuple(tuple(float(decimal(prior.scale) * value) for value in row) for row in exact)
    except OverflowError:
        raise ValueFault(_too_large(prior)) from None
    if not all(rows[i][i] for i in range(len(rows)) if exact[i][i]):
        raise ValueFault(_too_large(prior))
    try:
        check_definite(rows)
    except OverflowError:
        raise ValueFault(_too_large(prior)) from None
    except ValueError as error:
        raise ValueFault(f"inverse_of: {error}; the model has a link that is not physically consistent") from None
    return rows


def _too_large(prior: Prior) -> str:
    return (
        f"inverse_of: with scale {prior.scale:g} and others {prior.others:g} the gain's elements exceed the range of "
        "numbers; choose more moderate values"
    )
