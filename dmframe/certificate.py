"""What a block claims about energy: storage, dissipation, supply, and the conditions under which it holds.

A block with storage S, dissipations d_i and supply s claims, along the closed loop,

    dS/dt = s - d_1 - d_2 - ... (+ e_1 + ..., bounded terms, of a robust adaptation)

The supplies of the blocks of a diagram cancel, so that V, the weighted sum of the storages, falls by the dissipations.
Squares and lemmas are kept apart, term by term, so that boundedness and integrability can be read off mechanically.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, final

import casadi as ca

from dmframe.acted import Acted
from dmframe.barrier import Barrier, soft_between, soft_min
from dmframe.condition import SX, Assumption, CommonLyapunov, Condition, Inequality
from dmframe.fields import check_fields
from dmframe.steps import LeastSquaresSteps, NormalisedSteps, Steps
from dmframe.terms import (
    MONOTONE,
    TINY,
    Bounded,
    Clipped,
    Dissipated,
    Gathered,
    Lemma,
    LogDet,
    NormSquare,
    Potential,
    Square,
    Stored,
    beyond,
    clip,
    gathered,
    norm,
    soft_clip,
)


@final
@dataclass(frozen=True, eq=False)
class Consumed:
    r"""What a cascade takes from the servo level: :math:`c\,|a|^2`; some block there has to pay for it.

    Parameters
    ----------
    vector
        a, a column: the error with which the servo level follows the cascade's reference.
    c
        A scalar of parameters.
    """

    vector: SX
    c: SX

    def __post_init__(self) -> None:
        check_fields(self)

    @property
    def value(self) -> SX:
        """The term as one scalar expression."""
        return self.c * ca.dot(self.vector, self.vector)


@final
@dataclass(frozen=True, eq=False)
class Driven:
    r"""Signals that V does not weigh, and that stay bounded because a stable linear equation drives them.

    .. math:: \dot z_j = \sum_k A_{jk} z_k + r_j, \quad j, k = 1 \dots N

    one such equation a joint. That every remainder r is bounded is decided from the closed loop's equations, and that A
    is stable at the graph's numbers, also while a state that it holds moves anywhere in its box. The signals that
    follow, `bounded`, are the z plus something bounded; and where r vanishes, the z do.

    Parameters
    ----------
    vectors
        z, columns.
    rates
        A, row by row: columns or scalars of parameters, or of states with a box.
    bounded
        What is bounded with them: columns.
    otherwise
        Conditions that have to take its place where it is not shown.
    of
        How a reader writes what is bounded; printed from the expressions.
    inputs
        What comes from where nothing is known, such as the force of an environment, one an equation: where a remainder
        is not shown to be bounded, it has to be without its input, and `otherwise` says what is assumed of that.
    """

    vectors: tuple[SX, ...]
    rates: tuple[tuple[SX, ...], ...]
    bounded: tuple[SX, ...]
    otherwise: tuple[Condition, ...] = ()
    of: tuple[str, ...] = ()
    inputs: tuple[SX, ...] = ()

    def __post_init__(self) -> None:
        check_fields(self)

    @property
    def pieces(self) -> tuple[SX, ...]:
        """Its expressions."""
        return (*self.vectors, *(rate for row in self.rates for rate in row), *self.bounded, *self.inputs)

    def with_pieces(self, pieces: Sequence[SX]) -> Driven:
        """The same equations of other expressions."""
        left, count = list(pieces), len(self.vectors)
        vectors, left = left[:count], left[count:]
        rows = tuple(tuple(left[k * count : (k + 1) * count]) for k in range(count))
        left = left[count * count :]
        bounded, inputs = left[: len(self.bounded)], left[len(self.bounded) :]
        return Driven(tuple(vectors), rows, tuple(bounded), self.otherwise, self.of, tuple(inputs))


@final
@dataclass(frozen=True, eq=False)
class TrueValue:
    r"""What a state estimates, and what V weighs its error with: S holds :math:`\tfrac12 |\theta - \theta_{true}|_W^2`.

    Parameters
    ----------
    value
        The true value, a column; no function of the state.
    weight
        W; of an `dmframe.block.AdaptingBlock`, a column or a scalar that stands beside the inverse of the gain.
    """

    value: SX
    weight: SX = 1

    def __post_init__(self) -> None:
        check_fields(self)

    @property
    def pieces(self) -> tuple[SX, ...]:
        """Its expressions."""
        return self.value, self.weight

    def with_pieces(self, pieces: Sequence[SX]) -> TrueValue:
        """The same of other expressions."""
        return TrueValue(*pieces)


@final
@dataclass(frozen=True)
class Certificate:
    """One block's part of the Lyapunov function.

    Parameters
    ----------
    storage
        S is *half* the sum of these terms.
    dissipation
        What is lost, each term non-negative.
    supply
        What flows in from the other blocks, beside what the block consumes.
    consumes
        For a cascade: what the servo level pays for.
    pays
        For the block that pays: coefficients with which the consumed vector is composed of the first dissipated
        squares' vectors, elementwise; none for a block that does not pay.
    task
        The block stands on the task level: its storage has the weight 1 where the servo level has kappa.
    truth
        True values that other blocks' estimates have: ``{"a_d": ...}``.
    excess
        What dS/dt may have above minus the dissipation: terms that are not dissipated but bounded, such as a leak
        leaves behind. A claim with one is proved up to a bounded residual.
    driven
        Signals that stay bounded although V does not weigh them.
    estimates
        The block's states that are estimates, with what they estimate. Their squares are added to the storage.
    errors
        Errors that the block is there to take away, where its storage holds them in another form; V does not count
        them. That they go to zero is concluded if what is dissipated says so.
    filters
        Inputs that the block changes before anybody follows them. What the block stores that gives one has no part in
        V: its word is about a reference that is followed.
    barriers
        Limits that the reference velocity keeps which the block hands out; how far the robot does follows from V.
    """

    storage: tuple[Stored, ...] = ()
    dissipation: tuple[Dissipated, ...] = ()
    supply: SX = 0
    consumes: Consumed | None = None
    pays: tuple[SX, ...] = ()
    task: bool = False
    truth: Mapping[str, SX] = field(default_factory=dict)
    excess: tuple[Bounded, ...] = ()
    driven: tuple[Driven, ...] = ()
    estimates: Mapping[str, TrueValue] = field(default_factory=dict)
    errors: tuple[Square, ...] = ()
    barriers: tuple[Barrier, ...] = ()
    filters: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        check_fields(self)

    @property
    def pieces(self) -> list[SX]:
        """All its expressions."""
        terms = (*self.storage, *self.dissipation, *self.excess, *self.errors, *self.driven, *self.estimates.values())
        kept = (piece for barrier in self.barriers for piece in barrier.pieces)
        consumed = () if self.consumes is None else (self.consumes.vector, self.consumes.c)
        pieces = (piece for term in terms for piece in term.pieces)
        return [ca.SX(piece) for piece in (*pieces, *kept, self.supply, *consumed, *self.pays)]

    def mapped(self, transform: Callable[[list[SX]], list[SX]]) -> Certificate:
        """The certificate with all its expressions transformed together."""
        done = iter(transform(self.pieces))

        def rebuilt(term: Any) -> Any:
            return term.with_pieces([next(done) for _ in term.pieces])

        return Certificate(
            storage=tuple(rebuilt(term) for term in self.storage),
            dissipation=tuple(rebuilt(term) for term in self.dissipation),
            excess=tuple(rebuilt(term) for term in self.excess),
            errors=tuple(rebuilt(term) for term in self.errors),
            driven=tuple(rebuilt(term) for term in self.driven),
            estimates={name: rebuilt(term) for name, term in self.estimates.items()},
            barriers=tuple(rebuilt(term) for term in self.barriers),
            supply=next(done),
            consumes=Consumed(next(done), next(done)) if self.consumes is not None else None,
            pays=tuple(done),
            task=self.task,
            truth=self.truth,
            filters=self.filters,
        )


@final
@dataclass(frozen=True, eq=False)
class Kept:
    """A sampled state that holds earlier samples: the newest in front, the others pushed back, the oldest forgotten.

    Parameters
    ----------
    state
        The state's name: a matrix that is filled with matrices like the newest, one below or one beside the other.
    newest
        What is stored at this sample.
    when
        Where it is zero nothing is stored, and the state stays as it is.
    """

    state: str
    newest: SX
    when: SX = 1

    def __post_init__(self) -> None:
        check_fields(self)

    def pushed(self, state: SX) -> SX:
        """What the state becomes."""
        rows, columns = self.newest.shape
        if columns == state.shape[1]:
            pushed = ca.vertcat(self.newest, state[: state.shape[0] - rows, :])
        else:
            pushed = ca.horzcat(self.newest, state[:, : state.shape[1] - columns])
        return pushed if isinstance(self.when, int) else ca.if_else(self.when, pushed, state)

    def fits(self, state: SX) -> bool:
        """The state holds a whole number of these."""
        sizes = list(zip(self.newest.shape, state.shape, strict=True))
        return any(a == b for a, b in sizes) and all(a and b % a == 0 for a, b in sizes)


@final
@dataclass(frozen=True, eq=False)
class Relation:
    r"""What holds at every instant of the plant's motion, whatever is commanded: :math:`\dot p + r = 0`.

    Over a sample it gives, exactly, :math:`(p(t + T) - p(t)) / T + \langle r \rangle = 0`: what an estimator may
    learn from, whose rows stand for these means.

    Parameters
    ----------
    momentum
        p, a column.
    rest
        r, a column.
    """

    momentum: SX
    rest: SX

    def __post_init__(self) -> None:
        check_fields(self)


@final
@dataclass(frozen=True)
class SampledCertificate:
    r"""One block's part of a proof over samples: what V is, and what it does from one sample to the next.

    .. math:: V^+ - V = - \tfrac12 \sum \mathrm{decrease} + \tfrac12 \sum \mathrm{residual}, \quad
        V = \tfrac12 \sum \mathrm{storage}

    identically, for all values of states, measurements, gains and the sampling period. V holds sampled states of the
    block and parameters alone. What the `steps` store, lose and gain is counted with the rest.

    Parameters
    ----------
    storage
        V is *half* the sum of these terms.
    decrease
        What is lost from sample to sample, each term non-negative.
    residual
        What is gained.
    steps
        Estimates that take normalised steps, or steps of least squares.
    kept
        States that hold earlier samples.
    relations
        What the plant's motion obeys, on which the rows of the steps rest.
    solved
        Columns that are zero because the block has solved an equation for its output.
    acted
        What rows hold as the command of a sample, with what of the plant it has to be: a delay that is configured.
    constants
        Free symbols of what is true and constant, and that nobody knows, such as where a servo's integrator started.
    truth
        True values that other blocks' proofs read.
    """

    storage: tuple[Square, ...] = ()
    decrease: tuple[Square, ...] = ()
    residual: tuple[Square, ...] = ()
    steps: tuple[Steps, ...] = ()
    kept: tuple[Kept, ...] = ()
    relations: tuple[Relation, ...] = ()
    solved: tuple[SX, ...] = ()
    acted: tuple[Acted, ...] = ()
    constants: Mapping[str, SX] = field(default_factory=dict)
    truth: Mapping[str, SX] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_fields(self)


__all__ = [
    "MONOTONE",
    "SX",
    "TINY",
    "Acted",
    "Assumption",
    "Barrier",
    "Bounded",
    "Certificate",
    "Clipped",
    "CommonLyapunov",
    "Condition",
    "Consumed",
    "Dissipated",
    "Driven",
    "Gathered",
    "Inequality",
    "Kept",
    "LeastSquaresSteps",
    "Lemma",
    "LogDet",
    "NormSquare",
    "NormalisedSteps",
    "Potential",
    "Relation",
    "SampledCertificate",
    "Square",
    "Steps",
    "Stored",
    "TrueValue",
    "beyond",
    "clip",
    "gathered",
    "norm",
    "soft_between",
    "soft_clip",
    "soft_min",
]
