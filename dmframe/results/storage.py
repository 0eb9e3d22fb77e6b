"""V of a run: its value at each kept instant, how far it rose, and what is known of the reason."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final, final

import numpy as np

from dmframe.certify.along import Along
from dmframe.certify.claim import Claim
from dmframe.certify.samples import SampledClaim
from dmframe.certify.unproved import claimed_along
from dmframe.config import Experiment
from dmframe.errors import DmframeError, listed
from dmframe.simulate import Recording
from dmframe.simulate.run import Beside
from dmframe.simulate.told import between
from dmframe.units import plain

SIGNALS: Final = ("V", "V_rate", "V_dissipation")
"""What a run has beside the signals of its blocks; the part of one block is ``V.block``."""

UNIT: Final = "unknown"
"""The claim's weights give all terms of V one unit, which is not derived."""


@final
@dataclass(frozen=True)
class Storage:
    """V along a run, with the claim that it is taken from.

    The claim is not tested here, but for the conditions that numbers decide: `verify` proves it or does not.

    Parameters
    ----------
    along
        V, its terms, dV/dt and what is dissipated.
    """

    claim: Claim | SampledClaim
    along: Along
    recording: Recording

    @cached_property
    def signals(self) -> Mapping[str, Beside]:
        """V, dV/dt, the dissipation, and the part of each block that stores something, each over time."""
        along, over = self.along, isinstance(self.claim, SampledClaim)
        about = "V of the claim over samples" if over else "V of the claim in continuous time"
        found = {"V": Beside(along.V[:, None], "", UNIT, f"{about}, kappa = {along.kappa:.6g}")}
        for block in dict.fromkeys(term.block for term in along.terms):
            part = np.sum([term.values for term in along.terms if term.block == block], axis=0)
            found[f"V.{block}"] = Beside(part[:, None], "", UNIT, f"the part of V that {block} stores")
        if along.rate.size:
            rate = "dV/dt that the claim states for continuous time at these states"
            found["V_rate"] = Beside(along.rate[:, None], "", f"{UNIT}/s", rate)
            spent = "the squares that dV/dt spends in continuous time, each with its weight"
            found["V_dissipation"] = Beside(along.dissipation[:, None], "", f"{UNIT}/s", spent)
        return {label: item for label, item in found.items() if label not in self._taken}

    @property
    def _taken(self) -> set[str]:
        """Labels of a block that is itself called V."""
        return {*self.recording.states, *self.recording.outputs}

    @cached_property
    def causes(self) -> Mapping[str, str]:
        """What is known to differ between this run and a claim that V does not rise: a word, and a sentence.

        None of these was computed to be the cause of a rise: that takes another run.
        """
        return dict(_causes(self.claim, self.recording))

    @property
    def notice(self) -> str:
        """By how much V rose and what is known of the reason, and where an assumed weight is not above zero.

        Empty where nothing of this happened.
        """
        climb, jumps = self.along.climb, [jump for jump in self.along.jumps if jump.change > 0]
        said = list(self.along.crossings)
        if climb.rise:
            share = "it never came below its start" if climb.share is None else (
                f"{100 * climb.share:.3g} % of its fall, which is {climb.fall:.3g}"
            )  # fmt: skip
            assert climb.since is not None
            assert climb.until is not None
            said.append(
                f"V rose by {climb.rise:.3g} between t = {climb.since:.6g} s and t = {climb.until:.6g} s, {share}; "
                f"it rose at {climb.rises} of {climb.steps} {self._instants}"
            )
            said += self.causes.values()
            if "sampling" in self.causes:
                said.append("whether a faster clock takes the rise away was not computed: run it with another `clock`")
        if jumps:
            where = listed([f"{jump.change:.3g} at t = {jump.time:.6g} s" for jump in jumps[:3]])
            more = f" and {len(jumps) - 3} more times" if len(jumps) > 3 else ""
            said.append(f"a source that steps raised V by {where}{more}, while no state moved")
        return "; ".join(said)

    @property
    def _instants(self) -> str:
        return "kept instants" if self.recording.clock is None or "log" in self.causes else "samples"

    @property
    def summary(self) -> dict[str, Any]:
        """As plain data, for ``run --json``."""
        climb = self.along.climb
        return {
            "unit": None,
            "start": _number(climb.start),
            "end": _number(climb.end),
            "least": _number(climb.least),
            "fall": _number(climb.fall),
            "rise": _number(climb.rise),
            "share": None if climb.share is None else _number(climb.share),
            "at": climb.since,
            "until": climb.until,
            "rises": climb.rises,
            "steps": climb.steps,
            "jumps": [{"time": jump.time, "change": _number(jump.change)} for jump in self.along.jumps],
            "cause": list(self.causes) if climb.rise else [],
            "cause_computed": False,
            "kappa": self.along.kappa,
            "reason": None,
        }


def storage_of(recording: Recording, experiment: Experiment) -> Storage:
    """V of a run. Raises `DmframeError` with the reason where there is none."""
    intervals = experiment.intervals(recording.diagram)
    return Storage(*claimed_along(recording, intervals, experiment.start), recording)


def no_storage(error: DmframeError) -> dict[str, Any]:
    """The keys of `Storage.summary` of a run without V, with the reason."""
    keys = ("unit", "start", "end", "least", "fall", "rise", "share", "at", "until", "rises", "steps")
    return {
        **dict.fromkeys(keys),
        "jumps": [],
        "cause": [],
        "cause_computed": False,
        "kappa": None,
        "reason": error.text,
    }


def with_storage(recording: Recording, storage: Storage | None) -> Recording:
    """The recording with V among what stands beside the signals of its blocks."""
    return recording if storage is None else replace(recording, beside={**recording.beside, **storage.signals})


def _causes(claim: Claim | SampledClaim, run: Recording) -> Iterator[tuple[str, str]]:
    if isinstance(claim, SampledClaim):
        if claim.left == "nothing":
            yield "assumption", "the claim over samples lets V never rise, so that this run breaks an assumption of it"
        else:
            yield "residual", f"the claim over samples lets V rise by {claim.left}"
    else:
        blocks = [part.block for part in claim.parts if part.certificate.excess]
        if blocks:
            yield "residual", f"the claim lets V rise by the residual of {listed(blocks)}"
        if run.clock is not None:
            yield (
                "sampling",
                f"the claim is for continuous time, and this run samples every {plain(run.clock, 's')}",
            )
        elif not blocks:
            yield (
                "integrator or assumption",
                "the claim lets V never rise: the integrator's error, or an assumption that this run breaks",
            )
    if way := between(run.diagram):
        yield "channels", way
    if run.clock is not None and run.time.size > 1:
        apart = round(float(run.time[1] - run.time[0]) / run.clock)
        if apart > 1:
            yield "log", f"one of {apart} samples was kept, and V between two kept ones is not seen"


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
