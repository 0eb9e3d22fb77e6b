"""V along a run: its values, its rise and possible causes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np

from dmframe.common.errors import DmframeError, listed
from dmframe.common.plotting import verbatim
from dmframe.common.units import plain
from dmframe.config import BaseGraph
from dmframe.results.decided import Decided, StorageUnit
from dmframe.simulate import Recording
from dmframe.simulate.recording import ExtraSignal
from dmframe.simulate.warnings import channel_models

if TYPE_CHECKING:
    from dmframe.certify.claim import Claim
    from dmframe.results.along import StorageTrace

SIGNALS: Final = ("V", "V_rate", "V_dissipation", "V_residual")
"""Labels of V, its rate, dissipation and residual; the storage function of a block is ``V.block``."""

UNIT: Final = "unknown"
"""Unit of V if it has several units or none was derived."""

EXPLAINED: Final = frozenset({"residual", "sampling", "channels", "log"})
"""Possible causes of a rise of V that do not violate an assumption of the certificate."""

SLIGHT: Final = 1e-3
"""Rise of V, as a fraction of its fall, up to which a notice is omitted where the certificate explains it: the bound on
each error that follows from V(0), the square root of V over a weight, increases by at most half of this fraction."""


@final
@dataclass(frozen=True)
class Storage:
    """V along a run, with its certificate.

    Only the numeric conditions of the certificate are checked here; `verify` proves it.

    Parameters
    ----------
    along
        V, its terms, dV/dt and the dissipation; in discrete time also the residual.
    decided
        Earlier decisions on the same graph; None if they were made now.
    """

    claim: Claim
    along: StorageTrace
    recording: Recording
    decided: Decided | None = None

    @cached_property
    def signals(self) -> Mapping[str, ExtraSignal]:
        """V, dV/dt, the dissipation, the residual and the storage function of each block over time."""
        along, over = self.along, self.claim.over_samples
        about = "V of the discrete-time certificate" if over else "V of the continuous-time certificate"
        unit, rated = self.unit.unit or UNIT, self.unit.rate or UNIT
        about += f" {along.about}" * bool(along.about) if over else f", kappa = {along.kappa:.6g}"
        about += f"; {self.unit.about}" * bool(self.unit.several)
        found = {"V": ExtraSignal(along.V[:, None], "", unit, about)}
        for block in dict.fromkeys(term.block for term in along.terms):
            part = np.sum([term.values for term in along.terms if term.block == block], axis=0)
            about = f"storage function of {block} in V"
            found[f"V.{block}"] = ExtraSignal(part[:, None], "", self._of_part(block), about)
        if along.rate.size:
            about = "dV/dt of the continuous-time certificate at these states"
            found["V_rate"] = ExtraSignal(along.rate[:, None], "", rated, about)
            about = "weighted squares dissipated in dV/dt, continuous time"
            found["V_dissipation"] = ExtraSignal(along.dissipation[:, None], "", rated, about)
        if along.residual.size:
            about = "bound of the discrete-time certificate on the increase of V to the next sample"
            found["V_residual"] = ExtraSignal(along.residual[:, None], "", unit, about)
        return {label: item for label, item in found.items() if label not in self._taken}

    def _of_part(self, block: str) -> str:
        """Unit of a block's storage function; on the servo level kappa converts it to the unit of V."""
        return self.unit.unit or ("" if self.claim.cascaded else self.unit.parts.get(block, "")) or UNIT

    @cached_property
    def unit(self) -> StorageUnit:
        """Unit of V, or the units of its terms."""
        if self.decided is not None and self.decided.unit is not None:
            return self.decided.unit
        from dmframe.results.storage_unit import storage_unit

        return storage_unit(self.claim)

    @property
    def names(self) -> tuple[str, ...]:
        """Those of V's terms, for a figure."""
        if self.decided is not None:
            return self.decided.names
        return tuple(f"{term.of.unicode} ({verbatim(term.block)})" for term in self.along.terms)

    @property
    def _taken(self) -> set[str]:
        """Labels of the recording, which take precedence for a block named V."""
        return {*self.recording.states, *self.recording.outputs}

    @cached_property
    def causes(self) -> Mapping[str, str]:
        """Possible causes of a rise of V by keyword: differences between this run and the theorem, not computed."""
        return dict(_causes(self.claim, self.along, self.recording))

    @property
    def notice(self) -> str:
        """Warning about a rise of V, or about a non-positive assumed weight; may be empty. See `SLIGHT`."""
        climb, jumps = self.along.climb, [jump for jump in self.along.jumps if jump.change > 0]
        notes = list(self.along.notes)
        if climb.rise and not self._slight:
            fraction = "it never fell below its start" if climb.fraction is None else (
                f"{100 * climb.fraction:.3g} % of its fall, which is {climb.fall:.3g}"
            )  # fmt: skip
            assert climb.since is not None
            assert climb.until is not None
            notes.append(
                f"V rose by {climb.rise:.3g} between t = {climb.since:.6g} s and t = {climb.until:.6g} s, {fraction}; "
                f"it rose at {climb.rises} of {climb.steps} {self._instants}"
            )
            notes += self.causes.values()
            if self.along.about:
                notes.append(f"V is evaluated {self.along.about}")
            if "sampling" in self.causes:
                notes.append("the effect of a shorter period was not computed: run it with another `clock`")
        if jumps:
            where = listed([f"{jump.change:.3g} at t = {jump.time:.6g} s" for jump in jumps[:3]])
            more = f" and {len(jumps) - 3} more times" if len(jumps) > 3 else ""
            notes.append(f"steps of a source raised V by {where}{more} at constant states")
        return "; ".join(notes)

    @property
    def _slight(self) -> bool:
        """True for a small rise that the sampling period or the residual of the certificate explains."""
        fraction = self.along.climb.fraction
        return fraction is not None and fraction <= SLIGHT and self.causes.keys() <= EXPLAINED

    @property
    def _instants(self) -> str:
        return "recorded instants" if self.recording.clock is None or "log" in self.causes else "samples"

    @property
    def summary(self) -> dict[str, Any]:
        """Data for ``run --json``."""
        climb = self.along.climb
        return {
            "unit": self.unit.unit or None,
            "units": list(self.unit.several),
            "start": _number(climb.start),
            "end": _number(climb.end),
            "least": _number(climb.least),
            "fall": _number(climb.fall),
            "rise": _number(climb.rise),
            "share": None if climb.fraction is None else _number(climb.fraction),
            "at": climb.since,
            "until": climb.until,
            "rises": climb.rises,
            "steps": climb.steps,
            "beyond": self.along.beyond if self.along.residual.size else None,
            "constants": {label: list(values) for label, values in self.along.constants.items()},
            "jumps": [{"time": jump.time, "change": _number(jump.change)} for jump in self.along.jumps],
            "cause": list(self.causes) if climb.rise else [],
            "cause_computed": False,
            "kappa": self.along.kappa,
            "reason": None,
        }


def storage_of(recording: Recording, graph: BaseGraph, decided: Decided | None = None) -> Storage:
    """V of a run; raises `DmframeError` if it is not defined. What was `decided` before is not decided again."""
    if decided is None:
        from dmframe.results.claimed import claimed_along  # its imports take a tenth of a second

        intervals = graph.intervals(recording.diagram)
        return Storage(*claimed_along(recording, intervals, graph.start), recording)
    from dmframe.block.model import SYMBOLIC
    from dmframe.certify.claim import NotApplicableError, claim_of
    from dmframe.results.along import along

    if decided.reason:
        raise NotApplicableError(decided.reason)
    with SYMBOLIC:
        claim = claim_of(recording.diagram, held=False, named=False)
        found = along(claim, recording, decided.kappa, assumed=decided.assumed)
    return Storage(claim, found, recording, decided)


def decided_by(run: Recording, graph: BaseGraph, found: Storage | DmframeError) -> Decided | None:
    """What a graph decides about V, from V of its run, or from why there is none.

    None where the reason is another one than the graph's claim, such as a signal that the run did not keep.
    """
    from dmframe.certify.assumed import assumed_positive
    from dmframe.certify.checked import Numbers
    from dmframe.results.claimed import checked_claim

    if isinstance(found, Storage):
        assumed = not found.claim.over_samples and any(assumed_positive(found.claim, Numbers(found.claim, {})))
        return Decided("", found.along.kappa, assumed, found.names, found.unit)
    try:
        checked_claim(run.diagram, graph.intervals(run.diagram), graph.start)
    except DmframeError as error:
        return Decided(error.text)
    return None


def no_storage(error: DmframeError) -> dict[str, Any]:
    """`Storage.summary` of a run without V, with the reason."""
    keys = ("unit", "start", "end", "least", "fall", "rise", "share", "at", "until", "rises", "steps", "beyond")
    return {
        **dict.fromkeys(keys),
        "units": [],
        "constants": {},
        "jumps": [],
        "cause": [],
        "cause_computed": False,
        "kappa": None,
        "reason": error.text,
    }


def with_storage(recording: Recording, storage: Storage | None) -> Recording:
    """Add V to the extra signals of a recording."""
    return recording if storage is None else replace(recording, beside={**recording.beside, **storage.signals})


def _causes(claim: Claim, along: StorageTrace, run: Recording) -> Iterator[tuple[str, str]]:
    if claim.over_samples:
        yield _over_samples(claim, along)
    else:
        blocks = [part.block for part in claim.parts if part.certificate.residual]
        if blocks:
            yield "residual", f"the certificate allows V to rise by the residual of {listed(blocks)}"
        if run.clock is not None:
            yield (
                "sampling",
                f"the certificate is for continuous time, and this run samples every {plain(run.clock, 's')}",
            )
        elif not blocks:
            yield (
                "integrator or assumption",
                "the certificate excludes a rise of V: integration error, or a violated assumption",
            )
    if channels := channel_models(run.diagram):
        yield "channels", channels
    if run.clock is not None and run.time.size > 1:
        every = round(float(run.time[1] - run.time[0]) / run.clock)
        if every > 1:
            yield "log", f"one of {every} samples was recorded; V between them is not evaluated"


def _over_samples(claim: Claim, along: StorageTrace) -> tuple[str, str]:
    violated = "so this run violates one of its assumptions"
    if not claim.left:
        return "assumption", f"the discrete-time certificate excludes a rise of V, {violated}"
    allowed = f"the discrete-time certificate allows V to rise by {claim.left}"
    if along.beyond:
        many = "sample" if along.beyond == 1 else "samples"
        return "assumption", f"{allowed}, and V rose by more at {along.beyond} {many}, {violated}"
    return "residual", f"{allowed}, and V rose by no more at any sample" if along.residual.size else allowed


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
