"""Probabilistic test for identically zero expressions at random points of prime fields, with an error bound."""

from __future__ import annotations

import math
import random
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from hashlib import sha256
from typing import TYPE_CHECKING, final

from dmframe.common.errors import ShapeError, UnknownNameError, ValueFault
from dmframe.exact.evaluation import Evaluation
from dmframe.exact.primes import is_prime, random_prime
from dmframe.exact.sizes import Bound, degrees
from dmframe.exact.tape import Tape
from dmframe.exact.trial import Trial, ZeroDivision

if TYPE_CHECKING:
    import casadi as ca

_ATTEMPTS = 20

Values = Mapping[int | str, Sequence[Fraction | int | float | None]]
"""Known values of inputs, by position or name (dense, column-major); None marks a free element."""


@final
@dataclass(frozen=True)
class Witness:
    """A point at which the expression is nonzero: element (row, column) of `output` has the residue `residue`."""

    prime: int
    output: str
    row: int
    column: int
    residue: int
    point: tuple[tuple[str, tuple[int, ...]], ...]


@final
@dataclass(frozen=True)
class ZeroTest:
    """Result of the test.

    A refutation (`witness`) is certain in free symbols. The probability of a wrong acceptance, over the random primes
    and points, is below 2**`log2_error_bound`.
    """

    zero: bool
    trials: int
    primes: tuple[int, ...]
    degree_bound: int
    log2_error_bound: float
    witness: Witness | None
    seed: int


def zero_test(
    f: ca.Function,
    *,
    values: Values | None = None,
    trials: int = 3,
    seed: int | None = None,
    bits: int = 127,
    primes: Sequence[int] = (),
) -> ZeroTest:
    r"""Decide whether all outputs of the SX function `f` are identically zero.

    Each trial evaluates `f` modulo a random prime of `bits` bits at a random point. If an output is not identically
    zero, its numerator is a polynomial of degree at most D with integer coefficients of size 2^H. One trial evaluates
    it to zero with probability below

    .. math:: 8 (D + H) / 2^{bits}:

    by Schwartz and Zippel a point of F_p is a root with probability at most D/p; at most H/(bits - 1) of the at least
    0.86 2^(bits-1)/(bits-1) primes (Rosser and Schoenfeld 1962, corollary 3) divide a given coefficient; and a new
    point after a vanishing denominator at most doubles both. D and H include the denominators and the arguments of
    functions (`Bound`). With given `primes` the second argument does not apply: the bound is then 4 D / p, for
    expressions that do not vanish modulo the primes.

    Parameters
    ----------
    f : SX function with any number of inputs and outputs.
    values : known values of inputs; all others are free symbols, so the result is valid for all their values.
    trials : number of points, >= 1; each has its own prime.
    seed : seed of the random primes and points; by default derived from `f` itself, so that no expression can be
        constructed that vanishes modulo primes chosen in advance.
    bits : size of the random primes, >= 121.
    primes : primes to use, one trial each, instead of random ones.

    Raises
    ------
    ValueFault
        For a function that cannot be read, or whose denominators vanish identically.
    UnknownNameError, ShapeError
        For values that do not fit.

    References
    ----------
    Schwartz, J. ACM 27 (1980); Zippel, EUROSAM 1979; Gonnet, STOC 1984.
    """
    if trials < 1:
        raise ValueFault(f"zero test of {f.name()}: expected at least 1 trial, found {trials}")
    for prime in primes:
        if not is_prime(prime):
            raise ValueFault(f"zero test of {f.name()}: expected primes, found {prime}; random_prime draws one")
    tape = Tape.from_function(f)
    known = _known(tape, values or {})
    bound = degrees(tape, known)
    seed = _own_seed(f) if seed is None else seed
    rng = random.Random(seed)
    used: list[int] = []
    for k in range(len(primes) or trials):
        prime, witness = _one_trial(tape, known, rng, bits, primes[k] if primes else None)
        used.append(prime)
        if witness is not None:
            return ZeroTest(False, len(used), tuple(used), bound.degree_total, -math.inf, witness, seed)
    errors = [log2_error(bound, prime, bits, bool(primes)) for prime in used]
    return ZeroTest(True, len(used), tuple(used), bound.degree_total, sum(errors), None, seed)


def _own_seed(f: ca.Function) -> int:
    return int.from_bytes(sha256(f.serialize().encode()).digest()[:8], "big")


def log2_error(bound: Bound, prime: int, bits: int, given: bool) -> float:
    """Bound on log2 of the probability that one trial evaluates a nonzero expression to zero."""
    if given:
        return min(0.0, 2 + math.log2(max(1, bound.degree_total)) - math.log2(prime))
    return min(0.0, 3 + math.log2(max(1, bound.degree_total + bound.height_total)) - bits)


def _known(tape: Tape, values: Values) -> dict[int, list[Fraction | None]]:
    names = [name for name, _ in tape.inputs]
    known: dict[int, list[Fraction | None]] = {}
    for key, given in values.items():
        if key not in names and key not in range(len(names)):
            raise UnknownNameError(f"zero test of {tape.name}: values of {key}", "input", str(key), names)
        position = names.index(key) if isinstance(key, str) else key
        if len(given) != tape.inputs[position][1]:
            raise ShapeError(
                f"zero test of {tape.name}: expected {tape.inputs[position][1]} values of {names[position]}, "
                f"found {len(given)}"
            )
        known[position] = [None if value is None else Fraction(value) for value in given]
    return known


def _one_trial(
    tape: Tape, known: Mapping[int, Sequence[Fraction | None]], rng: random.Random, bits: int, given: int | None
) -> tuple[int, Witness | None]:
    for _ in range(_ATTEMPTS):
        trial = Trial(random_prime(rng, bits) if given is None else given, rng)
        try:
            point = [
                [
                    trial.random() if value is None else trial.residue(value)
                    for value in known.get(position, [None] * size)
                ]
                for position, (_, size) in enumerate(tape.inputs)
            ]
            return trial.prime, _first_nonzero(tape, point, trial)
        except ZeroDivision:
            continue
    raise ValueFault(
        f"zero test of {tape.name}: a denominator vanishes at all of {_ATTEMPTS} random points; expected one that is "
        "not identically zero"
    )


def _first_nonzero(tape: Tape, point: Sequence[Sequence[int]], trial: Trial) -> Witness | None:
    for outputs in sign_choices(tape, point, trial):
        for output, residues in zip(tape.outputs, outputs, strict=True):
            for place, residue in enumerate(residues):
                if residue:
                    named = tuple((name, tuple(v)) for (name, _), v in zip(tape.inputs, point, strict=True))
                    column, row = divmod(place, output.rows)
                    return Witness(trial.prime, output.name, row, column, residue, named)
    return None


def sign_choices(tape: Tape, point: Sequence[Sequence[int]], trial: Trial) -> Iterator[list[list[int]]]:
    """Outputs for every choice of signs; the error bound of a trial requires all choices.

    Where a sign is 0, its argument is 0, and |x| can be evaluated as 0 or as x: an element that vanishes in one of
    these evaluations is returned as zero.
    """
    evaluation = Evaluation(tape, point, trial)
    outputs = evaluation.outputs
    while True:
        if trial.on_a_jump and any(map(any, outputs)):
            trial.fabs_is_argument_at_zero = True
            evaluation.recompute_signs()
            others = evaluation.outputs
            trial.fabs_is_argument_at_zero = False
            outputs = [
                [a and b and a for a, b in zip(one, other, strict=True)]
                for one, other in zip(outputs, others, strict=True)
            ]
        yield outputs
        if not trial.next_signs():
            return
        evaluation.recompute_signs()
        outputs = evaluation.outputs
