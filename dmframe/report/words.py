"""What a verdict means, and what it does not mean, in sentences for a reader who does not know the tool."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from dmframe.certify import Verdict
from dmframe.certify.sample_states import held_in_v
from dmframe.certify.samples import SampledClaim
from dmframe.errors import listed
from dmframe.report.notation import marked, signal_latex
from dmframe.units import plain


@final
@dataclass(frozen=True)
class Meaning:
    """Marked texts: the verdict in one sentence, what it says and what it does not say."""

    headline: str
    sentence: str
    means: tuple[str, ...]
    means_not: tuple[str, ...]


def meaning_of(verdict: Verdict, clock: float | None) -> Meaning:
    """The words for a verdict; `clock` is the graph's sampling period [s], None for continuous time."""
    writer = {"proved": _proved, "refuted": _refuted, "not_applicable": _not_applicable}[verdict.outcome]
    return writer(verdict, clock)


def _proved(verdict: Verdict, clock: float | None) -> Meaning:
    if verdict.samples is not None:
        return _proved_over_samples(verdict, verdict.samples)
    sentence = _sentence_with_residual(verdict) if verdict.bounds else _sentence(verdict)
    means = (
        "The proof is an identity: $\\dot V$, differentiated along the very equations that the simulator integrates, "
        f"equals exactly minus a sum of terms none of which can be negative{_beside(verdict)}.",
        _decided(verdict),
        f"The identity holds for all values of the free symbols, not only for those of this graph; {_where(verdict)}",
        f"The test can say no: {_controls(verdict)}",
    )
    return Meaning(verdict.headline.capitalize(), sentence, means, _limits(clock))


def _proved_over_samples(verdict: Verdict, claim: SampledClaim) -> Meaning:
    held = listed([f"`{label}`" for label in held_in_v(claim)])
    rises = f"rises by no more than {claim.left}" if claim.left else "never rises"
    sentence = (
        f"from sample to sample, as a mathematical theorem, an energy-like function $V$ of {held} {rises}, whatever is "
        f"commanded; that the robot follows its path is not a part of this theorem.{_open(verdict)}"
    )
    plus = f", plus squares that are not bounded: {claim.left}" if claim.left else ""
    means = (
        "The proof is an identity: $V^+ - V$, on the very map that the simulator computes at each sample, equals "
        f"exactly minus a sum of terms none of which can be negative{plus}.",
        _decided(verdict),
        "The identity holds for all values of the free symbols: every measurement, command and sampling period, "
        f"not only for those of this graph; {_where(verdict)}",
        f"The test can say no: {_controls(verdict)}",
    )
    unexplained = (
        "How large that is which the data leave unexplained: it is there because means over a sample are taken at one "
        "point of it, and grows with the period, with noise, and with what the plant has and the model has not.",
    )
    means_not = (
        *(unexplained if any(part.steps for part in claim.parts) else ()),
        "That the robot follows its path, or stays near it: its velocities are assumed to stay bounded.",
        "Anything beyond the model: whatever the assumptions exclude, such as flexible joints or a saturated motor.",
    )
    return Meaning(verdict.headline.capitalize(), sentence, means, means_not)


def everywhere(verdict: Verdict) -> str:
    """Where conditions that hold do."""
    labels = listed([f"`{label}`" for label in verdict.uncertain])
    return "at the numbers of this graph" + f" and anywhere in the intervals of {labels}" * bool(verdict.uncertain)


def somewhere(verdict: Verdict) -> str:
    """Where conditions that fail do: of intervals, not necessarily at the numbers themselves."""
    labels = listed([f"`{label}`" for label in verdict.uncertain])
    return f"somewhere in the intervals of {labels}" if verdict.uncertain else "at the numbers of this graph"


def _where(verdict: Verdict) -> str:
    """At which numbers the rest was decided."""
    if not verdict.uncertain:
        return "the conditions, and what follows, were decided at the numbers of this graph."
    return f"the conditions were decided {everywhere(verdict)}; what follows, at the numbers."


def _open(verdict: Verdict) -> str:
    """What is not said of a loop of which some state is not known to be bounded."""
    states = verdict.states
    if states is None or not states.open:
        return ""
    left = listed([f"`{label}`" for label in states.open])
    return f" This is not the stability of the whole loop: neither $V$ nor anything that follows from it bounds {left}."


def _sentence(verdict: Verdict) -> str:
    """What V and its derivative bring about, and whether that is the stability of the whole loop."""
    laws = verdict.claim.laws if verdict.claim is not None else {}
    told = [f"${signal_latex(item.signal, laws)}$" for item in verdict.statements if item.concludes]
    if not told:
        told = [
            f"${signal_latex(item.signal, laws)}$"
            for item in verdict.statements
            if item.says == "goes to zero" and not item.assumes
        ]
    goes = f" {listed(told)} {'goes' if len(told) == 1 else 'go'} to zero," if told else ""
    under = "under the conditions checked and the assumptions listed below."
    if left_open := _open(verdict):
        return (
            "in continuous time, as a mathematical theorem, an energy-like function $V$ never grows, so that what it "
            f"holds stays bounded,{goes} {under}{left_open}"
        )
    turns, states = "", verdict.states
    if states is not None and states.unfelt:
        left = listed([f"`{label}`" for label in states.unfelt])
        turns = f", but for a common drift of {left} that no other signal feels, such as whole turns"
    return (
        "in continuous time this control loop is stable, as a mathematical theorem: an energy-like function $V$ never "
        f"grows, all states stay bounded{turns}, and{goes or ' no more is said of the errors'} {under}"
    )


def _beside(verdict: Verdict) -> str:
    """What the derivative holds beside the terms that are lost."""
    terms = []
    claim = verdict.claim
    if claim is not None and claim.cascaded:
        terms.append("what the reference generator consumes, for which the servo level pays")
    if claim is not None and claim.loop.projections:
        terms.append("what the projections add, which is never positive")
    if verdict.bounds:
        terms.append("the terms listed below that a robust adaptation leaves over")
    return f", plus {listed(terms)}" if terms else ""


def _sentence_with_residual(verdict: Verdict) -> str:
    """What a bounded residual leaves: V may grow, and nothing is said to go to zero."""
    ultimate = any(item.says == "is ultimately bounded" for item in verdict.statements)
    assumed = list(dict.fromkeys(marked(text) for item in verdict.statements for text in item.assumes))
    provided = f", if {listed(assumed)}," if assumed else ","
    follows = (
        "every signal that $V$ holds ends up in a bounded set"
        if ultimate
        else f"what $\\dot V$ spends is bounded in the mean square{provided} but $V$ alone bounds no other signal"
    )
    return (
        "in continuous time, as a mathematical theorem, an energy-like function $V$ falls wherever what it spends is "
        f"more than what a robust adaptation leaves over, so {follows}, under the conditions checked and the "
        f"assumptions listed below.{_open(verdict)}"
    )


def _decided(verdict: Verdict) -> str:
    test = verdict.test
    assert test is not None  # there is no proof without a test
    return (
        "The identity was not tried out with numbers: it was evaluated exactly, in integer arithmetic modulo "
        f"{test.trials} random primes, with every state, trajectory, gain and physical parameter a free symbol"
        f"{_held(verdict)}. If it were false, this would have gone unnoticed with a probability below "
        f"$2^{{{test.log2_error_bound:.0f}}}$."
    )


def _held(verdict: Verdict) -> str:
    """The numbers that were not free."""
    if not verdict.fixed:
        return ""
    names = listed([f"`{label}`" for label in verdict.fixed])
    return f", except {names}, {'each ' if len(verdict.fixed) > 1 else ''}zero in this graph and zero in the proof"


def _controls(verdict: Verdict) -> str:
    refuted, tried = sum(control.refuted for control in verdict.controls), len(verdict.controls)
    return f"of {tried} faults put into the equations on purpose it refuted {refuted}."


def _limits(clock: float | None) -> tuple[str, ...]:
    sampled = (
        "What a sampled controller does: the theorem is one of continuous time, as is the simulated loop of this graph."
        if clock is None
        else "What sampling does: the theorem is one of continuous time, and this controller runs every "
        f"{plain(clock, 's')}. What that does to $V$ was measured, not proved, and stands under “The loop as it runs”."
    )
    return (
        sampled,
        "Anything beyond the model: whatever the assumptions exclude, such as flexible joints or a saturated motor.",
        "How fast, or how accurately, the robot follows its path.",
    )


def _refuted(verdict: Verdict, clock: float | None) -> Meaning:
    found = verdict.refutation
    blame = listed([f"`{name}`" for name in found.blame]) if found is not None else ""
    place = (
        f"the fault lies in the equations or in the certificate of {blame}"
        if blame
        else "each block keeps its own claim, but what they exchange differs; the fault lies in how they are wired"
    )
    signals = [f"`{name}`" for name in found.signals] if found is not None else []
    means = (
        "The blocks claim a formula for $\\dot V$. At the exact point below, $\\dot V$ computed from their equations "
        "differs from it. One such point is enough, and exact arithmetic leaves no room for rounding.",
        (f"It takes no more than {listed(signals)} to see it; all other signals can be zero."
         if signals else "All signals can be zero, and it still shows."),
        "The error is one of signs, factors or signals in a block: mend its equations or its certificate, and verify "
        "again.",
    )  # fmt: skip
    not_means = (
        "That the loop is unstable: a false claim is no proof of the contrary.",
        "That the claim holds for no choice of numbers: they were free symbols, and a single choice is not ruled out.",
    )
    del clock
    return Meaning("Refuted", f"the blocks' claim about $V$ is false; {place}.", means, not_means)


def _not_applicable(verdict: Verdict, clock: float | None) -> Meaning:
    failing = [condition.name for condition in verdict.conditions if not condition.holds]
    means: tuple[str, ...]
    if verdict.claim is None:
        means = (
            "A proof needs a certificate from every block: what it stores and what it loses. Here there is none to be "
            "had, for the reason given, so nothing was tested.",
        )
        why = f"this graph makes no claim that could be tested: {marked(verdict.reason)}."
    elif failing:
        means = (
            f"The identity for $\\dot V$ is exact. {_decided(verdict)}",
            f"But a theorem needs its conditions too, and {somewhere(verdict)} these fail: "
            f"{'; '.join(map(marked, failing))}. The margins in the table say by how much.",
        )
        count = f"{len(failing)} of its {len(verdict.conditions)} conditions"
        fails = "fails" if len(failing) == 1 else "fail"
        why = (
            f"the formula for $\\dot V$ is right, but {count} {fails} {somewhere(verdict)}, the first being "
            f"{marked(failing[0])}."
        )
    else:
        means = ("The test was not able to tell right from wrong here, so its answer does not count.",)
        why = f"{marked(verdict.reason)}."
    not_means = (
        "That the loop is unstable, or that the blocks are wrong.",
        "That the loop is stable.",
    )
    del clock
    return Meaning("Not proved, and not refuted", why, means, not_means)
