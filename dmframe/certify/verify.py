"""``verify``: prove a diagram's claim, refute it, or say why there is none."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from hashlib import sha256
from typing import Any, Final, Literal, final

from dmframe.certificate import Assumption
from dmframe.certify.assemble import assembled
from dmframe.certify.barriers import barrier_statements, tubes
from dmframe.certify.checked import Checked, Numbers, sorted_out
from dmframe.certify.claim import Claim, NotApplicableError, claim_of
from dmframe.certify.closure import Closure
from dmframe.certify.conditions import conditions_of, decide, remedies
from dmframe.certify.contradicted import contradicted
from dmframe.certify.discrete import discrete_assumptions, discrete_conditions, discrete_statements
from dmframe.certify.excess import Bound, bounds_of, total_bound
from dmframe.certify.explained import UNCHECKED, explained
from dmframe.certify.hypotheses import hypotheses, undefined
from dmframe.certify.over import failing_of, over_intervals
from dmframe.certify.positive import Signs
from dmframe.certify.reach import reach_conditions
from dmframe.certify.small_gain import Kappa, small_gain
from dmframe.certify.smoothness import Examiner
from dmframe.certify.statements import Statement, States, bases_of, statements_of, states_of, vanishing_of
from dmframe.certify.states import held_in_v, sampled_states
from dmframe.certify.symbols import Symbols, symbols_of
from dmframe.diagram import Diagram
from dmframe.errors import ValueFault, listed
from dmframe.exact import ZeroTest
from dmframe.exact.rational import Interval, as_float
from dmframe.prove import claim as data
from dmframe.prove.export import digest
from dmframe.prove.faults import Control, inject_faults
from dmframe.prove.identity import empty, identity
from dmframe.prove.reals import doubt
from dmframe.prove.refute import Refutation, refute
from dmframe.prove.sound import hold_sound
from dmframe.text import DV, UNNAMED, Text, Written, joined, sentence

Outcome = Literal["proved", "refuted", "not_applicable"]

NAMED: Final = 3
"""States up to which a headline names them; of more it gives the number, and the text below the names."""


@final
@dataclass(frozen=True, repr=False)
class Verdict:
    """The outcome of `verify`, with everything it rests on.

    Parameters
    ----------
    outcome
        ``proved``: the identity holds for all values of its symbols, every condition holds at the graph's numbers, and
        every seeded fault was refuted; where there are `bounds`, it is proved up to a bounded residual.
        ``refuted``: the identity is false. ``not_applicable``: there is nothing to prove, or a condition fails;
        `reason` says which.
    test
        The exact test, with its error bound.
    states
        Which states are bounded, and which are not known to be; over samples too.
    fixed
        Parameters that are zero in the graph, and that the proof takes for zero, by label.
    uncertain
        Parameters over whose intervals the conditions hold, by label.
    bounds
        What dV/dt may have above the dissipation, term by term; none for a claim without a bounded residual.
    build, check
        Seconds spent on writing V and dV/dt, and on deciding.
    exact
        The claim as data, of which `test`, `controls` and `refutation` speak; `dmframe.prove.export.to_json` writes it.
    """

    outcome: Outcome
    reason: Text
    claim: Claim | None = None
    test: ZeroTest | None = None
    refutation: Refutation | None = None
    kappa: Kappa | None = None
    conditions: tuple[Checked, ...] = ()
    assumptions: tuple[Assumption, ...] = ()
    controls: tuple[Control, ...] = ()
    statements: tuple[Statement, ...] = ()
    states: States | None = None
    fixed: tuple[str, ...] = ()
    uncertain: tuple[str, ...] = ()
    bounds: tuple[Bound, ...] = ()
    build: float = 0.0
    check: float = 0.0
    exact: data.Claim | None = None

    @property
    def flow_claim(self) -> Claim | None:
        """The claim, where it is in continuous time."""
        return self.claim if self.claim is not None and not self.claim.over_samples else None

    @property
    def samples(self) -> Claim | None:
        """The claim, where it is over samples."""
        return self.claim if self.claim is not None and self.claim.over_samples else None

    @property
    def rows_assumed(self) -> bool:
        """True where an estimator's rows could not be compared with motions of the plant."""
        return any(UNCHECKED in item.text for item in self.assumptions)

    @property
    def headline(self) -> str:
        """The outcome in words, with what a proof does not reach."""
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
        """The most that dV/dt can be above minus the dissipation; None where a signal scales it, and over samples."""
        if self.samples is not None:
            return None
        return total_bound(list(self.bounds), as_float(self.kappa.chosen) if self.kappa else 1.0)

    def __repr__(self) -> str:
        return f"<Verdict: {self.headline}>"


def verify(
    diagram: Diagram,
    *,
    trials: int = 3,
    seed: int = 0,
    uncertain: Mapping[str, Sequence[Interval]] | None = None,
    start: Mapping[str, Any] | None = None,
) -> Verdict:
    """Prove dV/dt for a diagram, exactly, for all values of its gains and physical parameters.

    Parameters
    ----------
    trials
        Random points of random prime fields; each divides the error probability.
    seed
        Of the points and primes.
    uncertain
        Parameters known only up to intervals, for the conditions: ``{"servo.K_D": [...]}``, one a joint; and starts,
        ``{"start.arm.q": [...]}``. A condition that is not decided over all of them does not hold.
    start
        A graph's own start values, by a state's name or ``block.state``.
    """
    clock = _Clock()
    try:
        found = _verified(diagram, trials, seed, uncertain or {}, start or {}, clock)
    except NotApplicableError as error:
        return Verdict("not_applicable", Text(error.text), build=clock.build, check=clock.check)
    if found.outcome == "proved" and diagram.unit_faults:
        texts = "; ".join(fault.text for fault in diagram.unit_faults)
        return replace(found, outcome="not_applicable", reason=Text(f"the units do not agree: {texts}"))
    return found


@final
class _Clock:
    """Seconds since it was made, until V is built, and from then on."""

    def __init__(self) -> None:
        self._begin, self._built = time.perf_counter(), 0.0

    def built(self) -> None:
        """V and dV/dt are written."""
        self._built = time.perf_counter()

    @property
    def build(self) -> float:
        """Seconds spent on writing V and dV/dt."""
        return (self._built or time.perf_counter()) - self._begin

    @property
    def check(self) -> float:
        """Seconds spent on deciding."""
        return time.perf_counter() - self._built if self._built else 0.0


def _verified(
    diagram: Diagram,
    trials: int,
    seed: int,
    uncertain: Mapping[str, Sequence[Interval]],
    start: Mapping[str, Any],
    clock: _Clock,
) -> Verdict:
    claim = claim_of(diagram)
    exact = assembled(claim, tuple(uncertain))  # which has differentiated all that has to vanish
    symbols = symbols_of(claim, uncertain)
    own = seed
    try:
        seed = drawn(exact, diagram.fingerprint, own)
    except ValueFault as error:  # a number that is not finite
        raise NotApplicableError(f"what is claimed cannot be written as data: {error.text}") from None
    examiner = None if claim.over_samples else Examiner(diagram, claim)
    smooth = None if examiner is None else examiner.found()
    clock.built()

    def ends(outcome: Outcome, reason: Text, **found: Any) -> Verdict:
        return Verdict(outcome, reason, claim, build=clock.build, check=clock.check, exact=exact, **found)

    if smooth is not None and smooth.faults:
        return ends("not_applicable", joined(smooth.faults, "; "))
    numbers = Numbers(claim, uncertain)

    def undefined(error: ValueFault) -> Verdict:
        """A denominator vanishes, which a condition may exclude."""
        lacking = [] if claim.over_samples else remedies(claim, numbers)
        return ends("not_applicable", joined([*lacking, Text(error.text)], "; "))

    try:
        hold_sound(exact)
        test = replace(identity(exact, trials=trials, seed=seed), seed=own)
    except ValueFault as error:
        return undefined(error)
    of = "what a sample does" if claim.over_samples else DV
    if not test.zero and (reason := doubt(exact, seed, of)):
        return ends("not_applicable", reason, test=test)
    if not test.zero:
        refutation = refute(exact, seed=seed)
        blame = _blame(claim, refutation, [] if claim.over_samples else remedies(claim, numbers))
        return ends("refuted", blame, test=test, refutation=refutation)
    try:
        controls = inject_faults(exact, seed=seed)
    except ValueFault as error:
        return ends("not_applicable", Text(error.text), test=test)
    find = _in_discrete_time if examiner is None else partial(_in_continuous_time, examiner=examiner)
    try:
        found = find(claim, symbols, numbers, start, seed)
    except ValueFault as error:
        return undefined(error)
    if found.fault:
        return ends("not_applicable", found.fault, test=test)
    conditions = found.conditions if found.undefined else tuple(over_intervals(list(found.conditions), claim, numbers))
    nothing = () if found.undefined else empty(exact, seed)
    outcome, reason = _judge(claim, conditions, controls, nothing, found.bounds)
    if found.undefined:
        return ends(outcome, reason, test=test, conditions=conditions)
    return ends(
        outcome,
        reason,
        test=test,
        kappa=small_gain(claim, numbers) if claim.cascaded else None,
        conditions=conditions,
        assumptions=tuple(dict.fromkeys(found.assumptions)),
        controls=controls,
        statements=found.statements,
        states=found.states,
        fixed=tuple(g.label for g in symbols.groups if g.values is not None and not any(g.values)),
        bounds=found.bounds,
        uncertain=tuple(uncertain),
    )


@final
@dataclass(frozen=True)
class _Found:
    """What is decided and concluded once the identity holds.

    `fault`: why nothing can be; `undefined`: the conditions hold a divisor that is zero, and nothing further is found.
    """

    conditions: tuple[Checked, ...] = ()
    assumptions: tuple[Assumption, ...] = ()
    statements: tuple[Statement, ...] = ()
    states: States | None = None
    bounds: tuple[Bound, ...] = ()
    undefined: bool = False
    fault: Text = UNNAMED


def _in_continuous_time(
    claim: Claim, symbols: Symbols, numbers: Numbers, start: Mapping[str, Any], seed: int, *, examiner: Examiner
) -> _Found:
    signs = Signs(claim, numbers)
    conditions, assumptions = conditions_of(claim, numbers, start)
    bounds = tuple(bounds_of(claim, numbers, symbols))
    if missing := list(dict.fromkeys(undefined(claim, numbers))):
        return _Found((*conditions, *missing), bounds=bounds, undefined=True)
    kept = list(tubes(claim, numbers, symbols, start))
    bases = bases_of(claim, symbols, signs)
    bases = replace(bases, vectors=(*bases.vectors, *(tube.position for tube in kept)))
    closure = Closure(claim, numbers, bases, seed=seed)
    needed, given = sorted_out(decide(closure.conditions(), numbers))
    # over intervals more may be required than at any number in them
    conditions += [replace(item, sufficient=bool(numbers.open)) for item in needed]
    smooth = examiner.found()  # with residuals, true values, barriers and linear subsystems, all differentiated by now
    if smooth.faults:
        return _Found(fault=joined(smooth.faults, "; "))
    statements = [*statements_of(claim, symbols, signs, closure), *barrier_statements(kept)]
    smooth = examiner.found()
    if smooth.faults:  # of a trajectory that the statements have differentiated once more
        statements = [item for item in statements if not item.concludes and item.says != "goes to zero"]
    conditions += reach_conditions(claim)
    conditions += contradicted(claim, numbers, vanishing_of(claim, closure, signs), start)
    assumed = (*assumptions, *given, *smooth.assumptions, *hypotheses(claim, closure))
    return _Found(tuple(conditions), assumed, tuple(statements), states_of(claim, closure), bounds)


def _in_discrete_time(claim: Claim, symbols: Symbols, numbers: Numbers, start: Mapping[str, Any], seed: int) -> _Found:
    rows = [explained(claim, part, item, seed) for part in claim.parts for item in part.certificate.steps]
    conditions, assumptions = sorted_out([*discrete_conditions(claim, numbers, start), *rows])
    return _Found(
        (*conditions, *reach_conditions(claim)),
        (*assumptions, *discrete_assumptions(claim, symbols, seed)),
        tuple(discrete_statements(claim)),
        sampled_states(claim, numbers, seed),
    )


def _over(claim: Claim, states: States | None) -> str:
    """Of which states something is proved over samples, up to what, and of which nothing is."""
    held, left = held_in_v(claim), [] if states is None else list(states.open)
    words = _counted(held, "states") + f", up to {claim.left}" * bool(claim.left)
    if left:
        many = "states" if set(held) & set(left) else "other states"
        words += f"; {_counted(left, many)} {'is' if len(left) == 1 else 'are'} not known to be bounded, and"
    return f"{words} tracking is not part of it" if left else f"{words}; tracking is not part of it"


def _counted(labels: Sequence[str], many: str) -> str:
    """Their names, or how many they are."""
    return listed(list(labels)) if len(labels) <= NAMED else f"{len(labels)} {many}"


def drawn(claim: data.Claim, fingerprint: str, seed: int) -> int:
    """The seed of this claim's points and primes, derived from the claim: no claim can be written for known primes."""
    found = sha256(f"{seed}:{fingerprint}:{digest(claim)}".encode()).digest()
    return int.from_bytes(found[:8], "big")


def _blame(claim: Claim, refutation: Refutation, lacking: Sequence[Text]) -> Text:
    says, where = refutation.says, ", ".join(refutation.blame)
    if lacking:
        return Text(DV if says == DV.text else says, " is not what the blocks claim; ", joined(lacking, "; "))
    if claim.over_samples:
        return Text(f"{says} is not what the block claims")
    if says != DV.text:
        text = " is not what the block claims, though {dV/dt} of the diagram is; to blame: "
        return Text(says, sentence(text), where)
    if where:
        return sentence("{dV/dt} is not what the blocks claim; to blame: {where}", where=where)
    supplies = {name: law.supply for name, law in claim.laws.items() if law.supply is not None}
    exchanged = [Text(f"{name} ", supply) for name, supply in supplies.items() if supply.text != "0"]
    return sentence(
        "{dV/dt} is not what the blocks claim; to blame: no single block: each keeps its own claim, but what they "
        "exchange does not cancel: {exchanged}",
        exchanged=joined(exchanged, "; "),
    )


def _judge(
    claim: Claim,
    conditions: Sequence[Checked],
    controls: Sequence[Control],
    empty: Sequence[str],
    bounds: Sequence[Bound],
) -> tuple[Outcome, Text]:
    if empty:
        return "not_applicable", Text("identically zero, so that nothing would be proved: ", joined(empty, "; "))
    missed = [control.fault for control in controls if not control.refuted]
    if not controls or missed:
        return "not_applicable", Text("seeded faults were not refuted: ", joined(missed) or "there are none")
    if failing := failing_of(conditions):
        return "not_applicable", failing
    if claim.over_samples:
        plus = " plus the residual" if claim.left else ""
        return "proved", sentence(
            "{difference} equals minus what is lost{plus}, for all measurements, commands, gains and sampling periods; "
            "every condition holds",
            difference=Written("V(next) - V", "V(next) − V", r"V(\text{next}) - V"),
            plus=plus,
        )
    unbounded = [Text(f"{bound.block}: ", bound.of) for bound in bounds if not bound.known]
    if unbounded:
        text = Text("the identity holds, but nothing bounds the residual: ", joined(unbounded, "; "))
        return "not_applicable", text
    says = "{dV/dt} equals minus the dissipation{residual}, for all values of the symbols; every condition holds"
    return "proved", sentence(says, residual=" plus a residual" if bounds else "")
