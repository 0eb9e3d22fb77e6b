"""One random point of a prime field, at which expressions are evaluated."""

from __future__ import annotations

import random
from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import Final

CIRCLE: Final = "cos, sin"
SIGN: Final = "sign"
SIGN_LIMIT: Final = 5
"""Number of different signs for which all values are tried; one trial then takes at most 3**5 evaluations."""


class ZeroDivision(ArithmeticError):
    """A denominator vanishes at this point: draw another one."""


class Trial:
    """A prime, a source of random numbers, and the values already chosen for functions that a field does not have.

    Equal arguments have equal values during the whole trial, also in the evaluations of two tapes.

    - sin and cos of one argument are one random point of the unit circle, ((1-t^2)/(1+t^2), 2t/(1+t^2)); cos is
      even and sin is odd.
    - sign is odd and takes the values +1, -1 and 0. A random choice would miss (sign x + 1)(sign y + 1) three times in
      four, so `next_signs` walks through all choices; beyond `SIGN_LIMIT` signs it is a free value.
    - fabs(x) is x sign(x). It is continuous: an identity on both sides of x = 0 with absolute values alone is valid at
      x = 0 too, so that a sign is 0 only if the operation is sign itself. Then |x| can be evaluated as 0 or as x, both
      true at x = 0; an identity must be valid in one of these evaluations (`fabs_is_argument_at_zero`).
    - Any other function is a free random value, including fmin, fmax, comparisons, if_else and floor. This is sound,
      also at switching points: an identity that is valid for free values is valid for the function's values. It is not
      complete: tanh(x) + tanh(-x) = 0 and fmin(x, y) + fmax(x, y) = x + y are not detected. if_else_zero and "not" have
      their values if the condition is 0 or 1, or if the value is 0.

    These rules do not apply to derivatives: jumps, which have none, must be excluded beforehand.
    """

    def __init__(self, prime: int, rng: random.Random, functions: Mapping[str, Sequence[int]] | None = None) -> None:
        self.prime = prime
        self.rng = rng
        self._values: dict[tuple[str, tuple[int, ...]], int] = {}
        self._circle: dict[int, tuple[int, int]] = {}
        self._signs: dict[int, int] = {}
        self._script: list[int] = []
        self._places: dict[int, int] = {}
        self._jumping: set[int] = set()
        self.fabs_is_argument_at_zero = False
        self._inverses: dict[int, int] = {1: 1}  # the same denominators recur in each fault
        for name, values in (functions or {}).items():
            kind, _, argument = name.partition(" of ")
            if kind == CIRCLE:
                self._circle[int(argument)] = (values[0], values[1])
            elif kind == SIGN:
                self._signs[int(argument)] = values[0]
            else:
                self._values[kind, tuple(map(int, argument.split(", ")))] = values[0]

    @property
    def functions(self) -> dict[str, tuple[int, ...]]:
        """Values chosen so far, by function and argument; another trial with these values evaluates identically.

        ``{"cos, sin of 12": (3, 4), "tanh of 5": (6,), "sign of 7": (-1,)}``
        """
        chosen: dict[str, tuple[int, ...]] = {f"{CIRCLE} of {key}": pair for key, pair in self._circle.items()}
        chosen |= {f"{SIGN} of {key}": (value,) for key, value in self._signs.items()}
        named = {f"{name} of {', '.join(map(str, at))}": (value,) for (name, at), value in self._values.items()}
        return chosen | named

    def random(self) -> int:
        """A uniformly random residue."""
        return self.rng.randrange(self.prime)

    def residue(self, value: Fraction | float | int) -> int:
        """The exact rational value as a residue; raises `ZeroDivision` if the prime divides its denominator."""
        if isinstance(value, int):
            return value % self.prime
        numerator, denominator = value.as_integer_ratio()
        return numerator * self.inverse(denominator) % self.prime

    number = residue

    def reduced(self, value: int) -> int:
        """The residue of an unreduced sum."""
        return value % self.prime

    def power(self, value: int, exponent: int) -> int:
        """An integer power; raises `ZeroDivision`."""
        return pow(value if exponent >= 0 else self.inverse(value), abs(exponent), self.prime)

    def call(self, name: str, *arguments: int) -> int:
        """The value of a function at numbers that need not be reduced."""
        given = tuple([argument % self.prime for argument in arguments])
        if name in ("cos", "sin"):
            return self.cos_sin(given[0])[name == "sin"]
        if name in ("sign", "fabs"):
            return (self.sign if name == "sign" else self.size)(given[0])
        return self.opaque(name, given)

    def inverse(self, value: int) -> int:
        """1 / value; raises `ZeroDivision`."""
        known = self._inverses.get(value)
        if known is None:
            try:
                known = self._inverses[value] = pow(value, -1, self.prime)
            except ValueError:
                raise ZeroDivision(f"a denominator vanishes modulo {self.prime}") from None
        return known

    def inverse_matrix(self, rows: Sequence[Sequence[int]]) -> list[list[int]]:
        """The inverse of a square matrix of numbers that need not be reduced; raises `ZeroDivision`."""
        from flint import fmpz_mod_ctx, fmpz_mod_mat  # not loaded by a run without a proof

        try:
            inverse = fmpz_mod_mat(rows, fmpz_mod_ctx(self.prime)).inv()
        except ZeroDivisionError:
            raise ZeroDivision(f"a matrix is singular modulo {self.prime}") from None
        return [[int(value) for value in row] for row in inverse.tolist()]

    def cos_sin(self, angle: int) -> tuple[int, int]:
        """(cos, sin) of a reduced residue."""
        if angle == 0:
            return 1, 0
        mirrored = self.prime - angle
        key = min(angle, mirrored)
        if key not in self._circle:
            t = self.random()
            inverse = self.inverse(1 + t * t)
            self._circle[key] = ((1 - t * t) * inverse % self.prime, 2 * t * inverse % self.prime)
        cosine, sine = self._circle[key]
        return cosine, sine if key == angle else -sine % self.prime

    def sign(self, value: int) -> int:
        """+1, -1 or 0 (0 at 0) for a reduced residue, according to the present choice of `next_signs`."""
        return self.signed(value, jumps=True)

    def size(self, value: int) -> int:
        """The absolute value of a reduced residue: the residue times its sign."""
        sign = self.signed(value, jumps=False)
        return value if sign == 0 and self.fabs_is_argument_at_zero else value * sign % self.prime

    @property
    def on_a_jump(self) -> bool:
        """True if the present choice sets some sign to 0."""
        return 0 in self._script

    def signed(self, value: int, *, jumps: bool) -> int:
        """The sign of a reduced residue; for absolute values alone, which are continuous, it is 0 only at 0."""
        if value == 0:
            return 0
        key = min(value, self.prime - value)
        if key not in self._signs:
            place = len(self._signs)
            if place >= SIGN_LIMIT:
                self._signs[key] = self.opaque("free sign", (key,))
            else:
                if place == len(self._script):
                    self._script.append(1)
                self._places[key], self._signs[key] = place, self._script[place]
        if jumps and key in self._places:
            self._jumping.add(self._places[key])
        return self._signs[key] if key == value else -self._signs[key]

    def next_signs(self) -> bool:
        """Clear the signs and take their next combination; False when all combinations have been tried."""
        self._signs.clear()
        self._places.clear()
        while self._script:
            last = len(self._script) - 1
            following = {1: -1, -1: 0 if last in self._jumping else None}.get(self._script[last])
            if following is not None:
                self._script[last] = following
                return True
            self._script.pop()
            self._jumping.discard(last)
        return False

    def opaque(self, name: str, arguments: tuple[int, ...]) -> int:
        """The free value of a function at reduced arguments; a condition that is 0 or 1 determines what it can."""
        key = (name, arguments)
        value = self._values.get(key)
        if value is not None:
            return value
        if name == "if_else_zero" and (arguments[0] in (0, 1) or arguments[1] == 0):
            return arguments[1] if arguments[0] else 0
        if name == "not" and arguments[0] == 0:
            return 1
        value = self._values[key] = self.random()
        return value
