"""V along a run: the same expressions that were proved, evaluated at what was simulated."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, final

import casadi as ca
import numpy as np

from dmframe.certify.claim import Claim
from dmframe.diagram.closed_loop import stack
from dmframe.errors import ValueFault
from dmframe.simulate import Recording

CHUNK = 2048
"""Samples evaluated in one call."""


@final
@dataclass(frozen=True)
class TermAlong:
    r"""One term of V: :math:`\tfrac12 \kappa |a|_W^2` of `block`, or without kappa for a cascade; (N,) values.

    `of` is a in the code's names, and `drawn` the same for a drawing.
    """

    block: str
    of: str
    values: np.ndarray
    drawn: str = ""


@final
@dataclass(frozen=True)
class Along:
    """V and its terms at every sample of a run.

    Parameters
    ----------
    time
        (N,) [s].
    kappa
        The weight of the servo level.
    """

    time: np.ndarray
    kappa: float
    V: np.ndarray
    terms: tuple[TermAlong, ...]

    @property
    def steps(self) -> np.ndarray:
        """(N - 1,) V at each sample minus V at the one before."""
        with np.errstate(over="ignore", invalid="ignore"):  # the last samples of a run that diverged
            return np.diff(self.V)

    @property
    def largest_increase(self) -> float:
        """The most that V rises from one sample to the next; 0 where it never rises."""
        return float(max(0.0, np.max(self.steps, initial=0.0)))

    @property
    def increase_at(self) -> float | None:
        """When the largest increase begins [s]; None where V never rises."""
        steps = self.steps
        return float(self.time[int(np.argmax(steps))]) if steps.size and np.max(steps) > 0 else None

    @property
    def rises(self) -> int:
        """From how many samples to the next V rises."""
        return int(np.count_nonzero(self.steps > 0))


def along(claim: Claim, run: Recording, kappa: float = 1.0) -> Along:
    r"""Evaluate :math:`V = \kappa (S_1 + S_2 + \dots) + S_{cascade}` along a run.

    Parameters
    ----------
    claim
        Of the diagram that was run, or of one of the same blocks and parameters' sizes.
    kappa
        Above the least that pays for the cascade, as `Verdict.kappa` says; without a cascade it has no effect.

    Raises
    ------
    ValueFault
        A run whose states are not those of the claim.
    """
    _check_same(claim, run)
    stored = [
        (part, square, law)
        for part in claim.parts
        for square, law in zip(part.certificate.storage, claim.laws[part.block].storage, strict=True)
    ]
    rows = _evaluated(claim, run, [claim.weight(part) * square.value / 2 for part, square, _ in stored], kappa)
    terms = tuple(
        TermAlong(part.block, square.of, row, law.vector.unicode)
        for (part, square, law), row in zip(stored, rows, strict=True)
    )
    with np.errstate(over="ignore", invalid="ignore"):
        total = np.sum(rows, axis=0) if len(rows) else np.zeros(run.time.size)
    return Along(run.time, kappa, total, terms)


def _check_same(claim: Claim, run: Recording) -> None:
    """The run has the states and parameters of the claim, each of its size."""
    variables = claim.loop.variables
    wanted = {variable.label: variable.symbol.numel() for variable in variables}
    wanted |= {parameter.label: parameter.symbol.numel() for parameter in claim.loop.parameters}
    found = {label: rows.shape[1] for label, rows in run.states.items()}
    found |= {parameter.label: parameter.symbol.numel() for parameter in run.diagram.loop.parameters}
    for label in dict.fromkeys((*wanted, *found)):
        if wanted.get(label) != found.get(label):
            here, there = (f"{sizes[label]} of" if label in sizes else "no" for sizes in (wanted, found))
            raise ValueFault(
                f"V along a run: expected a run of the claim's own blocks, with {here} {label}, found {there}"
            )


def _evaluated(claim: Claim, run: Recording, expressions: list[Any], kappa: float) -> np.ndarray:
    """Each expression at every sample, (terms, N), with the trajectories as the functions of time that they are."""
    loop, count = claim.loop, run.time.size
    column = loop.on_path(stack(expressions))
    if not claim.kappa.is_constant():
        column = ca.substitute(column, claim.kappa, kappa)
    states = np.hstack([run.states[variable.label] for variable in loop.variables]).T
    function = ca.Function("terms", [loop.state, loop.time, loop.p], [ca.cse(column)])
    values, mapped = np.empty((len(expressions), count)), dict[int, Any]()
    for first in range(0, count, CHUNK):
        part = slice(first, min(first + CHUNK, count))
        size = part.stop - part.start
        if size not in mapped:
            mapped[size] = function.map(size)
        moment = np.tile(run.diagram.loop.p_values[:, None], size)
        values[:, part] = mapped[size](states[:, part], run.time[None, part], moment).full()
    return values
