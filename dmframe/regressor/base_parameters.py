"""Exact base parameters: the smallest identifiable set, found without a tolerance."""

from __future__ import annotations

import random
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Final, final

from dmframe.common.errors import RobotError
from dmframe.exact import Echelon, NoRationalError, Trial, ZeroDivision, random_prime, rational_reconstruction
from dmframe.regressor.full import Sampler, full_regressor
from dmframe.regressor.groupings import symbolic_groupings
from dmframe.robot.chain import SerialChain
from dmframe.robot.parameters import DynamicParameters, Inertial

# Mersenne primes: large enough for the long fractions of general rotations, and known without a search.
_EXPONENTS: Final = (127, 521, 1279, 2203, 4423, 9689, 19937)
# Textbook order: inertias before first moments before masses, and I_xx before I_yy, so that a link's mass is grouped
# with its parent and I_xx - I_yy remains [GautierKhalil1990].
_RANK: Final = Inertial(I_xx=0, I_xy=1, I_xz=2, I_yy=3, I_yz=4, I_zz=5, mc_x=6, mc_y=7, mc_z=8, m=9)
_CALM: Final = 3


@final
@dataclass(frozen=True)
class BaseParameters:
    r"""Independent columns of a regressor, and the linear combinations of parameters that they multiply.

    .. math:: Y_d\, a = Y_d[:, independent]\, \beta, \qquad \beta = grouping \cdot a

    holds identically in q, dq, dq_ref and ddq_ref.

    Attributes
    ----------
    parameters : all p of the full regressor
    independent : columns kept, ascending
    grouping : (count, p) exact coefficients
    unidentifiable : parameters that do not affect any motion
    symbolic : each base parameter as text, in the translations named by `translations`
    translations : name and value [m] of each translation that `symbolic` uses; p_y3 is the y component of joint 3's
        place in the frame of joint 2
    """

    parameters: DynamicParameters
    independent: tuple[int, ...]
    grouping: tuple[tuple[Fraction, ...], ...]
    unidentifiable: tuple[str, ...]
    symbolic: tuple[str, ...]
    translations: tuple[tuple[str, Fraction], ...]

    @property
    def names(self) -> tuple[str, ...]:
        """The names of all parameters."""
        return self.parameters.names

    @property
    def count(self) -> int:
        """The number of base parameters."""
        return len(self.independent)

    @property
    def kept(self) -> tuple[str, ...]:
        """The names of the columns kept."""
        return tuple(self.names[column] for column in self.independent)


def base_parameters(chain: SerialChain, friction: Collection[str] = (), *, symbolic: bool = True) -> BaseParameters:
    """The base parameters of a serial chain, exactly.

    Regressor rows at random points of a prime field are stacked until their rank no longer grows; the fractions are
    read from the reduced echelon form, and must agree with that of a second, random prime at other points.

    Parameters
    ----------
    chain : the robot
    friction : any of "viscous", "coulomb", and "rotor" for the inertia of each joint's rotor
    symbolic : False leaves `BaseParameters.symbolic` in decimal numbers, which is quicker

    Raises
    ------
    UnknownNameError
        For another kind of friction.
    RobotError
        If the fractions of two primes never agree.

    References
    ----------
    [GautierKhalil1990]_, with the null space over a prime field instead of rules or a numerical rank.
    """
    regressor = full_regressor(chain, friction)
    sampler = Sampler(regressor)
    independent, grouping = _exact_grouping(sampler, random.Random(0), chain.name)
    texts, translations = symbolic_groupings(chain, sampler, independent, grouping, exact_only=not symbolic)
    shown = [any(column) for column in zip(*grouping, strict=True)]
    hidden = tuple(name for name, seen in zip(regressor.parameters.names, shown, strict=True) if not seen)
    return BaseParameters(regressor.parameters, independent, grouping, hidden, texts, translations)


def _order(parameters: DynamicParameters) -> list[int]:
    """Columns by preference, links from the base on, so that parameters of far links are eliminated first."""
    columns = range(parameters.size)
    links = [parameters.of_link(link) for link in range(parameters.chain.n)]
    inertial = [column for link in links for _, column in sorted(zip(_RANK, columns[link], strict=True))]
    return [*inertial, *columns[parameters.inertial.stop :]]


def _row_space(sampler: Sampler, trial: Trial, order: Sequence[int]) -> Echelon:
    """Stack rows until several consecutive motions do not increase the rank."""
    constants = sampler.constants(trial)
    echelon = Echelon(trial.prime, sampler.columns)
    calm = 0
    while calm < _CALM:
        grown = [echelon.add([row[column] for column in order]) for row in sampler.rows(trial, constants)]
        calm = 0 if any(grown) else calm + 1
    return echelon


def _exact_grouping(
    sampler: Sampler, rng: random.Random, name: str
) -> tuple[tuple[int, ...], tuple[tuple[Fraction, ...], ...]]:
    order = _order(sampler.regressor.parameters)
    check = Trial(random_prime(rng), rng)
    expected = _row_space(sampler, check, order)
    for exponent in _EXPONENTS:
        prime = 2**exponent - 1
        found = _row_space(sampler, Trial(prime, rng), order)
        if found.pivots != expected.pivots:
            continue
        try:
            rows = [[rational_reconstruction(value, prime) for value in row] for row in found.rows]
            agree = [[check.residue(value) for value in row] for row in rows] == expected.rows
        except (NoRationalError, ZeroDivision):
            continue
        if agree:
            return _unpermuted(rows, found.pivots, order)
    raise RobotError(
        f"base parameters of {name}: expected coefficients of less than {_EXPONENTS[-1] // 2} bits, found longer ones; "
        "write the model's rotations with fewer digits"
    )


def _unpermuted(
    rows: Sequence[Sequence[Fraction]], pivots: Sequence[int], order: Sequence[int]
) -> tuple[tuple[int, ...], tuple[tuple[Fraction, ...], ...]]:
    place = {column: k for k, column in enumerate(order)}
    kept = sorted((order[pivot], row) for pivot, row in zip(pivots, rows, strict=True))
    grouping = tuple(tuple(row[place[column]] for column in range(len(order))) for _, row in kept)
    return tuple(column for column, _ in kept), grouping
