"""Comparison of two laws: exactly if possible, else at points of all magnitudes and on both sides of every switch."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Any, Final, final

import casadi as ca
import numpy as np

from dmframe.common.errors import ValueFault
from dmframe.exact import zero_test
from dmframe.program import OPERATIONS, codes, read, run

POINTS: Final = 6
"""Number of points at which expressions are compared if they are not shown to be equal exactly."""
FEW: Final = (0, 2, 3)
"""The points for a docstring without switches."""
MOST: Final = 400
"""Largest number of points drawn while a switch has been covered on one side only."""
ALL_SIZES: Final = 16
"""Number of points that cover every power of ten of `_POWERS` with both signs."""

NEAR: Final = 2
"""The first points: states in (-1, 1), parameters in (0.5, 1.5)."""
_POWERS: Final = (2, -2, 3, 1, -1, -3, 0)

_VANISHING: Final = (0.0, 0.0, 0.5, 1.0)
"""Probabilities that a signal is zero at a point after the first `ALL_SIZES`."""
_CLOSE: Final = 1e-7
_ROUNDED: Final = 1e-11
"""Tolerance for rounding, relative to the largest element, or to 1 if all elements are smaller."""
_JITTERS: Final = 3
_JITTER: Final = 1e-14
"""Relative perturbation of numbers, with which it is decided whether a difference is rounding."""
_SPREADS: Final = 10
"""A difference of up to this many times the change by the perturbation is rounding."""
_TINY: Final = 1e-300
_OFF_ZERO: Final = 1e-9
"""Distance of the points next to a point with zero signals."""
_CONTINUOUS: Final = 1e-6
"""Largest change of a continuous function over that distance, relative to its value, or to 1 if that is smaller."""
_BITS: Final = (256, 1024, 4096)
"""Precisions at a point where floats differ; the next one is used until all balls are narrow."""

_EQUALITY: Final = frozenset((ca.OP_EQ, ca.OP_NE))


@final
class Draw:
    """The random numbers of one point: elements of one magnitude with random factors.

    Points are drawn in pairs with opposite signs of all numbers that may be negative: a switch in one state, with a
    threshold in the range of magnitudes, is seen on both sides. Beyond `ALL_SIZES` each element has its own magnitude,
    and at some points signals are zero, since a law may treat a zero error differently.
    """

    def __init__(self, seed: int) -> None:
        self._near = seed < NEAR
        pair = (seed - NEAR) // 2
        self._rng = np.random.default_rng(seed if self._near else NEAR + pair)
        self._turn = -1.0 if seed % 2 else 1.0
        self.size = 10.0 ** _POWERS[pair] if 0 <= pair < len(_POWERS) else 1.0
        self._mixed = seed >= ALL_SIZES
        self._zero = _VANISHING[seed % len(_VANISHING)] if self._mixed else 0.0

    @property
    def vanishes(self) -> bool:
        """True if some or all numbers are zero that may be."""
        return self._zero > 0.0

    @property
    def moderate(self) -> bool:
        """True at the first points, whose numbers are near 1 and do not overflow."""
        return self._near

    def numbers(self, shape: Any, *, positive: bool) -> Any:
        """The next numbers, an array of this shape."""
        if self._near:
            return self._rng.uniform(0.5 if positive else -1.0, 1.5 if positive else 1.0, shape)
        found = self.size * self._rng.uniform(0.5, 1.5, shape)
        if self._mixed:
            found = found * 10.0 ** self._rng.uniform(-3.0, 3.0, shape)
        if positive:
            return found
        there = self._rng.uniform() >= self._zero
        return self._turn * self._rng.choice((-1.0, 1.0), shape) * found * there


def differs(first: np.ndarray, second: np.ndarray) -> bool:
    """True for numbers that differ by more than rounding; a value that is not finite has to be so on both sides.

    The tolerance of each element is relative to its own magnitude; larger elements add the tolerance for rounding only.
    """
    if first.shape != second.shape:
        return True
    finite = np.isfinite(first)
    if np.any(finite != np.isfinite(second)):
        return True
    one, other = np.abs(first[finite]), np.abs(second[finite])
    allowed = _CLOSE * np.maximum(one, other) + _ROUNDED * np.max(np.maximum(one, other), initial=1.0)
    return bool(np.any(np.abs(first[finite] - second[finite]) > allowed))


def differs_near(first: np.ndarray, second: np.ndarray) -> bool:
    """True for numbers at one of the first points, where terms are moderate, that differ by more than rounding."""
    if first.shape != second.shape:
        return True
    largest = np.max(np.abs(first[np.isfinite(first)]), initial=0.0)
    return bool(np.any(np.abs(np.nan_to_num(first - second)) > _CLOSE * (1.0 + largest)))


def is_rounding(first: np.ndarray, second: np.ndarray, moved: Iterable[tuple[np.ndarray, np.ndarray]]) -> bool:
    """True for a difference that is due to rounding of large terms that cancel.

    `moved` are the same numbers with arguments perturbed by `jittered`. If terms are large, the perturbation changes
    both by more than rounding does; a larger difference is not due to rounding.
    """
    finite = np.isfinite(first)
    if first.shape != second.shape or np.any(finite != np.isfinite(second)):
        return False
    spreads = np.zeros((2, *first.shape))
    for pair in moved:
        for place, (there, here) in enumerate(zip(pair, (first, second), strict=True)):
            spreads[place] = np.fmax(spreads[place], np.abs(np.nan_to_num(there - here)))
    allowed = _CLOSE * np.maximum(np.abs(first), np.abs(second)) + _SPREADS * np.min(spreads, axis=0)
    return bool(np.all(np.abs(first - second)[finite] <= allowed[finite]))


def in_balls(function: Any, given: Sequence[Any], place: int) -> np.ndarray | None:
    """One result of a function in ball arithmetic, with as many bits as required; None if `_BITS` are too few.

    If a matrix is singular up to rounding, or the argument of a sign is zero up to rounding, floating-point results
    have no correct digit.
    """
    from flint import arb  # rarely needed

    from dmframe.exact.balls import UndecidedError, enclosed

    symbols = [ca.SX.sym(f"given{k}", function.size_in(k)) for k in range(function.n_in())]
    try:
        program = read(scalars := ca.Function("scalars", symbols, [function.call(symbols)[place]]))
    except RuntimeError:  # it has no scalar expressions
        return None
    numbers = program.elements([[*map(arb, ca.densify(ca.DM(value)).nonzeros())] for value in given])
    for bits in _BITS:
        with suppress(ValueFault, UndecidedError):  # another operation, no value at this point, too few bits
            (found,) = program.dense(enclosed(program, numbers, bits=bits), arb(0))
            if all(value.rad() < _ROUNDED * (1 + abs(value)) for value in found):
                return np.array(found, float).reshape(scalars.size_out(0), order="F")
    return None


def agree(first: np.ndarray | None, second: np.ndarray | None) -> bool:
    """True if both results of `in_balls` exist and are equal."""
    return first is not None and second is not None and not differs(first, second)


def jittered(values: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """The same point with its last digits changed."""
    for seed in range(_JITTERS):
        rng = np.random.default_rng(seed)
        moved = {name: np.asarray(value, dtype=float) for name, value in values.items()}
        yield {name: value * (1.0 + _JITTER * rng.uniform(-1.0, 1.0, np.shape(value))) for name, value in moved.items()}


def equal(ones: Sequence[Any], others: Sequence[Any]) -> list[bool]:
    """For each pair of SX expressions, true if they are shown to be equal in a prime field; False proves nothing."""
    differences = [
        ca.vec(ca.densify(one - other)) if one.shape == other.shape else None
        for one, other in zip(ones, others, strict=True)
    ]
    known = [item is not None and _is_zero(item) for item in differences]
    left = [k for k, item in enumerate(differences) if item is not None and not known[k]]
    if left and _vanish([differences[k] for k in left]):
        return [item is not None for item in differences]
    if len(left) > 1:
        for k in left:
            known[k] = _vanish([differences[k]])
    return known


def _is_zero(column: Any) -> bool:
    return column.numel() == 0 or bool(column.is_zero())


def _vanish(columns: Sequence[Any]) -> bool:
    whole = ca.vertcat(*columns)
    try:
        return zero_test(ca.Function("difference", [ca.veccat(ca.SX(0, 1), *ca.symvar(whole))], [whole]), trials=1).zero
    except ValueFault:  # a constant that is not finite, or a zero denominator: no value to compare
        return False


_FLOORS: Final = (ca.OP_FMAX, ca.OP_FMIN)


def _rebuilt(code: int, arity: int) -> Callable[..., Any]:
    build = partial(ca.SX.unary if arity == 1 else ca.SX.binary, code)
    return lambda *operands: None if type(None) in map(type, operands) else build(*operands)


REBUILT: Final = {code: _rebuilt(code, operation.arity) for code, operation in OPERATIONS.items()}
_RULES: Final = REBUILT | dict.fromkeys((ca.OP_CALL, ca.OP_PRINTME), lambda: None)
"""Functions that are not expanded have no rule: switches in them are covered by the points only."""
_SWITCHES: Final = frozenset(code for code, operation in OPERATIONS.items() if operation.turns)


def _is_tiny(value: Any) -> bool:
    """True for the lower bound of the radicand of a norm; no point is on both sides of it."""
    return bool(value.is_constant()) and 0 < abs(float(value)) < 1e-20


def switching(expressions: Sequence[Any]) -> list[Any]:
    """Switching functions of SX expressions: a switch is covered when both signs of its function have occurred."""
    whole = ca.veccat(ca.SX(0, 1), *expressions)
    symbols = ca.veccat(ca.SX(0, 1), *ca.symvar(whole))
    function = ca.Function("switching", [symbols], [whole])
    if _SWITCHES.isdisjoint(codes(function)):
        return []
    program = read(function)
    inputs, found = symbols.nonzeros(), list[Any]()
    values = run(program, _RULES, given=lambda _, k: inputs[k], constant=ca.SX, refuse=KeyError)
    for node in program.nodes:
        if node.code not in _SWITCHES:
            continue
        operands = [values[operand] for operand in node.operands]
        if any(operand is None for operand in operands):
            continue
        if node.code in _FLOORS and any(map(_is_tiny, operands)):
            continue
        turns = OPERATIONS[node.code].turns
        at = operands[0] - operands[1] if turns == "difference" else operands[-1 if turns == "last" else 0]
        found.append(ca.fabs(at) - _TINY if node.code in _EQUALITY else at)
    return [item for item in found if not item.is_constant()]


@final
class Sides:
    """The sides of switches that points have covered."""

    def __init__(self) -> None:
        self._plus: Any = None
        self._minus: Any = None

    def add(self, turns: np.ndarray) -> None:
        """Add one point."""
        plus, minus = turns > 0, turns < 0
        self._plus = plus if self._plus is None else self._plus | plus
        self._minus = minus if self._minus is None else self._minus | minus

    @property
    def complete(self) -> bool:
        """True if every switch is covered on both sides."""
        return self._plus is None or bool(np.all(self._plus & self._minus))


Numbers = tuple[Sequence[np.ndarray], Sequence[np.ndarray], Sequence[np.ndarray]]
"""Two lists of matrices at one point, and the values of their switching functions in columns."""
Balls = tuple[np.ndarray | None, np.ndarray | None]


@final
@dataclass(frozen=True)
class Pair:
    """Two lists of matrices that should be equal: what is printed, and what runs.

    Parameters
    ----------
    point
        The numbers of a point, by its seed.
    at
        Both lists at a point.
    in_balls
        The matrices of one place at a point, in ball arithmetic.
    """

    point: Callable[[int], Mapping[str, Any]]
    at: Callable[[Mapping[str, Any]], Numbers]
    in_balls: Callable[[Mapping[str, Any], int], Balls]

    def compared(self, *, near: bool) -> tuple[int | None, bool]:
        """Index of the first matrix that differs, or None; and true if every switch was covered on both sides.

        If `near`, only the first points are used.
        """
        sides = list[Sides]()
        for seed in range(MOST):
            values = self.point(seed)
            ones, others, turns = self.at(values)
            for place, (one, two) in enumerate(zip(ones, others, strict=True)):
                if Draw(seed).vanishes and one.shape == two.shape:
                    one = np.where(self._is_removable(values, place, one, two), two, one)
                if not Draw(seed).moderate and one.shape == two.shape and np.any(np.isnan(two)):
                    one = np.where(np.isnan(one), two, one)  # numbers overflow in what runs: no point to compare at
                moved = ((first[place], second[place]) for first, second, _ in map(self.at, jittered(values)))
                if differs(one, two) and not is_rounding(one, two, moved) and not agree(*self.in_balls(values, place)):
                    return place, False
            sides = sides or [Sides() for _ in turns]
            for side, turned in zip(sides, turns, strict=True):
                side.add(turned)
            if seed + 1 >= (NEAR if near else POINTS) and all(side.complete for side in sides):
                return None, True
        return None, False

    def _is_removable(self, values: Mapping[str, Any], place: int, printed: np.ndarray, runs: np.ndarray) -> Any:
        """True for elements that are undefined at zero signals in the first form and continuous in the second.

        The product of 0/0 with 0 is NaN in one form, and 0 in a simplified one. An element that jumps next to this
        point is not continued: it has a value of its own at zero, which the first form does not have.
        """
        found = np.isnan(printed) & np.isfinite(runs)
        if np.any(found):
            for step in (_OFF_ZERO, -_OFF_ZERO):
                nearby = {name: np.where(np.asarray(value) == 0.0, step, value) for name, value in values.items()}
                change = np.abs(self.at(nearby)[1][place] - runs)
                found &= change <= _CONTINUOUS * np.maximum(1.0, np.abs(runs))
        return found
