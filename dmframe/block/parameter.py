"""Parameters of blocks: numbers with shape, unit and sign, read from a graph file or from Python.

A block declares ``Gamma: Diagonal = Positive("p")``. Every expression of the diagram contains the number as a named
symbol, ``dynamics.Gamma``; its value is used in a run only.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import Any, final

import numpy as np
from pydantic import BaseModel, Field
from pydantic.fields import FieldInfo

from dmframe.block.gain import Prior, check_definite
from dmframe.common.errors import nearest
from dmframe.common.units import Stated, joint_quantity, of_sliding, to_unit

Scalar = float
"""One number."""
Diagonal = float | tuple[float, ...]
"""A positive diagonal matrix, or a column; a single number sets all elements."""
Gain = float | tuple[float, ...] | tuple[tuple[float, ...], ...] | Prior
"""A symmetric positive definite matrix: its rows, its diagonal, a number times the identity, or a model's prior."""
Vector = tuple[float, ...]
"""A column with all elements listed."""
Table = tuple[tuple[float, ...], ...]
"""Rows of numbers."""
Box = tuple[Diagonal, Diagonal] | None
"""An interval with a lower and an upper bound for each element; none for no bound."""

Ball = tuple[Diagonal, Diagonal] | None
"""A centre, and a radius or the semi-axes of an ellipsoid; none for no bound."""

KEY = "x-dmframe"


PAIRS = {"box": "an interval [lower, upper]", "ball": "a ball [centre, radius]"}
"""Parameter forms with two numbers or lists, and how they are written."""


@final
@dataclass(frozen=True, slots=True)
class Spec:
    """Declaration of a parameter: shape and unit as of a port, required sign, and form of its value.

    `several`: the number is used for quantities with different SI units; `unit` is one of them.
    """

    shape: str
    unit: str
    sign: str = ""
    form: str = "diagonal"
    several: bool = False

    @property
    def of_joints(self) -> bool:
        """True for joint angles or their rates; for a prismatic joint the quantity is a length."""
        return self.shape.split()[-1:] == ["n"] and bool(of_sliding(self.unit))


def Real(shape: str = "", unit: str = "", *, default: Any = ..., spread: bool = True) -> Any:
    """A parameter of any sign. `spread`: one number may set all elements."""
    return _field(Spec(shape, unit, "", "diagonal" if spread else "vector"), default)


def Positive(shape: str = "", unit: str = "", *, default: Any = ..., several: bool = False) -> Any:
    """A parameter with positive elements. `several`: its number is used for quantities with different units."""
    return _field(Spec(shape, unit, "> 0", several=several), default)


def PositiveDefinite(shape: str, unit: str = "") -> Any:
    """A gain: a symmetric positive definite matrix, or its diagonal, which is a column in equations."""
    return _field(Spec(shape, unit, "> 0", "gain"), ...)


def NonNegative(shape: str = "", unit: str = "", *, default: Any = ...) -> Any:
    """A parameter with nonnegative elements."""
    return _field(Spec(shape, unit, ">= 0"), default)


def Interval(shape: str = "", unit: str = "", *, default: Any = None, several: bool = False) -> Any:
    """A box ``[lower, upper]`` for a state of this shape; the state has no bound if neither value nor default is given.

    `several`: its bounds are used for quantities with different units.
    """
    return _field(Spec(shape, unit, "", "box", several), default)


def Around(shape: str = "", unit: str = "") -> Any:
    """A ball ``[centre, radius]`` for a state of this shape, an ellipsoid ``[centre, semi-axes]``, or no bound."""
    return _field(Spec(shape, unit, "", "ball"), None)


def Rows(columns: str, unit: str = "", *, count: str = "*", default: Any = ...) -> Any:
    """Rows of numbers; `columns` is the letter of their length, `count` the letter of their number, ``*`` for any."""
    return _field(Spec(f"{count} {columns}", unit, "", "table"), default)


def _field(spec: Spec, default: Any) -> Any:
    return Field(default, json_schema_extra={KEY: asdict(spec)}, validate_default=True)


def spec_of(field: FieldInfo) -> Spec | None:
    """The `Spec` of a pydantic field; None if the field is not a number (an option, a name)."""
    extra = field.json_schema_extra
    return Spec(**extra[KEY]) if isinstance(extra, dict) and KEY in extra else None  # type: ignore[arg-type]  # `asdict` above


def specs(block: type[BaseModel]) -> dict[str, Spec]:
    """All numeric parameters of a block class."""
    found = {name: spec_of(field) for name, field in block.model_fields.items()}
    return {name: spec for name, spec in found.items() if spec is not None}


def read(value: Any, spec: Spec) -> Any:
    """A parameter's value in its own unit, from numbers, strings such as ``"90 ms"`` and lists of these.

    Raises `ValueError` with the expected and the found value.
    """
    if value is None and spec.form in PAIRS:
        return None
    if spec.form == "gain":
        return _gain(value, spec)
    numbers = _numbers(value, spec)
    depth = _depth(numbers)
    if spec.form in PAIRS:
        return _pair(numbers, value, spec)
    wanted = {"diagonal": (0, 1) if spec.shape else (0,), "vector": (1,), "table": (2,)}[spec.form]
    if depth not in wanted:
        raise ValueError(f"expected {_form(spec)}, found {_shown(value)}")
    last = spec.shape.split()[-1] if spec.shape else ""
    row = numbers[0] if depth == 2 else numbers
    if last.isdecimal() and depth and len(row) != int(last):  # a fixed size, on which blocks may rely
        rows = "rows of " if depth == 2 else ""
        raise ValueError(f"expected {rows}{last} numbers{_in(spec)}, found {len(row)} in {_shown(value)}")
    return numbers


def _numbers(value: Any, spec: Spec) -> Any:
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, list | tuple):
        if not value:
            raise ValueError(f"expected {_form(spec)}, found an empty list")
        return tuple(_numbers(item, spec) for item in value)
    if isinstance(value, bool) or not isinstance(value, int | float | str | np.floating | np.integer):
        raise ValueError(f"expected {_form(spec)}, found {_shown(value)}")
    try:
        number = (joint_quantity if spec.of_joints else to_unit)(
            value if isinstance(value, str) else float(value), spec.unit
        )
    except OverflowError:
        raise ValueError(f"expected a finite number, found {_shown(value)}") from None
    if not math.isfinite(number):
        raise ValueError(f"expected a finite number, found {_shown(value)}")
    if (spec.sign == "> 0" and number <= 0) or (spec.sign == ">= 0" and number < 0):
        raise ValueError(f"expected a number {spec.sign}, found {_shown(value)}")
    return number


def with_stated(checked: Any, read: Any) -> Any:
    """Validated numbers, with the units in which joint quantities were stated."""
    if isinstance(read, tuple) and isinstance(checked, tuple) and len(read) == len(checked):
        return tuple(map(with_stated, checked, read))
    return read if isinstance(read, Stated) else checked


def joint_faults(value: Any, spec: Spec, joints: Sequence[Any]) -> Iterator[str]:
    """Faults of units in a list over joints: a revolute joint requires an angle, a prismatic one a length."""
    if isinstance(value, tuple) and any(isinstance(item, tuple) for item in value):
        for item in value:
            yield from joint_faults(item, spec, joints)
        return
    items = value if isinstance(value, tuple) else (value,) * max(1, len(joints))
    for k, item in enumerate(items):
        known = k < len(joints) and len(items) == len(joints)
        wanted = of_sliding(spec.unit) if known and joints[k].kind == "prismatic" else spec.unit
        if getattr(item, "unit", wanted) != wanted:
            what = (
                f"{joints[k].name}: it {'turns' if wanted == spec.unit else 'slides'}" if known else "a revolute joint"
            )
            yield f"expected a quantity in {wanted} for {what}; found {float(item):.6g} {item.unit}"


def _pair(numbers: Any, value: Any, spec: Spec) -> tuple[Any, Any]:
    if not isinstance(numbers, tuple) or len(numbers) != 2 or any(_depth(end) not in (0, 1) for end in numbers):
        raise ValueError(f"expected {PAIRS[spec.form]}, found " + _shown(value))
    first, second = numbers
    if _depth(first) == _depth(second) == 1 and len(first) != len(second):
        names = "lower bounds as upper bounds" if spec.form == "box" else "coordinates of the centre as semi-axes"
        raise ValueError(f"expected as many {names}, found {len(first)} and {len(second)}")
    if spec.form == "box" and np.any(np.asarray(first) > np.asarray(second)):
        raise ValueError(f"expected lower <= upper, found {_shown(value)}")
    if spec.form == "ball" and np.any(np.asarray(second) <= 0):
        raise ValueError(f"expected a radius > 0, found {_shown(value)}")
    return first, second


def _gain(value: Any, spec: Spec) -> Any:
    if isinstance(value, Prior):
        return value
    if isinstance(value, Mapping) and "inverse_of" in value:
        return _prior(value)
    rows = _numbers(value, replace(spec, sign=""))
    if isinstance(rows, tuple) and {_depth(row) for row in rows} == {1} and _depth(rows) < 0:
        lengths = " and ".join(str(length) for length in dict.fromkeys(map(len, rows)))
        raise ValueError(f"expected rows of one length, found rows of {lengths} numbers in {_shown(value)}")
    if _depth(rows) == 2:
        try:
            check_definite(rows)
        except OverflowError:
            raise ValueError(f"expected a matrix with elements of moderate size, found {_shown(value)}") from None
        return rows
    if _depth(rows) not in (0, 1):
        raise ValueError(f"expected {_form(spec)}, found {_shown(value)}")
    return _numbers(value, spec)


def _prior(value: Mapping[str, Any]) -> Prior:
    positive, known = Spec("", "", "> 0"), [item.name for item in fields(Prior)]
    for key in value:
        if key not in known:
            raise ValueError(f"expected the keys {', '.join(known)}; {nearest(str(key), known)}")
    if not isinstance(value["inverse_of"], str):
        raise ValueError(f"expected inverse_of to name a block, found {_shown(value['inverse_of'])}")
    return Prior(value["inverse_of"], *(read(value.get(key, 1.0), positive) for key in known[1:]))


def _depth(value: Any) -> int:
    """Nesting depth of lists; -1 if they are ragged."""
    if not isinstance(value, tuple):
        return 0
    depths, lengths = {_depth(item) for item in value}, {len(item) for item in value if isinstance(item, tuple)}
    return 1 + depths.pop() if len(depths) == 1 and len(lengths) <= 1 and -1 not in depths else -1


def _form(spec: Spec) -> str:
    unit = _in(spec)
    if spec.form in PAIRS:
        return f"{PAIRS[spec.form]}{unit}"
    if spec.form == "table":
        return f"a list of rows of equal length{unit}"
    if spec.form == "vector":
        return f"a list of numbers{unit}"
    if spec.form == "gain":
        return f"a number{unit}, a list of numbers, or the rows of a symmetric positive definite matrix"
    return f"a number{unit}" + (" or a list of numbers" if spec.shape else "")


def _in(spec: Spec) -> str:
    return f" in {spec.unit}" if spec.unit else ""


def _shown(value: Any) -> str:
    """The value as it is written in its file."""
    if value is None:
        return "nothing"
    text = str(value).lower() if isinstance(value, bool) else repr(value)
    return text if len(text) <= 40 else text[:37] + "..."


def array(value: Any, spec: Spec, size: Sequence[int]) -> np.ndarray:
    """The value as an array of the bound size; a single number fills it.

    A box has a last axis of two, lower and upper bound, and so has a ball, centre and radius. A gain that is a full
    matrix has two axes of that size.
    Raises `ValueError` if the size does not match.
    """
    if spec.form in PAIRS:
        ends = [array(end, Spec(spec.shape, spec.unit), size) for end in value]
        return np.stack([np.atleast_1d(end) for end in ends], axis=-1)
    numbers = np.asarray(value, dtype=float)
    if spec.form == "gain" and numbers.ndim == 2:
        size = (*size, *size)
    if numbers.ndim and numbers.shape != tuple(size):
        raise ValueError(f"expected {list(size)} numbers, found {list(numbers.shape)}")
    return np.broadcast_to(numbers, tuple(size)).copy() if numbers.ndim == 0 else numbers
