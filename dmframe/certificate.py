"""What a block claims about energy: storage, dissipation, supply, and the conditions under which it holds.

A block with storage S, dissipations d_i and supply s claims, along the closed loop,

    dS/dt = s - d_1 - d_2 - ... (+ e_1 + ..., bounded terms, of a robust adaptation)

The supplies of the blocks of a diagram cancel, so that V, the weighted sum of the storages, falls by the dissipations.
Squares and lemmas are kept apart, term by term, so that boundedness and integrability can be read off mechanically.
"""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, final

import casadi as ca

from dmframe.barrier import Barrier, soft_between, soft_min
from dmframe.condition import SX, Assumption, CommonLyapunov, Condition, Inequality
from dmframe.fields import check_fields
from dmframe.sampled import Acted, DelayLine, PlantIdentity
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
    r"""One block's part of the Lyapunov function.

    With D the derivative d/dt along the closed loop, or, for a block whose stored states are sampled, the difference
    over a sample, a block with storage S, dissipation d, supply s and residual e claims, identically,

    .. math:: D S = s - \sum d + \sum e, \quad S = \tfrac12 \sum \mathrm{storage}

    Parameters
    ----------
    storage
        S is *half* the sum of these terms. Over samples it holds sampled states of the block and parameters alone.
    dissipation
        What is lost, each term non-negative.
    supply
        The supply rate from the other blocks, besides the cross term.
    consumes
        For a cascade: its cross term, which the servo level has to dominate.
    dominates
        For the block that dominates a cross term: coefficients with which the vector of that term is composed of the
        first dissipated squares' vectors, elementwise; none for another block.
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
        Limits that the reference velocity keeps which the block outputs; how far the robot does follows from V.
    steps
        Estimates that take normalised steps, or steps of least squares, from sample to sample. What they store, lose
        and gain is added to the storage, the dissipation and the residual.
    delay_lines
        Sampled states that store earlier samples.
    plant
        Identities of the plant between two samples, on which the rows of the steps rest.
    solved
        Columns that are zero because the block has solved an equation for its output.
    acted
        What rows hold as the command of a sample, with the plant's signal that it has to be: a configured delay.
    unknown
        Free symbols for true constants with unknown values, such as where a servo's integrator started.
    """

    storage: tuple[Stored, ...] = ()
    dissipation: tuple[Dissipated, ...] = ()
    supply: SX = 0
    consumes: Consumed | None = None
    dominates: tuple[SX, ...] = ()
    task: bool = False
    truth: Mapping[str, SX] = field(default_factory=dict)
    excess: tuple[Bounded, ...] = ()
    driven: tuple[Driven, ...] = ()
    estimates: Mapping[str, TrueValue] = field(default_factory=dict)
    errors: tuple[Square, ...] = ()
    barriers: tuple[Barrier, ...] = ()
    filters: tuple[str, ...] = ()
    steps: tuple[Steps, ...] = ()
    delay_lines: tuple[DelayLine, ...] = ()
    plant: tuple[PlantIdentity, ...] = ()
    solved: tuple[SX, ...] = ()
    acted: tuple[Acted, ...] = ()
    unknown: Mapping[str, SX] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_fields(self)

    @property
    def _parts(self) -> tuple[Any, ...]:
        """All that is made of expressions, but for bare ones."""
        terms = (*self.storage, *self.dissipation, *self.excess, *self.errors, *self.driven, *self.estimates.values())
        return (*terms, *self.barriers, *self.steps, *self.delay_lines, *self.plant, *self.acted)

    @property
    def pieces(self) -> list[SX]:
        """All its expressions."""
        consumed = () if self.consumes is None else (self.consumes.vector, self.consumes.c)
        pieces = (piece for part in self._parts for piece in part.pieces)
        return [ca.SX(piece) for piece in (*pieces, *self.solved, self.supply, *consumed, *self.dominates)]

    def mapped(self, transform: Callable[[list[SX]], list[SX]]) -> Certificate:
        """The certificate with all its expressions transformed together."""
        done = iter(transform(self.pieces))

        def rebuilt(parts: Sequence[Any]) -> tuple[Any, ...]:
            return tuple(part.with_pieces([next(done) for _ in part.pieces]) for part in parts)

        return Certificate(
            storage=rebuilt(self.storage),
            dissipation=rebuilt(self.dissipation),
            excess=rebuilt(self.excess),
            errors=rebuilt(self.errors),
            driven=rebuilt(self.driven),
            estimates=dict(zip(self.estimates, rebuilt(list(self.estimates.values())), strict=True)),
            barriers=rebuilt(self.barriers),
            steps=rebuilt(self.steps),
            delay_lines=rebuilt(self.delay_lines),
            plant=rebuilt(self.plant),
            acted=rebuilt(self.acted),
            solved=tuple(next(done) for _ in self.solved),
            supply=next(done),
            consumes=Consumed(next(done), next(done)) if self.consumes is not None else None,
            dominates=tuple(done),
            task=self.task,
            truth=self.truth,
            filters=self.filters,
            unknown=self.unknown,
        )


def _with_former_fields(init: Callable[..., None]) -> Callable[..., None]:
    """The constructor, which also accepts former names of fields, with a notice."""

    @functools.wraps(init)
    def accepting(self: Certificate, *given: Any, **named: Any) -> None:
        for former, now in _FORMER_FIELDS.items():
            if former in named:
                warnings.warn(f"Certificate: {former} is now {now}", DeprecationWarning, stacklevel=2)
                named[now] = named.pop(former)
        init(self, *given, **named)

    return accepting


_FORMER_FIELDS: Final[Mapping[str, str]] = {"pays": "dominates"}
Certificate.__init__ = _with_former_fields(Certificate.__init__)  # type: ignore[method-assign]


def sampled_certificate(
    storage: tuple[Square, ...] = (),
    decrease: tuple[Square, ...] = (),
    residual: tuple[Square, ...] = (),
    kept: tuple[DelayLine, ...] = (),
    relations: tuple[PlantIdentity, ...] = (),
    constants: Mapping[str, SX] | None = None,
    **others: Any,
) -> Certificate:
    """`Certificate` by the keywords of the former ``SampledCertificate``, whose decrease and residual were halved."""

    def halved(terms: Sequence[Square]) -> tuple[Square, ...]:
        return tuple(Square(term.vector, term.weight / 2, term.of, term.positive) for term in terms)

    return Certificate(
        storage=storage,
        dissipation=halved(decrease),
        excess=halved(residual),
        delay_lines=kept,
        plant=relations,
        unknown=constants or {},
        **others,
    )


_FORMER: Final[Mapping[str, tuple[str, Any]]] = {
    "SampledCertificate": ("Certificate", sampled_certificate),
    "Kept": ("DelayLine", DelayLine),
    "Relation": ("PlantIdentity", PlantIdentity),
}
"""Former public names, what replaces each, and the object that they still give."""


def __getattr__(name: str) -> Any:
    if name not in _FORMER:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    now, value = _FORMER[name]
    warnings.warn(f"dmframe.certificate.{name} is now {now}", DeprecationWarning, stacklevel=2)
    return value


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
    "DelayLine",
    "Dissipated",
    "Driven",
    "Gathered",
    "Inequality",
    "LeastSquaresSteps",
    "Lemma",
    "LogDet",
    "NormSquare",
    "NormalisedSteps",
    "PlantIdentity",
    "Potential",
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
