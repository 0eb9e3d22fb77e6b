"""Certificate of a block: storage function, dissipation, supply rate, and the conditions under which they hold.

A block with storage S, dissipation terms d_i and supply rate s states, along the closed loop,

    dS/dt = s - d_1 - d_2 - ... (+ e_1 + ..., bounded residual terms of a robust adaptation)

The supply rates of the blocks of a diagram cancel, so that the weighted sum of the storage functions, V, decreases by
the dissipation. Each term is a separate object, so that boundedness and integrability follow from the list of terms.
"""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final, final

import casadi as ca

from dmframe.block.barrier import Barrier, soft_between, soft_min
from dmframe.block.condition import SX, Assumption, CommonLyapunov, Condition, Inequality
from dmframe.block.fields import Expressions, pieces_of, refilled
from dmframe.block.sampled import Acted, DelayLine, PlantIdentity
from dmframe.block.steps import LeastSquaresSteps, NormalisedSteps, Steps
from dmframe.block.terms import (
    MONOTONE,
    TINY,
    Bounded,
    Clipped,
    Dissipated,
    InformationSquare,
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
from dmframe.common.text import Text


@final
@dataclass(frozen=True, eq=False)
class Consumed(Expressions):
    r"""Cross term of a cascade, :math:`c\,|a|^2`; the dissipation of a block on the servo level has to dominate it.

    Parameters
    ----------
    vector
        a, a column: the error with which the servo level tracks the reference of the cascade.
    c
        A scalar of parameters.
    """

    vector: SX
    c: SX

    @property
    def value(self) -> SX:
        """The term as one scalar expression."""
        return self.c * ca.dot(self.vector, self.vector)


@final
@dataclass(frozen=True, eq=False)
class StableLinear(Expressions):
    r"""A stable linear subsystem: signals that V does not contain and that are bounded because their input is.

    .. math:: \dot z_j = \sum_k A_{jk} z_k + r_j, \quad j, k = 1 \dots N

    holds for each joint. `verify` decides from the equations of the closed loop whether every r is bounded, and at the
    graph's values whether A is stable, also for arbitrary motions of the states in A within their boxes. The signals
    in `bounded` are the z plus bounded signals. If r vanishes, the z converge to zero.

    Parameters
    ----------
    vectors
        z, columns.
    rates
        A, row by row: columns or scalars of parameters, or of states with a box.
    bounded
        Signals that are bounded if z is: columns.
    otherwise
        Conditions that replace it if boundedness is not shown.
    of
        Printed names of the bounded signals; the framework derives them from the expressions.
    inputs
        Unknown external inputs, one per equation, such as the force of an environment. If r is not shown to be bounded,
        r without its input has to be, and `otherwise` states the assumption on the input.
    """

    vectors: tuple[SX, ...]
    rates: tuple[tuple[SX, ...], ...]
    bounded: tuple[SX, ...]
    otherwise: tuple[Condition, ...] = ()
    of: tuple[Text, ...] = ()
    inputs: tuple[SX, ...] = ()


@final
@dataclass(frozen=True, eq=False)
class TrueValue(Expressions):
    r"""True value of an estimate, and the weight of its error in S, :math:`\tfrac12 |\theta - \theta_{true}|_W^2`.

    Parameters
    ----------
    value
        The true value, a column; no function of the state.
    weight
        W; for an `dmframe.block.AdaptingBlock`, a column or a scalar that multiplies the inverse of the gain.
    """

    value: SX
    weight: SX = 1


@final
@dataclass(frozen=True)
class Certificate(Expressions):
    r"""One block's contribution to the Lyapunov function.

    D is the derivative d/dt along the closed loop; for a block with sampled states it is the difference over a sample.
    A block with storage S, dissipation d, supply rate s and residual e states the identity

    .. math:: D S = s - \sum d + \sum e, \quad S = \tfrac12 \sum \mathrm{storage}

    Parameters
    ----------
    storage
        S is *half* the sum of these terms. In discrete time it contains only sampled states of the block and
        parameters.
    dissipation
        Dissipation; each term is non-negative.
    supply
        The supply rate from the other blocks, without the cross term.
    consumes
        For a cascade: its cross term, which the servo level has to dominate.
    dominates
        For the block that dominates a cross term: elementwise coefficients with which the vector of that term is the
        sum of the vectors of the first dissipated squares; empty for other blocks.
    disturbed
        For that block: elementwise coefficients with which the vector that a joint torque multiplies in dS/dt, sigma,
        is the sum of the vectors of the first dissipated squares. Bounds on the error use it; empty if not stated.
    task
        The block belongs to the task level: its storage has the weight 1, that of the servo level has kappa.
    truth
        True values of other blocks' estimates: ``{"a_d": ...}``.
    residual
        The residual: bounded terms of dS/dt that are not dissipated, such as those of a leak. A claim with such a term
        is proved up to a bounded residual.
    driven
        Stable linear subsystems: signals that are bounded although V does not contain them.
    estimates
        The block's states that are estimates, with their true values. Their squares are added to the storage.
    errors
        Errors that the block regulates and that its storage contains in another form; they are not added to V. Their
        convergence to zero is concluded if it follows from the dissipation.
    filters
        Inputs that the block modifies before another block tracks them. The storage of the block that outputs such an
        input is left out of V, since it assumes that its reference is tracked unmodified.
    barriers
        Limits that the reference velocity of the block respects; V bounds how far the robot exceeds them.
    steps
        Estimates that take normalised steps, or steps of least squares, from sample to sample. Their storage, decrease
        and residual are added to those of the block.
    delay_lines
        Sampled states that store earlier samples.
    plant
        Identities of the plant between two samples, from which the rows of the steps are derived.
    solved
        Columns that are zero because the block has solved an equation for its output.
    acted
        Commands used in the rows of the steps, with the plant's signals that they have to equal: a configured delay.
    unknown
        Free symbols for true constants with unknown values, such as the initial value of a servo's integrator.
    """

    storage: tuple[Stored, ...] = ()
    dissipation: tuple[Dissipated, ...] = ()
    supply: SX = 0
    consumes: Consumed | None = None
    dominates: tuple[SX, ...] = ()
    disturbed: tuple[SX, ...] = ()
    task: bool = False
    truth: Mapping[str, SX] = field(default_factory=dict)
    residual: tuple[Bounded, ...] = ()
    linear: tuple[StableLinear, ...] = ()
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

    @property
    def pieces(self) -> tuple[SX, ...]:
        """All its expressions except true values and unknown constants."""
        return tuple(ca.SX(piece) for name in _MAPPED for piece in pieces_of(getattr(self, name)))

    def mapped(self, transform: Callable[[list[SX]], list[SX]]) -> Certificate:
        """The certificate with all these expressions transformed together."""
        done = iter(transform(list(self.pieces)))
        changed: dict[str, Any] = {name: refilled(getattr(self, name), done) for name in _MAPPED}
        return replace(self, **changed)


_MAPPED: Final = (
    *("storage", "dissipation", "residual", "errors", "linear", "estimates", "barriers", "steps", "delay_lines"),
    *("plant", "acted", "solved", "supply", "consumes", "dominates", "disturbed"),
)
"""The fields with expressions of signals."""


_FORMER_FIELDS: Final[Mapping[str, str]] = {"pays": "dominates", "excess": "residual", "driven": "linear"}


def former_fields(kind: type[Any]) -> None:
    """Let a class of certificates accept its fields by their former names too, with a notice, and return them."""
    renamed = {former: now for former, now in _FORMER_FIELDS.items() if now in kind.__dataclass_fields__}
    init = kind.__init__

    def notice(former: str) -> None:
        text = f"{kind.__name__}: {former} is now {renamed[former]}"
        warnings.warn(text, DeprecationWarning, stacklevel=3)

    @functools.wraps(init)
    def accepting(self: Any, *given: Any, **fields: Any) -> None:
        for former in renamed.keys() & fields.keys():
            notice(former)
            fields[renamed[former]] = fields.pop(former)
        init(self, *given, **fields)

    def read(self: Any, former: str) -> Any:
        notice(former)
        return getattr(self, renamed[former])

    kind.__init__ = accepting
    for former in renamed:
        documented = f"Former name of `{renamed[former]}`."
        setattr(kind, former, property(functools.partial(read, former=former), doc=documented))


former_fields(Certificate)


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
        residual=halved(residual),
        delay_lines=kept,
        plant=relations,
        unknown=constants or {},
        **others,
    )


_FORMER: Final[Mapping[str, tuple[str, Any]]] = {
    "SampledCertificate": ("Certificate", sampled_certificate),
    "Driven": ("StableLinear", StableLinear),
    "Gathered": ("InformationSquare", InformationSquare),
    "Kept": ("DelayLine", DelayLine),
    "Relation": ("PlantIdentity", PlantIdentity),
}
"""Former public names, their replacements, and the objects that the former names still return."""


def __getattr__(name: str) -> Any:
    if name not in _FORMER:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    now, value = _FORMER[name]
    warnings.warn(f"dmframe.block.certificate.{name} is now {now}", DeprecationWarning, stacklevel=2)
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
    "Inequality",
    "InformationSquare",
    "LeastSquaresSteps",
    "Lemma",
    "LogDet",
    "NormSquare",
    "NormalisedSteps",
    "PlantIdentity",
    "Potential",
    "Square",
    "StableLinear",
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
