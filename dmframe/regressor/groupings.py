"""Base parameters as text: each coefficient as an exact polynomial of the robot's translations."""

from __future__ import annotations

import itertools
import random
from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Final, NamedTuple, final

from dmframe.exact import (
    Echelon,
    NoRationalError,
    Trial,
    ZeroDivision,
    random_prime,
    rational_reconstruction,
    reduced_echelon,
)
from dmframe.regressor.full import Sampler
from dmframe.robot.chain import SerialChain
from dmframe.robot.parameters import DynamicParameters

# Parallel axes give 1, 2 and their halves; a larger fraction comes from a rotation and reads better as a decimal.
_LARGEST: Final = 1000
_LENGTHS: Final = {"kg": 0, "kg m": 1, "kg m^2": 2}
_MOST_MONOMIALS: Final = 120
_FRESH: Final = 2
_MOTIONS: Final = 30

Monomial = tuple[int, ...]
"""Indices in a_k of the multiplied translations, ascending."""
Polynomial = tuple[tuple[Monomial, Fraction], ...]


class _Entry(NamedTuple):
    """Coefficient of the grouping: row of the base parameter, column of the parameter."""

    row: int
    column: int


@final
@dataclass(frozen=True)
class _Shape:
    """Possible monomials of a coefficient: those of one degree in some translations."""

    variables: tuple[int, ...]
    degree: int

    @property
    def monomials(self) -> list[Monomial]:
        return list(itertools.combinations_with_replacement(self.variables, self.degree))


def symbolic_groupings(
    chain: SerialChain,
    sampler: Sampler,
    independent: Sequence[int],
    grouping: Sequence[Sequence[Fraction]],
    *,
    exact_only: bool = False,
) -> tuple[tuple[str, ...], tuple[tuple[str, Fraction], ...]]:
    """Each base parameter as text, and the translations that the texts name.

    By its unit, a coefficient from m to I is quadratic in the translations, from mc to I linear, and from I to I
    constant. Such polynomials are interpolated at random translations of a prime field and checked at further ones; a
    coefficient without a polynomial is printed as a number.
    """
    lengths = [x for joint in chain.joints for x in joint.translation]
    polynomials: dict[_Entry, Polynomial] = {}
    if not exact_only:
        rng = random.Random(1)
        trial = Trial(random_prime(rng), rng)
        support = _support(sampler, trial, independent, grouping)
        shapes = _shapes(sampler.regressor.parameters, independent, support, lengths)
        polynomials = _fit(sampler, trial, independent, shapes)
    names = {place: f"p_{'xyz'[place % 3]}{place // 3 + 1}" for place in range(len(lengths))}
    names_of, texts = sampler.regressor.parameters.names, list[str]()
    for row, column in enumerate(independent):
        coefficients = {}
        for other, value in enumerate(grouping[row]):
            polynomial = polynomials.get(_Entry(row, other))
            if (value or polynomial) and other != column:
                coefficients[names_of[other]] = _coefficient(polynomial, value, names)
        texts.append(_sum(names_of[column], coefficients))
    used = sorted({place for polynomial in polynomials.values() for monomial, _ in polynomial for place in monomial})
    return tuple(texts), tuple((names[place], lengths[place]) for place in used)


def _support(
    sampler: Sampler, trial: Trial, independent: Sequence[int], grouping: Sequence[Sequence[Fraction]]
) -> set[_Entry]:
    """Coefficients that are not 0 at random translations; at the robot's values terms may cancel, as for the Panda."""
    constants = _random_translations(sampler, trial)
    order = [*independent, *sorted(set(range(sampler.columns)) - set(independent))]
    echelon = Echelon(trial.prime, sampler.columns)
    growing = True
    while growing:
        grown = [echelon.add([row[column] for column in order]) for row in sampler.rows(trial, constants)]
        growing = any(grown)
    rows: Sequence[Sequence[int | Fraction]] = grouping
    if echelon.pivots == tuple(range(len(independent))):
        place = {column: k for k, column in enumerate(order)}
        rows = [[row[place[column]] for column in range(len(order))] for row in echelon.rows]
    return {_Entry(r, column) for r, row in enumerate(rows) for column, value in enumerate(row) if value}


def _random_translations(sampler: Sampler, trial: Trial) -> list[list[int]]:
    """The robot's constants, with a random residue for each translation that is not 0."""
    constants = sampler.constants(trial)
    place = sampler.regressor.a_k
    constants[place] = [trial.random() if value else 0 for value in constants[place]]
    return constants


def _shapes(
    parameters: DynamicParameters, independent: Sequence[int], support: Collection[_Entry], lengths: Sequence[Fraction]
) -> dict[_Entry, _Shape]:
    """Possible monomials of each non-zero coefficient; one without a shape is printed as a number."""
    powers = [_LENGTHS[unit] for _, unit in parameters.elements[parameters.inertial]]
    inertial, shapes = len(powers), {}
    for row, kept in enumerate(independent):
        for column in range(inertial):
            if _Entry(row, column) not in support or column == kept or kept >= inertial:
                continue
            degree = powers[kept] - powers[column]
            # Only the joints between the two links affect the coefficient.
            between = range(3 * (parameters.link_of(kept) + 1), 3 * (parameters.link_of(column) + 1))
            shape = _Shape(tuple(place for place in between if lengths[place]) if degree else (), degree)
            if degree >= 0 and 0 < len(shape.monomials) <= _MOST_MONOMIALS:
                shapes[_Entry(row, column)] = shape
    return shapes


def _fit(
    sampler: Sampler, trial: Trial, independent: Sequence[int], shapes: Mapping[_Entry, _Shape]
) -> dict[_Entry, Polynomial]:
    most = max((len(shape.monomials) for shape in shapes.values()), default=0)
    support: dict[int, list[int]] = defaultdict(list)
    for entry in shapes:
        support[entry.column].append(entry.row)
    samples = [_sample(sampler, trial, independent, support) for _ in range(most + _FRESH)]
    found: dict[_Entry, Polynomial] = {}
    for shape in sorted(set(shapes.values()), key=str):
        entries = [entry for entry, other in shapes.items() if other == shape]
        usable = [entry for entry in entries if all(entry in values for _, values in samples)]
        found.update(_interpolate(shape, usable, samples, trial))
    return found


_Sample = tuple[list[int], dict[_Entry, int]]


def _sample(
    sampler: Sampler, trial: Trial, independent: Sequence[int], support: Mapping[int, Sequence[int]]
) -> _Sample:
    """Random translations, and the coefficients that follow from them.

    A column is skipped if its set of kept columns depends on the translations' values.
    """
    constants = _random_translations(sampler, trial)
    a_k = constants[sampler.regressor.a_k]
    systems = {column: Echelon(trial.prime, len(rows) + 1) for column, rows in support.items()}
    for _ in range(_MOTIONS):
        rows_now = sampler.rows(trial, constants)
        grown = [
            systems[column].add([row[independent[k]] for k in rows] + [row[column]])
            for column, rows in support.items()
            for row in rows_now
        ]
        if not any(grown) and all(len(systems[column].pivots) >= len(rows) for column, rows in support.items()):
            break
    values = {}
    for column, rows in support.items():
        if systems[column].pivots == tuple(range(len(rows))):
            values.update(
                {_Entry(k, column): reduced[-1] for k, reduced in zip(rows, systems[column].rows, strict=True)}
            )
    return a_k, values


def _interpolate(
    shape: _Shape, entries: Sequence[_Entry], samples: Sequence[_Sample], trial: Trial
) -> dict[_Entry, Polynomial]:
    """Solve one linear system for all coefficients of a shape; those that fail at further samples are omitted."""
    p, monomials = trial.prime, shape.monomials
    powers = [[_product(a_k, monomial, p) for monomial in monomials] for a_k, _ in samples]
    count = len(monomials)
    system = [powers[k] + [samples[k][1][entry] for entry in entries] for k in range(count)]
    rows, pivots = reduced_echelon(system, p)
    if pivots != tuple(range(count)):
        return {}
    found = {}
    for k, entry in enumerate(entries):
        try:
            numbers = [rational_reconstruction(row[count + k], p, bound=_LARGEST) for row in rows]
            residues = [trial.residue(number) for number in numbers]
        except (NoRationalError, ZeroDivision):
            continue
        fresh = range(count, len(samples))
        expected = [sum(x * y for x, y in zip(residues, powers[s], strict=True)) % p for s in fresh]
        if expected == [samples[s][1][entry] for s in fresh]:
            found[entry] = tuple((m, number) for m, number in zip(monomials, numbers, strict=True) if number)
    return found


def _product(a_k: Sequence[int], monomial: Monomial, p: int) -> int:
    result = 1
    for place in monomial:
        result = result * a_k[place] % p
    return result


def _coefficient(polynomial: Polynomial | None, value: Fraction, names: Mapping[int, str]) -> tuple[int, str]:
    """Sign and text of a coefficient; the text is empty for 1."""
    if polynomial is None:
        magnitude = abs(value)
        number = f"{float(magnitude):.6g}"
        # Nearly 1 is not 1: a rotation by 1.5708 gives 0.999999999993.
        return (1 if value > 0 else -1), "" if magnitude == 1 else "1.00000" if number == "1" else number
    sign = 1 if polynomial[0][1] > 0 else -1
    terms = [(sign * number, _monomial(monomial, names)) for monomial, number in polynomial]
    text = " ".join(
        f"{'+' if number > 0 else '-'} {_scaled(abs(number), factors)}".strip() for number, factors in terms
    ).removeprefix("+ ")
    if len(terms) > 1:
        return sign, f"({text})"
    return sign, "" if text == "1" else text


def _monomial(monomial: Monomial, names: Mapping[int, str]) -> str:
    counted = {place: monomial.count(place) for place in monomial}
    return " ".join(names[place] + (f"^{power}" if power > 1 else "") for place, power in counted.items())


def _scaled(number: Fraction, factors: str) -> str:
    if not factors:
        return str(number)
    return factors if number == 1 else f"{number} {factors}"


def _sum(kept: str, coefficients: Mapping[str, tuple[int, str]]) -> str:
    """The kept parameter plus the others with their coefficients; equal coefficients share a bracket."""
    shared: dict[tuple[int, str], list[str]] = defaultdict(list)
    for name, coefficient in coefficients.items():
        shared[coefficient].append(name)
    text = kept
    for (sign, factor), members in shared.items():
        body = " + ".join(members)
        if len(members) > 1 and (factor or sign < 0):
            body = f"({body})"
        text += f" {'+' if sign > 0 else '-'} {factor} {body}".replace("  ", " ")
    return text
