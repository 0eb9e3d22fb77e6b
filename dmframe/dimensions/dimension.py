"""The powers of the base units that a quantity has, as a unit declares them, and as a unit is written."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from fractions import Fraction
from typing import Final, NamedTuple, final

from dmframe.units import base_units, factors

BASES: Final = ("g", "m", "s", "A", "K", "rad")
RAD: Final = BASES.index("rad")
_NEWTON: Final = {"g": 1, "m": 1, "s": -2}


Power = int | Fraction
"""An exponent; most are whole numbers, with which Python is faster."""


@final
class Dimension(NamedTuple):
    """Powers of the base units, and what is not known of them.

    Parameters
    ----------
    powers
        In the order of `BASES`.
    unknowns
        Powers of quantities whose own dimension is not known yet, by their number.
    angular
        The power of rad is known. It is not where a sine or a plain number has entered.
    number
        It comes from a number that is written out. In a sum such a number may be one of radians.
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
    powers = tuple(a + power * b for a, b in zip(one.powers, other.powers, strict=True))
    unknowns = dict(one.unknowns)
    for key, exponent in other.unknowns:
        unknowns[key] = unknowns.get(key, 0) + power * exponent
    left = tuple(sorted((key, exponent) for key, exponent in unknowns.items() if exponent))
    return Dimension(powers, left, one.angular and other.angular, one.number and other.number)


@functools.cache
def declared(unit: str) -> Dimension:
    """What a declared unit says; a plain number, and a unit with a mass in it, leave the power of rad open."""
    found = counted(unit)
    massive = any(base_units(name)[1] == {"g": 1} for name in factors(unit))
    return found._replace(angular=found != ONE and not massive)


def counted(unit: str) -> Dimension:
    """The powers in a unit, a lever's metres counted per radian."""
    _, powers = base_units(unit)
    forces = metres = 0
    for name, power in factors(unit).items():
        own = base_units(name)[1]
        forces += power * (own == _NEWTON)
        metres += power * (own == {"m": 1})
    angles = powers.get("rad", 0) - _levers(forces, metres)
    return Dimension(tuple({**powers, "rad": angles}.get(base, 0) for base in BASES))


def _levers(forces: int, metres: int) -> int:
    """How many of the metres are those of lever arms: one beside each newton, above the fraction or below it."""
    if forces * metres <= 0:
        return 0
    return min(abs(forces), abs(metres)) * (1 if forces > 0 else -1)


def spelled(dimension: Dimension) -> str:
    """A unit with these powers, such as a person writes it: N m/rad, not kg m^2/(s^2 rad^2)."""
    powers = dict(zip(BASES, dimension.powers, strict=True))
    if any(power.denominator != 1 for power in powers.values()):
        return _text({("kg" if base == "g" else base): power for base, power in powers.items()})
    return _text(_named(powers, angular=dimension.angular))


def _named(powers: Mapping[str, Power], *, angular: bool) -> dict[str, Power]:
    """The same powers of V, N and the base units that are left."""
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
