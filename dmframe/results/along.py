"""V along a run: the proved expressions evaluated at the simulated states.

The true parameters in V are those of the plant as wired; the states are those of the recording. A stepping source, such
as a load, changes V at constant states: each such jump is computed separately from the rise of V in the loop.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import final

import casadi as ca
import numpy as np

from dmframe.block.certificate import SX, Square, Stored
from dmframe.certify.claim import Claim, Part, total
from dmframe.common.errors import ValueFault
from dmframe.common.slices import slices
from dmframe.common.text import UNNAMED, Text
from dmframe.diagram.closed_loop import stack
from dmframe.formula import Formula, tree
from dmframe.formula.tree import SCALAR, Name
from dmframe.results.at_instants import AtInstants
from dmframe.results.climb import Climb, climb_of
from dmframe.results.constants import determined, notes_on, residual_of
from dmframe.simulate import Recording

ROUNDING_INSTANTS = 128
"""Number of instants at which the rounding error of V is bounded; in between, the larger neighbouring bound applies."""


def _none() -> np.ndarray:
    return np.zeros(0)


@final
@dataclass(frozen=True)
class TermAlong:
    r"""One term of V: :math:`\tfrac12 \kappa |a|_W^2` of `block`, or without kappa for a cascade; (N,) values.

    `of` is the name of a.
    """

    block: str
    of: Text
    values: np.ndarray


@final
@dataclass(frozen=True)
class Jump:
    """Jump of V at `time` [s] by a stepping source, at constant states."""

    time: float
    change: float


@final
@dataclass(frozen=True)
class StorageTrace:
    """V and its terms at every recorded instant of a run.

    Parameters
    ----------
    time
        (N,) [s].
    kappa
        Weight of the servo level.
    dissipation
        (N,) Weighted sum of the dissipated squares; empty if not evaluated.
    rate
        (N,) dV/dt of the continuous-time certificate at the same states; empty if not evaluated.
    rounding
        (N,) Bound on the rounding error of V; empty for exact numbers.
    jumps
        Jumps of V caused by stepping sources.
    notes
        Sentences on assumptions that this run violates: positive weights, constants inside their box.
    residual
        (N,) Bound of the discrete-time certificate on the increase of V per sample; empty if not evaluated.
    constants
        Unknown constants in V as identified from the run, by label ``block.name``.
    about
        Description of these constants.
    """

    time: np.ndarray
    kappa: float
    V: np.ndarray
    terms: tuple[TermAlong, ...]
    dissipation: np.ndarray = field(default_factory=_none)
    rate: np.ndarray = field(default_factory=_none)
    rounding: np.ndarray = field(default_factory=_none)
    jumps: tuple[Jump, ...] = ()
    notes: tuple[str, ...] = ()
    residual: np.ndarray = field(default_factory=_none)
    constants: Mapping[str, np.ndarray] = field(default_factory=dict)
    about: str = ""

    @cached_property
    def climb(self) -> Climb:
        """Rise of V between its jumps, beyond the rounding error."""
        jumped = np.zeros_like(self.V)
        for jump in self.jumps:
            jumped[self.time >= jump.time] += jump.change
        return climb_of(self.time, self.V - jumped, self.rounding)

    @property
    def steps(self) -> np.ndarray:
        """(N - 1,) increment of V per sample."""
        with np.errstate(over="ignore", invalid="ignore"):  # the last samples of a run that diverged
            return np.diff(self.V)

    @property
    def beyond(self) -> int:
        """Number of samples over which V rises by more than the certificate's residual and rounding allow."""
        if not self.residual.size:
            return 0
        allowed = self.residual[:-1] + self.rounding[:-1] + self.rounding[1:]
        return int(np.count_nonzero(self.steps > allowed))

    @property
    def largest_increase(self) -> float:
        """Largest increase of V over one sample; 0 if it never rises."""
        return float(max(0.0, np.max(self.steps, initial=0.0)))

    @property
    def increase_at(self) -> float | None:
        """Start of the largest increase [s]; None if V never rises."""
        steps = self.steps
        return float(self.time[int(np.argmax(steps))]) if steps.size and np.max(steps) > 0 else None

    @property
    def rises(self) -> int:
        """Number of samples over which V rises."""
        return int(np.count_nonzero(self.steps > 0))


def along(claim: Claim, run: Recording, kappa: float = 1.0, *, assumed: bool = True) -> StorageTrace:
    r"""Evaluate :math:`V = \kappa (S_1 + S_2 + \dots) + S_{cascade}` along a run.

    In discrete time, an unknown constant in V, such as the initial state of a servo's integrator, is identified from
    the run (`dmframe.results.constants`), and `residual` bounds the increase of V. The evaluation takes two passes over
    the samples: 1.7 s of CPU for the 10001 samples of `ur10_fast_sampled`, and 1.1 s to assemble the certificate.

    Parameters
    ----------
    claim
        Certificate of the diagram that ran, or of one with the same blocks and parameter sizes.
    kappa
        Weight above the lower bound of the small-gain condition (`Verdict.kappa`); no effect without a cascade.
    assumed
        Whether the claim may assume that weights are positive; if not, none is looked for.

    Raises
    ------
    NotApplicableError
        The residual is not quadratic in an unknown constant of V.
    ValueFault
        The states of the run are not those of the certificate, or a state in V was not recorded and cannot be
        recomputed.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        return _over_samples(claim, run, kappa) if claim.over_samples else _over_time(claim, run, kappa, assumed)


def _over_time(claim: Claim, run: Recording, kappa: float, assumed: bool) -> StorageTrace:
    _check_same(claim, run)
    own = AtInstants(claim, run)
    stored = [(part.block, term.of, claim.weight(part) * term.value / 2) for part, term in _terms(claim)]
    column, V = (_weighed(claim, x, kappa) for x in (stack(value for *_, value in stored), claim.V))
    rates = _rates(claim, kappa)
    found = own.of(stack([column, rates]))  # at once, since they share most of their operations
    rows, (dissipation, rate) = found[: len(stored)], found[len(stored) :] if rates.numel() else (_none(), _none())
    return StorageTrace(
        time=run.time,
        kappa=kappa,
        V=np.sum(rows, axis=0),
        terms=_named(stored, rows),
        dissipation=dissipation,
        rate=rate,
        rounding=_rounding(own, V),
        jumps=_jumps(own, V),
        notes=tuple(_notes(own)) if assumed else (),
    )


def _over_samples(claim: Claim, run: Recording, kappa: float) -> StorageTrace:
    own, stored = AtInstants(claim, run), [(part.block, *term) for part in claim.parts for term in _stored(part)]
    column = stack(value / 2 for *_, value in stored)
    constants = determined(claim, column, own)
    column = constants.put(column)
    gained = constants.put(residual_of(claim)) if own.whole else ca.SX(0, 1)
    V = claim.loop.on_path(ca.sum1(column))
    found = own.of(stack([column, _size(claim, V), gained]))
    rows, (size, *residual) = found[: len(stored)], found[len(stored) :]
    return StorageTrace(
        time=run.time,
        kappa=kappa,
        V=np.sum(rows, axis=0),
        terms=_named(stored, rows),
        rounding=_relative_error(claim, V) * size,
        notes=tuple(notes_on(claim, constants, own)),
        residual=residual[0] if residual else _none(),
        constants=constants.by_label,
        about=constants.text,
    )


def _named(stored: Sequence[tuple[str, Text, SX]], rows: np.ndarray) -> tuple[TermAlong, ...]:
    return tuple(TermAlong(block, of, row) for (block, of, _), row in zip(stored, rows, strict=True))


def _terms(claim: Claim) -> list[tuple[Part, Stored]]:
    return [(part, term) for part in claim.parts for term in part.certificate.storage]


def _stored(part: Part) -> Iterator[tuple[Text, SX]]:
    """Names and values of a block's discrete-time storage terms; of steps, one per output."""
    for place, term in enumerate(part.certificate.storage, start=1):
        yield getattr(term, "of", UNNAMED) or Text(f"storage {place}"), term.value
    for item in part.certificate.steps:
        square = item.storage
        for j, rows in enumerate(slices(item.parts), start=1):
            name = f"{item.estimate}_{j}" if len(item.parts) > 1 else item.estimate
            weight = square.weight[rows] if square.weight.is_column() else square.weight[rows, rows]
            error = Formula(tree.subtract(Name(name), Name(f"{name}_true"), SCALAR))
            yield Text(error), Square(square.vector[rows], weight).value


def _notes(own: AtInstants) -> Iterator[str]:
    """Sentences on weights that are assumed positive but are not along the run."""
    from dmframe.certify.assumed import assumed_positive  # most claims assume none
    from dmframe.certify.checked import Numbers

    for item in assumed_positive(own.claim, Numbers(own.claim, {})):
        least = np.min(own.of(own.claim.loop.projected([item.column])[0]), axis=0)
        wrong = np.flatnonzero(~(least > 0))
        if wrong.size:
            first = int(wrong[0])
            yield (
                f"{item.text} is {least[first]:.3g} at t = {own.run.time[first]:.6g} s; the proof assumes that it "
                "stays above a positive constant, and does not apply after this time"
            )


def _check_same(claim: Claim, run: Recording) -> None:
    """Check that the run has the states and parameters of the claim, with the same sizes."""
    variables = claim.loop.variables
    wanted = {variable.label: variable.symbol.numel() for variable in variables}
    wanted |= {parameter.label: parameter.symbol.numel() for parameter in claim.loop.parameters}
    found = {label: rows.shape[1] for label, rows in run.states.items()}
    found |= {parameter.label: parameter.symbol.numel() for parameter in run.diagram.loop.parameters}
    for label in dict.fromkeys((*wanted, *found)):
        if wanted.get(label) != found.get(label):
            here, there = (f"{sizes[label]} of" if label in sizes else "no" for sizes in (wanted, found))
            raise ValueFault(
                f"V along a run: expected a run of the certificate's blocks, with {here} {label}, found {there}"
            )


def _rates(claim: Claim, kappa: float) -> SX:
    """Dissipation, and dV/dt by the certificate's identity; empty if a derivative is not available in this loop.

    Evaluating the identity is much cheaper than differentiating V.
    """
    loop = claim.loop
    spent = total([claim.weight(part) * part.dissipation for part in claim.parts])
    left = total([claim.weight(part) * (part.residual + part.lemma) for part in claim.parts]) + claim.consumption
    column = loop.projected([_weighed(claim, stack([spent, left - spent]), kappa)])[0]
    known = stack([loop.state, loop.time, loop.p])
    if ca.Function("rates", [known], [loop.on_path(column)], {"allow_free": True}).has_free():
        return ca.SX(0, 1)
    return column


def _relative_error(claim: Claim, V: SX) -> float:
    """Relative rounding error N eps of V: eps for each of its n operations and inputs."""
    loop = claim.loop
    inputs = [loop.state, loop.time, loop.period, loop.p]
    return float(ca.Function("V", inputs, [ca.cse(V)]).n_instructions() * np.finfo(float).eps)


def _size(claim: Claim, V: SX) -> SX:
    """|V| + sum |dV/dz| |z| over the states z: scale of V's rounding error, including cancellation."""
    state = claim.loop.state
    return ca.fabs(V) + ca.dot(ca.fabs(ca.gradient(V, state)), ca.fabs(state))


def _rounding(own: AtInstants, V: SX) -> np.ndarray:
    """First-order bound on the rounding error of V, interpolated from `ROUNDING_INSTANTS` instants."""
    count, V = own.run.time.size, own.claim.loop.on_path(V)
    looked = np.array(sorted({*np.linspace(0, count - 1, min(ROUNDING_INSTANTS, count)).astype(int).tolist()}))
    (size,) = own.of(_size(own.claim, V), looked)
    bound = _relative_error(own.claim, V) * size
    after = np.minimum(np.searchsorted(looked, np.arange(count)), len(looked) - 1)
    found: np.ndarray = np.maximum(bound[after], bound[np.maximum(after - 1, 0)])
    return found


def _jumps(own: AtInstants, V: SX) -> tuple[Jump, ...]:
    """Jump of V at each step of a source, at the states of the first recorded instant after it.

    Exact for a step at a recorded instant; otherwise the states are those of the later instant.
    """
    claim, time = own.claim, own.run.time
    stepping = [
        leaf
        for (block, port, _), leaf in claim.diagram.resolver.trajectories.items()
        if claim.diagram.resolver.steps(block, port)
    ]
    if not stepping:
        return ()
    held, moves = stack(leaf.symbol for leaf in stepping), stack(leaf.expression for leaf in stepping)
    values = own.of(moves)
    places = np.flatnonzero(np.any(np.diff(values, axis=1) != 0, axis=0)) + 1
    if not places.size:
        return ()
    kept = ca.SX.sym("kept", held.numel())
    (stepped,) = ca.substitute([V], [held], [kept])
    before, after = (own.of(stepped, places, [(kept, values[:, places - back])]) for back in (1, 0))
    return tuple(
        Jump(float(time[place]), float(change)) for place, change in zip(places, (after - before).ravel(), strict=True)
    )


def _weighed(claim: Claim, expression: SX, kappa: float) -> SX:
    return expression if claim.kappa.is_constant() else ca.substitute(expression, claim.kappa, kappa)
