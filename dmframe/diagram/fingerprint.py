"""The hash of a model: if it is equal, the model that was proved is the model that runs.

The model is the `ClosedLoop`, from which runs, code, exports, analyses and proofs take the map of a sample and the
flow, with the wires and the initial values of blocks.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import fields, is_dataclass
from enum import Enum
from fractions import Fraction
from typing import Any, Final

import casadi as ca
import numpy as np

from dmframe.block.certificate import SX
from dmframe.diagram.closed_loop import ClosedLoop, stack

SHORT: Final = 12
"""Number of digits of a hash that are printed with a verdict."""


def short(digits: str) -> str:
    """A hash as it is printed on a page."""
    return digits[:SHORT]


def fingerprint(loop: ClosedLoop, others: Mapping[str, Any] | None = None) -> str:
    """SHA-256 of a closed loop, in hexadecimal digits; `others` are further parts of the model, by name.

    It covers every field of the loop and of its parts: names, sizes, units, rates, next values, second-order terms,
    trajectories and their future values, random, measured and commanded signals, the sets and nominal rates of
    projections, outputs, parameters with their values, and all flags. It also covers the functions that the loop
    provides: the map of a sample, the flow, the plant's inputs over a sample, and the laws of projections. A field of
    an unknown type raises `TypeError`, so that no field is omitted.

    Expressions enter operation by operation; a number enters as the bits of its double. The hash does not depend on
    the layout of the graph file, on the clock, on the solver, or on the start pose of a run.

    It takes a few hundredths of a second for a robot with six joints, once for each diagram.
    """
    lines, expressions = list[str](), list[SX]()
    for line, expression in _walk("", {"loop": loop, "functions": _functions(loop), **(others or {})}):
        lines.append(line)
        if expression is not None:
            expressions.append(ca.densify(expression))
    digest = hashlib.sha256()
    for line in (*lines, *_function(stack(expressions))):
        digest.update(line.encode())
        digest.update(b"\n")
    return digest.hexdigest()


def _functions(loop: ClosedLoop) -> Mapping[str, Any]:
    """The functions that the loop provides, in its leaves."""
    return {
        "sample": loop.put_back(loop.advanced),
        "flow": loop.flow,
        "moves": [loop.moves_of(variable) for variable in loop.variables],
        "given": loop.held_over_a_sample,
        "laws": [projection.law for projection in loop.projections],
        "sets": loop.held(loop.state),
    }


def _walk(name: str, item: Any) -> Iterator[tuple[str, SX | None]]:
    """Each part of an object as a line of text, with the expression if it is one."""
    match item:
        case ca.SX():
            yield f"{name} {item.shape}", item
        case None | bool() | int() | str() | Fraction():
            yield f"{name} {item!r}", None
        case float():
            yield f"{name} {item.hex()}", None
        case Enum():
            yield f"{name} {type(item).__name__} {item.name}", None
        case np.ndarray():
            values = " ".join(float(value).hex() for value in item.ravel(order="F"))
            yield f"{name} {item.shape} {values}", None
        case Mapping():
            yield f"{name} {len(item)}", None
            for key, value in item.items():
                yield from _walk(f"{name}[{key!r}]", value)
        case Set():
            yield from _walk(name, sorted(item))
        case Sequence():
            yield f"{name} {len(item)}", None
            for place, value in enumerate(item):
                yield from _walk(f"{name}[{place}]", value)
        case _ if is_dataclass(item):
            yield f"{name} {type(item).__name__}", None
            for field in fields(item):
                yield from _walk(f"{name}.{field.name}", getattr(item, field.name))
        case _:
            raise TypeError(f"{name}: the hash of a model does not support {type(item).__name__}")


def _function(column: SX) -> Sequence[str]:
    """The names of the symbols, and the function of them as CasADi stores it: all operations, in order."""
    symbols = ca.symvar(column)
    return " ".join(symbol.name() for symbol in symbols), ca.Function("model", [stack(symbols)], [column]).serialize()
