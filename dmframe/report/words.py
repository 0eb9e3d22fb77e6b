"""Meaning of a verdict, and its limits, in sentences."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, final

from dmframe.certify import Verdict
from dmframe.certify.claim import Claim
from dmframe.certify.states import states_in_v
from dmframe.common.errors import listed
from dmframe.common.units import plain

_UNDER: Final = "under the conditions checked and the assumptions listed below."
_MODEL: Final = "Effects outside the model, excluded by the assumptions, such as flexible joints or a saturated motor."


@final
@dataclass(frozen=True)
class Meaning:
    """Marked texts: verdict in one sentence, its meaning and its limits."""

    headline: str
    sentence: str
    means: tuple[str, ...]
    means_not: tuple[str, ...]


def meaning_of(verdict: Verdict, clock: float | None) -> Meaning:
    """Describe a verdict; `clock` is the sampling period of the graph [s], None for continuous time."""
    if verdict.outcome == "proved":
        return _proved(verdict, clock)
    return _refuted(verdict) if verdict.outcome == "refuted" else _not_applicable(verdict)


def _proved(verdict: Verdict, clock: float | None) -> Meaning:
    if verdict.samples is not None:
        return _proved_over_samples(verdict, verdict.samples)
    sentence = _sentence_with_residual(verdict) if verdict.bounds else _sentence(verdict)
    means = (
        "The proof is an identity: $\\dot V$, differentiated along the equations that the simulator integrates, "
        f"equals minus a sum of non-negative terms{_other_terms(verdict)}.",
        _decided(verdict),
        f"The identity holds for all values of the free symbols, not only for those of this graph; {_where(verdict)}",
        _controls(verdict),
    )
    return Meaning(verdict.headline.capitalize(), sentence, means, _limits(clock))


def _proved_over_samples(verdict: Verdict, claim: Claim) -> Meaning:
    states = listed([f"`{label}`" for label in states_in_v(claim)])
    rises = f"rises by no more than {claim.left}" if claim.left else "never rises"
    sentence = (
        f"from sample to sample, as a mathematical theorem, an energy-like function $V$ of {states} {rises}, for all "
        f"commands. The theorem does not cover tracking of the path.{_open(verdict)}"
    )
    plus = f", plus squares that are not bounded: {claim.left}" if claim.left else ""
    means = (
        "The proof is an identity: $V^+ - V$, on the map that the simulator computes at each sample, equals "
        f"minus a sum of non-negative terms{plus}.",
        _decided(verdict),
        "The identity holds for all values of the free symbols: every measurement, command and sampling period, "
        f"not only for those of this graph; {_where(verdict)}",
        _controls(verdict),
    )
    unexplained = (
        "The size of the residual of the data: it arises because means over a sample are evaluated at one point of it, "
        "and grows with the sampling period, noise and model error.",
    )
    means_not = (
        *(unexplained if any(part.certificate.steps for part in claim.parts) else ()),
        "That the robot tracks its path, or stays near it: its velocities are assumed bounded.",
        _MODEL,
    )
    return Meaning(verdict.headline.capitalize(), sentence, means, means_not)


def everywhere(verdict: Verdict) -> str:
    """Parameter values for which the satisfied conditions hold."""
    labels = listed([f"`{label}`" for label in verdict.uncertain])
    return "at the parameter values of this graph" + f" and anywhere in the intervals of {labels}" * bool(
        verdict.uncertain
    )


def somewhere(verdict: Verdict) -> str:
    """Parameter values for which conditions fail; with intervals, not necessarily the nominal ones."""
    labels = listed([f"`{label}`" for label in verdict.uncertain])
    return f"somewhere in the intervals of {labels}" if verdict.uncertain else "at the parameter values of this graph"


def _where(verdict: Verdict) -> str:
    """Parameter values at which conditions and conclusions were decided."""
    if not verdict.uncertain:
        return "the conditions and conclusions were decided at the parameter values of this graph."
    return f"the conditions were decided {everywhere(verdict)}; the conclusions, at the nominal values."


def _open(verdict: Verdict) -> str:
    """Note on states that are not proved bounded."""
    states = verdict.states
    if states is None or not states.open:
        return ""
    left = listed([f"`{label}`" for label in states.open])
    return f" The stability of the whole loop is not proved: neither $V$ nor its consequences bound {left}."


def _sentence(verdict: Verdict) -> str:
    """Consequences of V and its derivative, and whether they include stability of the whole loop."""
    signals = [f"${item.signal.latex}$" for item in verdict.statements if item.concludes]
    if not signals:
        signals = [
            f"${item.signal.latex}$" for item in verdict.statements if item.says == "goes to zero" and not item.assumes
        ]
    goes = f" {listed(signals)} {'goes' if len(signals) == 1 else 'go'} to zero," if signals else ""
    if left_open := _open(verdict):
        return (
            "in continuous time, as a mathematical theorem, an energy-like function $V$ never grows, so its signals "
            f"stay bounded,{goes} {_UNDER}{left_open}"
        )
    turns, states = "", verdict.states
    if states is not None and states.unfelt:
        left = listed([f"`{label}`" for label in states.unfelt])
        turns = f", except for a common drift of {left} that affects no other signal, such as whole turns"
    return (
        "in continuous time this control loop is stable, as a mathematical theorem: an energy-like function $V$ never "
        f"grows, all states stay bounded{turns}, {goes and f'and{goes} '}{_UNDER}"
    )


def _other_terms(verdict: Verdict) -> str:
    """Terms of the derivative other than the dissipation."""
    terms = []
    claim = verdict.flow_claim
    if claim is not None and claim.cascaded:
        terms.append("the cross term of the reference generator, which the servo level dominates")
    if claim is not None and claim.loop.projections:
        terms.append("the terms of the projections, which are never positive")
    if verdict.bounds:
        terms.append("the residual of the robust adaptation, listed below")
    return f", plus {listed(terms)}" if terms else ""


def _sentence_with_residual(verdict: Verdict) -> str:
    """Sentence on a loop with a bounded residual: V may grow, no convergence to zero."""
    ultimate = any(item.says == "is ultimately bounded" for item in verdict.statements)
    assumed = list(dict.fromkeys(text.marked for item in verdict.statements for text in item.assumes))
    provided = f", if {listed(assumed)}," if assumed else ","
    follows = (
        "every signal in $V$ is ultimately bounded"
        if ultimate
        else f"the dissipation is bounded in the mean square{provided} but $V$ alone bounds no other signal"
    )
    return (
        "in continuous time, as a mathematical theorem, an energy-like function $V$ falls wherever its dissipation "
        f"exceeds the residual of the robust adaptation, so {follows}, {_UNDER}{_open(verdict)}"
    )


def _decided(verdict: Verdict) -> str:
    test = verdict.test
    assert test is not None  # every proof has a test
    return (
        "The identity was evaluated exactly, in integer arithmetic modulo "
        f"{test.trials} random primes, with every state, trajectory, gain and physical parameter a free symbol"
        f"{_fixed(verdict)}. The probability that a false identity passes is below "
        f"$2^{{{test.log2_error_bound:.0f}}}$."
    )


def _fixed(verdict: Verdict) -> str:
    """Parameters that were not free symbols."""
    if not verdict.fixed:
        return ""
    names = listed([f"`{label}`" for label in verdict.fixed])
    return f", except {names}, {'each ' if len(verdict.fixed) > 1 else ''}zero in this graph and zero in the proof"


def _controls(verdict: Verdict) -> str:
    refuted, tried = sum(control.refuted for control in verdict.controls), len(verdict.controls)
    return f"Fault injection checks the test itself: it refuted {refuted} of {tried} faults in the equations."


def _limits(clock: float | None) -> tuple[str, ...]:
    sampled = (
        "The effect of sampling: the theorem and the simulated loop of this graph are in continuous time."
        if clock is None
        else "The effect of sampling: the theorem holds in continuous time, and this controller runs every "
        f"{plain(clock, 's')}. Its effect on $V$ was measured, not proved; see “The loop as it runs”."
    )
    return (
        sampled,
        _MODEL,
        "Rate of convergence and tracking accuracy.",
    )


def _refuted(verdict: Verdict) -> Meaning:
    found = verdict.refutation
    blame = listed([f"`{name}`" for name in found.blame]) if found is not None else ""
    place = (
        f"the fault is in the equations or in the certificate of {blame}"
        if blame
        else "each block satisfies its own certificate, but the exchanged signals differ; the fault is in the wiring"
    )
    signals = [f"`{name}`" for name in found.signals] if found is not None else []
    means = (
        "The certificates give a formula for $\\dot V$. At the exact point below, $\\dot V$ from the equations differs "
        "from it. One such point suffices, and exact arithmetic has no rounding errors.",
        (f"Only {listed(signals)} must be non-zero; all other signals can be zero."
         if signals else "It fails even with all signals zero."),
        "Check signs, factors and signals in the equations or the certificate of the block, and verify again.",
    )  # fmt: skip
    not_means = (
        "That the loop is unstable: a false certificate does not prove instability.",
        "That the identity fails for all parameter values: they were free symbols, and it may hold for some.",
    )
    return Meaning("Refuted", f"the certificate is false; {place}.", means, not_means)


def _not_applicable(verdict: Verdict) -> Meaning:
    failing = [condition.name.marked for condition in verdict.conditions if not condition.holds]
    means: tuple[str, ...]
    if verdict.flow_claim is None:
        means = (
            "A proof requires a certificate (storage function and dissipation) from every block. It is missing for the "
            "reason given, so nothing was tested.",
        )
        why = f"this graph has no certificate to test: {verdict.reason.marked}."
    elif failing:
        means = (
            f"The identity for $\\dot V$ is exact. {_decided(verdict)}",
            f"But {somewhere(verdict)} these conditions of the theorem fail: "
            f"{'; '.join(failing)}. The table lists their margins.",
        )
        count = f"{len(failing)} of its {len(verdict.conditions)} conditions"
        fails = "fails" if len(failing) == 1 else "fail"
        why = (
            f"the formula for $\\dot V$ is right, but {count} {fails} {somewhere(verdict)}, the first being "
            f"{failing[0]}."
        )
    else:
        means = ("The test did not detect all injected faults, so its result is not valid.",)
        why = f"{verdict.reason.marked}."
    not_means = (
        "That the loop is unstable, or that the blocks are wrong.",
        "That the loop is stable.",
    )
    return Meaning("Not proved, and not refuted", why, means, not_means)
