"""Result of ``verify``, with all data that it depends on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal, final

from dmframe.block.certificate import Assumption
from dmframe.certify.checked import Checked
from dmframe.certify.claim import Claim
from dmframe.certify.error_bound import ErrorBounds
from dmframe.certify.explained import UNCHECKED
from dmframe.certify.residual import Bound, total_bound
from dmframe.certify.small_gain import Kappa
from dmframe.certify.statements import Statement, States
from dmframe.certify.states import states_in_v
from dmframe.common.errors import listed
from dmframe.common.text import Text
from dmframe.exact import ZeroTest
from dmframe.exact.rational import as_float
from dmframe.prove import claim as data
from dmframe.prove.faults import InjectedFault
from dmframe.prove.refute import Refutation

Outcome = Literal["proved", "refuted", "not_applicable"]

UNFELT: Final = frozenset(("rad", "s"))
"""Units of angles and of clocks, which may increase without bound in a stable loop."""

NAMED: Final = 3
"""Largest number of states that a headline lists by name; otherwise it gives their number, and the text the names."""


@final
@dataclass(frozen=True, repr=False)
class Verdict:
    """Result of `verify`, with all data that it depends on.

    Parameters
    ----------
    outcome
        ``proved``: the identity holds for all values of its symbols, every condition is met at the graph's numbers, and
        every seeded fault was refuted; with `bounds`, it is proved up to a bounded residual. ``refuted``: the
        identity is false. ``not_applicable``: there is nothing to prove, or a condition fails; `reason` gives the
        reason.
    test
        The exact test, with its error bound.
    states
        States that are bounded, and states that are not known to be.
    fixed
        Parameters that are zero in the graph and in the proof, by label.
    uncertain
        Parameters with intervals over which the conditions are met, by label.
    bounds
        Bounds on the residual of dV/dt, term by term; none for a claim without a residual.
    errors
        Bounds on the tracking errors; None if they were not computed.
    build, check
        Seconds for writing V and dV/dt, and for the decisions.
    exact
        The claim as data, to which `test`, `controls` and `refutation` refer; `dmframe.prove.export.to_json` writes it.
    """

    outcome: Outcome
    reason: Text
    claim: Claim | None = None
    test: ZeroTest | None = None
    refutation: Refutation | None = None
    kappa: Kappa | None = None
    conditions: tuple[Checked, ...] = ()
    assumptions: tuple[Assumption, ...] = ()
    controls: tuple[InjectedFault, ...] = ()
    statements: tuple[Statement, ...] = ()
    states: States | None = None
    fixed: tuple[str, ...] = ()
    uncertain: tuple[str, ...] = ()
    bounds: tuple[Bound, ...] = ()
    errors: ErrorBounds | None = None
    build: float = 0.0
    check: float = 0.0
    exact: data.Claim | None = None

    @property
    def flow_claim(self) -> Claim | None:
        """The claim, if it is in continuous time."""
        return self.claim if self.claim is not None and not self.claim.over_samples else None

    @property
    def samples(self) -> Claim | None:
        """The claim, if it is in discrete time."""
        return self.claim if self.claim is not None and self.claim.over_samples else None

    @property
    def stable(self) -> bool:
        """True if it is proved in continuous time, without a residual, that the states of the closed loop are bounded.

        Combinations of angles and clocks that no rate depends on, such as whole turns of a joint, are left out. False
        for a proof of an estimator over samples, and for one that leaves states open, or others in such a combination.
        """
        claim = self.flow_claim
        if self.outcome != "proved" or claim is None or self.bounds or self.states is None or self.states.open:
            return False
        harmless = {variable.label for variable in claim.loop.variables if variable.unit in UNFELT}
        return set(self.states.unfelt) <= harmless

    @property
    def rows_assumed(self) -> bool:
        """True if an estimator's rows could not be compared with motions of the plant."""
        return any(UNCHECKED in item.text for item in self.assumptions)

    @property
    def headline(self) -> str:
        """The result in words, with the limits of the proof."""
        words = self.outcome.replace("_", " ")
        if self.outcome == "proved" and self.samples is not None:
            words += f" over samples of {_over(self.samples, self.states)}"
            words += "; that its rows follow from the plant is assumed" * self.rows_assumed
        if self.outcome == "proved" and self.bounds:
            grows = any(bound.times for bound in self.bounds)
            words += ", up to a residual that grows with a signal" if grows else ", up to a bounded residual"
        if self.states is not None and self.states.open and self.outcome == "proved" and self.samples is None:
            words += ", but not the stability of the whole loop"
        return words

    @property
    def residual_bound(self) -> float | None:
        """Bound on dV/dt above minus the dissipation; None if a signal scales it, and in discrete time."""
        if self.samples is not None:
            return None
        return total_bound(list(self.bounds), as_float(self.kappa.chosen) if self.kappa else 1.0)

    def __repr__(self) -> str:
        return f"<Verdict: {self.headline}>"


def _over(claim: Claim, states: States | None) -> str:
    """States to which a discrete-time proof applies, its residual, and states that are not analysed."""
    held, left = states_in_v(claim), [] if states is None else list(states.open)
    words = _counted(held, "states") + f", up to {claim.left}" * bool(claim.left)
    if left:
        many = "states" if set(held) & set(left) else "other states"
        words += f"; {_counted(left, many)} {'is' if len(left) == 1 else 'are'} not known to be bounded, and"
    return f"{words} tracking is not part of it" if left else f"{words}; tracking is not part of it"


def _counted(labels: Sequence[str], many: str) -> str:
    """Names, or their number if there are many."""
    return listed(list(labels)) if len(labels) <= NAMED else f"{len(labels)} {many}"
