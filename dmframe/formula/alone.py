"""The law of a block type without a graph: for a robot with three joints, with default options or with each option."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Set
from fractions import Fraction
from typing import Any, Final, Literal, get_args, get_origin

from dmframe.block import AbstractBlock, type_name
from dmframe.block.model import model_block
from dmframe.block.parameter import PAIRS, Spec, specs
from dmframe.block.sizes import Sizes, parameter_arrays
from dmframe.common.errors import DmframeError
from dmframe.formula.law import Line, PrintedLaw
from dmframe.formula.laws import ReadBlock, certify
from dmframe.formula.robot import RobotFunctions
from dmframe.robot.chain import Joint, SerialChain
from dmframe.robot.symbolic import SymbolicRobot

_SIZES: Final = {"n": 3, "m": 2, "k": 12, "p": 33, "h": 4, "r": 5, "c": 9}
"""Sizes of the letters of shapes, all different, so that only square matrices have equal sizes."""


def law_of_type(block: type[AbstractBlock], **values: Any) -> PrintedLaw | None:
    """The law of a block type with these options; None if it cannot be created without parameter values."""
    read = read_type(block, **values)
    if read is None:
        return None
    read.compare()
    return read.law()


def read_type(block: type[AbstractBlock], **values: Any) -> ReadBlock | None:
    """A block of a type, read and compared with its code at the first points. Raises `BlockError` if they differ.

    This is sufficient for a docstring, which is compared with the code that runs; printed laws are compared further.
    """
    return _read(block, tuple(sorted(values.items())))


@functools.lru_cache(maxsize=512)
def _read(block: type[AbstractBlock], options: tuple[tuple[str, Any], ...]) -> ReadBlock | None:
    values = dict(options)
    known = specs(block)
    try:
        given = {
            name: _some(known[name], place)
            for place, (name, field) in enumerate(block.model_fields.items())
            if field.is_required() and name in known and name not in values
        }
        made = block(**given, **values)
        functions = _arm() if block.uses_robot else None
        chain = functions.of.chain if functions else None
        sizes = _sizes(made, chain)
        arrays, faults = parameter_arrays(type_name(block), made, sizes, {type_name(block): made}, chain)
        if faults:
            return None
        model = model_block(type_name(block), made, arrays, sizes, functions.of if functions else None)
    except (DmframeError, KeyError):  # the block requires a graph: a file, a path through points, another option
        return None
    shapes = {port.name: sizes.matrix(port.shape) for port in made.truth}
    read = ReadBlock(model, functions, truths=shapes, made=frozenset(shapes))
    certify({model.name: read})
    read.compare(near=True)
    return read


def variants(block: type[AbstractBlock]) -> Iterator[tuple[ReadBlock, bool]]:
    """The block with default options, then with each option by itself, then with all compatible options.

    The flag is true for the default options.
    """
    base, choices = base_of(block), list[dict[str, Any]]()
    if base is not None and (read := read_type(block, **base[1])) is not None:
        yield read, _known(block) >= base[1].keys()
    for _, values in switched(block):
        read = read_type(block, **values)
        if read is not None:
            choices.append(values)
            yield read, False
    together = dict[str, Any]()
    for values in choices:
        if read_type(block, **{**values, **together}) is not None:
            together = {**values, **together}
    read = read_type(block, **together) if len(together) > 1 else None
    if read is not None:
        yield read, False


def simplest(block: type[AbstractBlock]) -> tuple[str, PrintedLaw] | None:
    """The law with default options or, if the block cannot be created with these, with the first sufficient option."""
    base = base_of(block)
    law = law_of_type(block, **base[1]) if base is not None else None
    return (base[0], law) if base is not None and law is not None else None


def options_of(block: type[AbstractBlock]) -> Iterator[tuple[str, tuple[Line, ...]]]:
    """Each option of a block, such as ``leak``, with the lines of the law that it replaces or adds."""
    found = simplest(block)
    if found is None:
        return
    before = {item.whole.text for item in found[1].lines}
    for label, values in switched(block):
        law = law_of_type(block, **values)
        if law is not None:
            changed = tuple(item for item in law.lines if item.whole.text not in before)
            if changed:
                yield label, changed


@functools.lru_cache(maxsize=512)
def base_of(block: type[AbstractBlock]) -> tuple[str, dict[str, Any]] | None:
    """The smallest addition to the required parameters with which a block can be created: none, or one parameter."""
    given = [(name, {name: value}) for name, value in _free(block).items()]
    for label, values in [("", {}), *given, *_switches(block)]:
        if read_type(block, **values) is not None:
            return label, values
    return None


def switched(block: type[AbstractBlock]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Each option at a value other than its default, with a second option if required, or without the base."""
    found = base_of(block)
    if found is None:
        return
    label, base = found
    free = _free(block)
    for name, values in [*_switches(block), *((name, {name: value}) for name, value in free.items())]:
        if values.items() <= base.items():
            continue
        choices = [(name, {**base, **values})]
        choices += [(f"{name}, without {label}", values)] * bool(base)
        choices += [(f"{name} with {other}", {**base, **values, other: second}) for other, second in free.items()]
        yield from [way for way in choices if read_type(block, **way[1]) is not None][:1]


def _switches(block: type[AbstractBlock]) -> list[tuple[str, dict[str, Any]]]:
    fields = [(name, field) for name, field in block.model_fields.items() if name not in _known(block)]
    return [
        (f"{name}: {in_yaml(choice)}", {name: choice})
        for name, field in fields
        for choice in _choices(field.annotation, field.default)
    ]


def _free(block: type[AbstractBlock]) -> dict[str, Any]:
    """Parameters without a value by default."""
    known = specs(block).items()
    return {name: _some(spec) for name, spec in known if _is_off(block, name) and spec.form not in PAIRS}


def _known(block: type[AbstractBlock]) -> Set[str]:
    return specs(block).keys()


def _is_off(block: type[AbstractBlock], name: str) -> bool:
    field = block.model_fields[name]
    return not field.is_required() and field.default is None


def in_yaml(value: Any) -> str:
    """A value as a graph file writes it."""
    if isinstance(value, tuple):
        return f"[{', '.join(map(in_yaml, value))}]"
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:g}" if isinstance(value, float) else str(value)


def _choices(kind: Any, default: Any) -> Iterator[Any]:
    """Other values of an option: of a flag, of a choice of words, of a list of these."""
    if kind is bool:
        yield not default
    elif get_origin(kind) is Literal:
        yield from (word for word in get_args(kind) if word != default)
    elif get_origin(kind) is tuple and get_origin(get_args(kind)[0]) is Literal:
        words = get_args(get_args(kind)[0])
        yield from [words, *((word,) for word in words)]


def _some(spec: Spec, place: int = 0) -> Any:
    """Valid numbers for a parameter: three rows for a table, three increasing numbers for a list without a size.

    Vectors at different places have different directions, so that three of them are linearly independent.
    """
    if spec.form == "table":
        return tuple((float(row),) * _size(spec.shape.split()[-1]) for row in range(3))
    if spec.shape == "*":
        return (0.0, 1.0, 2.0)
    if spec.form == "vector" and spec.shape != "*":
        size = _size(spec.shape)
        return tuple(2.0 if k == place % size else 1.0 for k in range(size))
    return 1.0


def _size(word: str) -> int:
    return int(word) if word.isdigit() else _SIZES.get(word, 3)


def _sizes(block: AbstractBlock, chain: SerialChain | None) -> Sizes:
    sizes = Sizes()
    bound = {**_SIZES, **block.sizes(chain)}
    if chain is None and any("r" in port.shape.split() for port in block.inputs):
        bound["n"] = 6  # the Jacobian of a pose has full row rank only with 6 joints or more
    for letter, size in bound.items():
        sizes.bind(letter, size, "this page")
    return sizes


@functools.cache
def _arm() -> RobotFunctions:
    """Three joints in space, whose task is two coordinates."""
    one, zero = Fraction(1), Fraction(0)
    unit = ((one, zero, zero), (zero, one, zero), (zero, zero, one))
    limits = {"lower": -3.0, "upper": 3.0, "velocity": 1.0, "effort": 1.0}
    joints = tuple(
        Joint(f"joint_{axis}", "revolute", unit[axis], unit, (one, zero, one), **limits) for axis in (2, 1, 0)
    )
    link = tuple(Fraction(number) for number in ("2", "0.3", "0.1", "0.2", "0.5", "0", "0.6", "0", "0", "0.7"))
    chain = SerialChain(
        name="arm",
        joints=joints,
        tool=(one, zero, zero),
        tool_rotation=unit,
        inertia=(link,) * 3,
        gravity=(zero, zero, Fraction("-9.81")),
        axes="xy",
        rotation_change=0.0,
        friction_velocity=0.1,
        model=None,
        model_tool=0,
    )
    return RobotFunctions(SymbolicRobot(chain))
