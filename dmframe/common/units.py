"""Quantities with units, as written in graphs: ``90 ms``, ``-90 deg``, ``800 N m s/rad``.

A unit's factors are separated by spaces, and everything after the slash divides: ``N m s/rad`` is N*m*s/rad and
``J/kg K`` is J/(kg*K). Unlike in SI the radian is a base unit: a joint velocity of ``2 Hz`` would otherwise be read as
2 rad/s, wrong by 2 pi. Conversions are exact until the last step, so that ``35 ms`` is the float nearest to 0.035.
"""

from __future__ import annotations

import functools
import math
import re
from collections import Counter
from collections.abc import Mapping
from decimal import Decimal
from fractions import Fraction
from typing import Final

from dmframe.common.errors import DmframeError, UnitError, ValueFault, nearest

_DEFINITIONS: Final = """
m metre meter
s second
g gram
rad radian
A ampere
K kelvin
min minute = 60 s
h hour = 3600 s
turn rev = 6.28318530717958647692528676655900576839433879875020 rad
deg degree ° = 1/360 turn
rpm = 1 turn/min
Hz hertz = 1 1/s
N newton = 1 kg m/s^2
Pa pascal = 1 N/m^2
J joule = 1 N m
W watt = 1 J/s
V volt = 1 W/A
Ω ohm = 1 V/A
% percent = 1/100
"""
_PREFIXES_OF: Final = {
    "giga G": 9,
    "mega M": 6,
    "kilo k": 3,
    "centi c": -2,
    "milli m": -3,
    "micro µ μ u": -6,
    "nano n": -9,
}
_DIVIDING: Final = ("s", "m")
_BASES: Final = ("m", "s", "g", "rad", "A", "K")
_SPELLINGS = ("m", "mm", "s", "ms", "min", "h", "rad", "deg", "turn", "rpm", "Hz", "kg", "N", "J", "W", "V", "A", "%")
_WORDS = {"sec": "s", "newton": "N", "volt": "V", "ampere": "A", "joule": "J", "watt": "W"}
"""Unsupported spellings, with the unit that is meant."""

_NUMBER = re.compile(r"\s*([+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)(.*)", re.DOTALL)
_NOT_FINITE = re.compile(r"\s*[+-]?\.?(nan|inf|infinity)\b", re.IGNORECASE)
_TOKEN = re.compile(r"[^\W\d_]+|[%°]|\^[+-]?\d(?!\d)|[()/]|1(?![\d.])|[\s*·]+")
_LONGEST = 80  # characters of a unit
_LARGEST = 400  # decimal exponent or count of digits up to which a number is converted exactly

# powers of ten that a prefix may show, by the unit's first factor, without kiloseconds and the like
_PREFIXES = {-9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M"}
_LARGE = dict.fromkeys(("N", "J", "W", "V", "A", "Pa"), (-6, 6))
_PREFIXED = {"m": (-9, 3), "s": (-9, 0), "rad": (-6, 0), "Hz": (0, 6), **_LARGE}


def to_unit(value: str | float, unit: str) -> float:
    """Convert `value` to a number of `unit`; a plain number is in `unit` already.

    A bandwidth in 1/s may be given as an angular frequency: ``15 rad/s`` is 15 1/s.

    Raises `UnitError` if a unit is unknown or cannot be converted, `ValueFault` if there is no finite number.
    """
    wanted = f"a quantity in {unit}" if unit else "a plain number"
    expected = f"expected {wanted}, found {shorten(repr(value))}"
    if isinstance(value, str):
        return _converted(value, unit, expected)
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ValueFault(f"{expected}: give a number" + (f" or a text such as '1 {unit}'" if unit else ""))
    return _finite(value, expected)


def seconds(what: str, value: float | str) -> float:
    """A positive time [s]. Raises `ValueFault`."""
    try:
        found = to_unit(value, "s")
    except DmframeError as error:
        raise ValueFault(f"{what} {shorten(str(value))}: {error.text}") from None
    if not found > 0:
        raise ValueFault(f"{what} {shorten(str(value))}: expected a time above zero")
    return found


class Stated(float):
    """Joint coordinate with its unit, ``rad`` or ``m``, which must match the kind of joint."""

    unit: str

    def __new__(cls, value: float, unit: str) -> Stated:
        """A number in that unit."""
        made = super().__new__(cls, value)
        made.unit = unit
        return made

    def __getnewargs__(self) -> tuple[float, str]:  # type: ignore[override]
        return float(self), self.unit


def joint_place(value: str | float) -> float:
    """Convert a joint coordinate as `to_unit`: a text in radians or metres to `Stated`, a plain number to a number.

    Raises `UnitError`, `ValueFault`.
    """
    return joint_quantity(value, "rad")


def joint_quantity(value: str | float, unit: str) -> float:
    """The same of ``rad``, ``rad/s`` and ``rad/s^2``, in which a sliding joint has ``m``, ``m/s`` and ``m/s^2``."""
    if not isinstance(value, str):
        return to_unit(value, unit)
    try:
        found = to_unit(value, unit)
    except UnitError:
        sliding = of_sliding(unit)
        try:
            return Stated(to_unit(value, sliding), sliding)
        except UnitError:
            pass
        raise
    return found if _PLAIN.fullmatch(value.strip()) else Stated(found, unit)


def of_sliding(unit: str) -> str:
    """The unit of a sliding joint's quantity that has this unit for a joint that turns; empty where there is none."""
    return f"m{unit.removeprefix('rad')}" if unit == "rad" or unit.startswith("rad/s") else ""


_PLAIN = re.compile(r"[-+]?[\d.]+([eE][-+]?\d+)?")


def compatible(unit_a: str, unit_b: str) -> bool:
    """True for two spellings of the same unit: ``N m s/rad`` and ``N m/(rad/s)``, but not m and mm.

    Raises `UnitError` for an unknown unit.
    """
    return unit_a == unit_b or _size(unit_a) == _size(unit_b)


def is_rate(unit: str, of: str) -> bool:
    """True if a unit is that of the time derivative of a quantity: rad/s of rad, m/s^2 of m/s."""
    (scale, powers), (other, below) = base_units(unit), base_units(of)
    expected = Counter(below)
    expected["s"] -= 1
    return scale == other and all(powers.get(name, 0) == expected[name] for name in {*powers, *expected})


def base_units(unit: str) -> tuple[Fraction, dict[str, int]]:
    """Factor and powers of the base units m, s, g, rad, A and K: for N, 1000 g m/s^2."""
    scale, dimension = _size(unit)
    return scale, dict(dimension)


def plain(value: float, unit: str, digits: int = 3) -> str:
    """Format a quantity, rounded to significant digits, with an SI prefix: ``90 ms``."""
    if not math.isfinite(value):
        return f"{value} {unit}".rstrip()
    rounded = Decimal(f"{value:.{digits - 1}e}")
    first = re.match(r"[^\W\d_]+(?!\^)\b", unit)
    least, greatest = _PREFIXED.get(first.group(), (0, 0)) if first else (0, 0)
    power = min(max(rounded.adjusted() // 3 * 3, least), greatest) if rounded else 0
    return f"{float(rounded.scaleb(-power)):.{max(digits, 6)}g} {_PREFIXES[power]}{unit}".rstrip()


def rounded_up(value: float, digits: int = 3) -> float:
    """The next number with that many digits."""
    step = 10.0 ** (math.floor(math.log10(value)) - digits + 1) if value > 0 else 1.0
    return math.ceil(value / step) * step


def rounded_down(value: float, digits: int = 3) -> float:
    """The number with that many digits that is equal or next below; for positive values."""
    step = 10.0 ** (math.floor(math.log10(value)) - digits + 1) if value > 0 else 1.0
    return math.floor(value / step) * step


def rate_over(unit: str) -> str:
    """Unit of a rate over a quantity: ``1/(m s)`` for m, ``1/rad`` for rad/s."""
    powers = Counter[str]()
    powers.subtract(factors(unit))
    powers["s"] -= 1
    above, below = (
        [f"{name}^{sign * power}" if sign * power > 1 else name for name, power in powers.items() if sign * power > 0]
        for sign in (1, -1)
    )
    under = below[0] if len(below) == 1 else f"({' '.join(below)})"
    return (" ".join(above) or "1" * bool(below)) + f"/{under}" * bool(below)


def shorten(text: str, most: int = 60) -> str:
    """Shorten a text to quote in a message."""
    return text if len(text) <= most else text[:most] + "..."


def sliding(unit: str) -> str:
    """Convert a revolute joint's unit to that of a prismatic one: m for rad, and N for N m.

    >>> sliding("N m s/rad")
    'N s/m'
    """
    force = re.sub(r"\bN(\^\d)? m(\^\d)?(?![\w])", r"N\1", unit)
    return re.sub(r"\brad\b", "m", force)


def _converted(text: str, unit: str, expected: str) -> float:
    read = _NUMBER.fullmatch(text)
    if _NOT_FINITE.match(text):
        raise ValueFault(f"{expected}: the number must be finite")
    if read is None:
        raise ValueFault(f"{expected}: begin with a number")
    if re.match(r"\s*,\d", read.group(2)):
        raise UnitError(f"{expected}: a number has a decimal point, not a comma")
    digits, found = read.group(1), read.group(2).strip() or unit
    try:
        (scale, dimension), (target_scale, target) = _size(found), _size(unit)
    except UnitError as fault:
        raise UnitError(f"{expected}: {fault.text}") from None
    if dimension != target and not (target == {"s": -1} and dimension == {"s": -1, "rad": 1}):
        why = _why_not(found, unit, dimension, target)
        if dimension and {key: -power for key, power in dimension.items()} == target:
            inverse = 1 / number if (number := float(digits) * float(scale * target_scale)) else math.inf
            why += f"; one over it can: {plain(inverse, unit, 6)}" if inverse and math.isfinite(inverse) else ""
        raise UnitError(f"{expected}: {why}")
    # a larger power of ten would fill the memory
    huge = len(digits) > _LARGEST or abs(int(digits.lower().partition("e")[2] or 0)) > _LARGEST
    exact = Fraction(_finite(float(digits), expected)) if huge else Fraction(digits)
    return _finite(exact * scale / target_scale, expected)


def _finite(value: float | Fraction, expected: str) -> float:
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise ValueFault(f"{expected}: the number must be finite")
    return number


def _why_not(found: str, unit: str, dimension: Mapping[str, int], target: Mapping[str, int]) -> str:
    if {**dimension, "rad": 0} == {**target, "rad": 0}:
        return f"{found} and {unit or 'a plain number'} differ by an angle; write rad, deg or turn"
    return f"{found} cannot be converted to {unit or 'a plain number'}{_divided(found, dimension, target)}"


def _divided(found: str, dimension: Mapping[str, int], target: Mapping[str, int]) -> str:
    """Hint for a unit without a division by seconds or metres: deg for rad/s, kN for N/m."""
    ratio = {key: target.get(key, 0) - dimension.get(key, 0) for key in {*dimension, *target}}
    (name, power), *others = [(key, value) for key, value in ratio.items() if value] or [("", 0)]
    if not dimension or others or name not in _DIVIDING or power not in (-1, -2):
        return ""
    if any(_named(factor)[1] == {name: 1} for factor, exponent in factors(found).items() if exponent > 0):
        return ""  # it would cancel
    below = name if power == -1 else f"{name}^2"
    if "/" in found:
        return f"; did you mean {found}^2?" if found.endswith(f"/{name}") and power == -1 else ""
    return f"; did you mean {found}/{below}?"


@functools.cache
def _size(unit: str) -> tuple[Fraction, dict[str, int]]:
    """Factor to base units, and their exponents."""
    scale, dimension = Fraction(1), Counter[str]()
    for name, exponent in factors(unit).items():
        factor, base = _named(name)
        scale *= factor**exponent
        for key, power in base.items():
            dimension[key] += power * exponent
    return scale, {key: power for key, power in dimension.items() if power}


@functools.cache
def _named(name: str) -> tuple[Fraction, dict[str, int]]:
    """Factor and exponents of one name, such as mm."""
    known = _known(name)
    if known is None:
        pairs = ((name[:cut], name[cut:]) for cut in range(1, len(name)))
        right = [spelling for spelling in _SPELLINGS if spelling.lower() == name.lower()]
        right += [short for long, short in _WORDS.items() if name.lower() in (long, f"{long}s")]
        right += [
            " ".join(pair) for pair in pairs if all(map(_known, pair)) and _named(pair[0])[1] != _named(pair[1])[1]
        ]
        hint = f"did you mean {right[0]}?" if right else nearest(name, _SPELLINGS)
        raise UnitError(f"unknown unit {name}; {hint}")
    power, number, unit = known
    scale, dimension = (Fraction(1), {unit: 1}) if unit in _BASES else _size(unit) if unit else (Fraction(1), {})
    return Fraction(10) ** power * number * scale, dict(dimension)


def _known(name: str) -> tuple[int, Fraction, str] | None:
    """Power of ten of the prefix, factor, and unit of its definition; None for an unknown unit."""
    units, prefixes = _table()
    for prefix, power in prefixes.items():
        if name.startswith(prefix) and (rest := name.removeprefix(prefix)) in units:
            return power, *units[rest]
    return None


@functools.cache
def _table() -> tuple[dict[str, tuple[Fraction, str]], dict[str, int]]:
    """Units by name, with factor and unit of the definition; and prefixes, including the empty one."""
    units = dict[str, tuple[Fraction, str]]()
    for line in _DEFINITIONS.strip().splitlines():
        left, _, definition = line.partition(" = ")
        names, (number, _, unit) = left.split(), definition.partition(" ")
        names += [f"{name}s" for name in names if len(name) > 2]  # Pas and Ns are products, written with a space
        units |= dict.fromkeys(names, (Fraction(number), unit) if definition else (Fraction(1), names[0]))
    return units, {"": 0} | {name: power for names, power in _PREFIXES_OF.items() for name in names.split()}


def factors(unit: str) -> Counter[str]:
    """Parse ``N m s/rad`` to ``{N: 1, m: 1, s: 1, rad: -1}``."""
    text = unit.replace("**", "^").strip()
    tokens = [token.strip(" *·\t\n") for token in _TOKEN.findall(text)]
    readable = len(text) <= _LONGEST and not _TOKEN.sub("", text)
    waiting = [token for token in reversed(tokens) if token]
    found = _quotient(waiting) if readable and waiting else Counter[str]()
    if not readable or found is None or waiting:
        raise UnitError(
            f"cannot read {text[:_LONGEST]!r} as a unit; write it like N m s/rad or m/s^2: "
            "spaces multiply, everything after the one slash divides"
        )
    return found


def _quotient(waiting: list[str]) -> Counter[str] | None:
    """Parse ``product[/product]`` from the end of `waiting`; None if it is invalid."""
    factors = _product(waiting)
    if factors is not None and waiting and waiting[-1] == "/":
        waiting.pop()
        below = _product(waiting)
        if below is None:
            return None
        factors.subtract(below)
    return factors


def _product(waiting: list[str]) -> Counter[str] | None:
    product, empty = Counter[str](), True
    while waiting and waiting[-1] not in {"/", ")"}:
        token, empty = waiting.pop(), False
        if token == "(":
            inner = _quotient(waiting)
            if inner is None or not waiting or waiting.pop() != ")":
                return None
            product.update(inner)
        elif token.startswith("^"):
            return None
        elif token != "1":
            product[token] += int(waiting.pop()[1:]) if waiting and waiting[-1].startswith("^") else 1
    return None if empty else product
