"""Dimensions: powers of the base units, read from declared units and written as units."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from fractions import Fraction
from typing import Final, NamedTuple, final

from dmframe.common.units import base_units, factors

BASES: Final = ("g", "m", "s", "A", "K", "rad")
RAD: Final = BASES.index("rad")
_NEWTON: Final = {"g": 1, "m": 1, "s": -2}


Power = int | Fraction
"""An exponent; most are integers, with which Python is faster."""


@final
class Dimension(NamedTuple):
    """Powers of the base units, with unknown parts.

    Parameters
    ----------
    powers
        In the order of `BASES`.
    unknowns
        Powers of quantities whose own dimension is not known yet, by their number.
    angular
        The power of rad is known. It is unknown after a sine or a plain number.
    number
        It comes from a literal number. In a sum such a number may be in radians.
    """

    powers: tuple[Power, ...]
    unknowns: tuple[tuple[int, Power], ...] = ()
    angular: bool = True
    number: bool = False

    @property
    def plain(self) -> bool:
        """True for a number, or an angle."""
        return not self.unknowns and not any(self.powers[:RAD])


ONE: Final = Dimension((0,) * len(BASES))
NUMBER: Final = ONE._replace(number=True)
PLAIN: Final = ONE._replace(angular=False)


def product(one: Dimension, other: Dimension, power: Power = 1) -> Dimension:
    """One * other^power."""
    powers = one.powers
    if any(other.powers):
        powers = tuple(_plain(a + power * b) for a, b in zip(powers, other.powers, strict=True))
    left = one.unknowns
    if other.unknowns:
        unknowns = dict(left)
        for key, exponent in other.unknowns:
            unknowns[key] = _plain(unknowns.get(key, 0) + power * exponent)
        left = tuple(sorted((key, exponent) for key, exponent in unknowns.items() if exponent))
    return Dimension(powers, left, one.angular and other.angular, one.number and other.number)


def _plain(power: Power) -> Power:
    """The same power, as an integer if it is one."""
    return power.numerator if power.denominator == 1 else power


@functools.cache
def declared(unit: str) -> Dimension:
    """The dimension of a declared unit; for a plain number and a unit with kg the power of rad is unknown."""
    found = counted(unit)
    massive = any(base_units(name)[1] == {"g": 1} for name in factors(unit))
    return found._replace(angular=found != ONE and not massive)


def counted(unit: str) -> Dimension:
    """The powers in a unit; the metres of a lever arm count as metres per radian."""
    _, powers = base_units(unit)
    forces = metres = 0
    for name, power in factors(unit).items():
        own = base_units(name)[1]
        forces += power * (own == _NEWTON)
        metres += power * (own == {"m": 1})
    angles = powers.get("rad", 0) - _levers(forces, metres)
    return Dimension(tuple({**powers, "rad": angles}.get(base, 0) for base in BASES))


def _levers(forces: int, metres: int) -> int:
    """Number of metres that are lever arms: one with each newton, in the numerator or the denominator."""
    if forces * metres <= 0:
        return 0
    return min(abs(forces), abs(metres)) * (1 if forces > 0 else -1)


def spelled(dimension: Dimension) -> str:
    """The usual unit with these powers: N m/rad, not kg m^2/(s^2 rad^2)."""
    powers = dict(zip(BASES, dimension.powers, strict=True))
    if any(power.denominator != 1 for power in powers.values()):
        return _text({("kg" if base == "g" else base): power for base, power in powers.items()})
    return _text(_named(powers, angular=dimension.angular))


def _named(powers: Mapping[str, Power], *, angular: bool) -> dict[str, Power]:
    """The same powers, expressed in V, N and the remaining base units."""
    names = {"V": -powers["A"], "N": 0, "kg": powers["g"], **{base: powers[base] for base in BASES[1:]}}
    for base, each in (("kg", 1), ("m", 2), ("s", -3), ("A", -1)):
        names[base] -= names["V"] * each
    if names["kg"] < 0 or names["s"]:
        names["N"], names["kg"] = names["kg"], 0
        names["m"] -= names["N"]
        names["s"] += 2 * names["N"]
    names["rad"] = (names["rad"] + _levers(int(names["N"]), int(names["m"]))) * angular
    return names


def _text(names: Mapping[str, Power]) -> str:
    def side(sign: int) -> list[str]:
        return [
            name if sign * power == 1 else f"{name}^{sign * power}" for name, power in names.items() if sign * power > 0
        ]

    above, below = " ".join(side(1)), side(-1)
    if not below:
        return above or "a plain number"
    return f"{above or '1'}/{below[0] if len(below) == 1 else '(' + ' '.join(below) + ')'}"
