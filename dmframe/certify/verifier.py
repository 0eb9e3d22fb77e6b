"""``verify``: prove a diagram's claim, refute it, or give the reason why it has none."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from hashlib import sha256
from typing import Any, Final, final

from dmframe.block.certificate import Assumption
from dmframe.certify.assemble import assembled
from dmframe.certify.barriers import barrier_statements, tubes
from dmframe.certify.checked import Checked, Numbers, sorted_out
from dmframe.certify.claim import Claim, NotApplicableError, claim_of, unsteady
from dmframe.certify.closure import Closure
from dmframe.certify.conditions import conditions_of, decide, remedies
from dmframe.certify.contradicted import contradicted
from dmframe.certify.discrete import discrete_assumptions, discrete_conditions, discrete_statements
from dmframe.certify.explained import Compared, compared, explained
from dmframe.certify.hypotheses import hypotheses, undefined
from dmframe.certify.over import failing_of, over_intervals
from dmframe.certify.positive import Signs
from dmframe.certify.reach import reach_conditions
from dmframe.certify.residual import Bound, bounds_of
from dmframe.certify.small_gain import small_gain
from dmframe.certify.smoothness import Examiner
from dmframe.certify.statements import Statement, States, bases_of, statements_of, states_of, vanishing_of
from dmframe.certify.states import sampled_states
from dmframe.certify.symbols import Symbols, symbols_of
from dmframe.certify.verdict import Outcome, Verdict
from dmframe.common.copies import shared
from dmframe.common.errors import ValueFault
from dmframe.common.text import DV, UNNAMED, Text, Written, joined, sentence
from dmframe.diagram import Diagram
from dmframe.exact import ZeroDivision, ZeroTest
from dmframe.exact.rational import Interval
from dmframe.prove import claim as data
from dmframe.prove.export import digest
from dmframe.prove.faults import InjectedFault, inject_faults
from dmframe.prove.identity import Points, combined, empty
from dmframe.prove.reals import why_not_refuted
from dmframe.prove.refute import Refutation, refute
from dmframe.prove.sound import require_sound

LONG: Final = 2000
"""Operations of a diagram from which on a proof takes longer than a copy of the process."""


def verify(
    diagram: Diagram,
    *,
    trials: int = 3,
    seed: int = 0,
    uncertain: Mapping[str, Sequence[Interval]] | None = None,
    start: Mapping[str, Any] | None = None,
    copies: bool = False,
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
    copies
        Copies of this process do a part of the work of a large diagram, if there are other cores.
    """
    clock, alone = _Clock(), not copies or _size(diagram) < LONG
    tried: list[Callable[[], str | None]] = [partial(unsteady, diagram), partial(_tried_units, diagram)]
    with shared(tried, busy=True, small=alone) as finished:
        try:
            found = _verified(diagram, trials, seed, uncertain or {}, start or {}, clock, alone)
        except NotApplicableError as error:
            found = Verdict("not_applicable", Text(error.text), build=clock.build, check=clock.check)
        number, units = finished()
    if number:
        return Verdict("not_applicable", Text(number), build=clock.build, check=clock.check)
    if found.outcome == "proved" and (units := _unit_faults(diagram) if units is None else units):
        return replace(found, outcome="not_applicable", reason=Text(f"the units do not agree: {units}"))
    return found


def _size(diagram: Diagram) -> int:
    """Operations of all blocks' equations."""
    return sum(model.size for model in diagram.models.values())


def _tried_units(diagram: Diagram) -> str | None:
    """`_unit_faults`; None if equations are ill-formed, of which no claim is proved."""
    try:
        return _unit_faults(diagram)
    except Exception:  # of CasADi or of a block
        return None


def _unit_faults(diagram: Diagram) -> str:
    return "; ".join(fault.text for fault in diagram.unit_faults)


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
    alone: bool,
) -> Verdict:
    claim = claim_of(diagram, held=False)
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

    def refuted(test: ZeroTest) -> Verdict:
        test = replace(test, seed=own)
        of = "what a sample does" if claim.over_samples else DV
        if reason := why_not_refuted(exact, seed, of):
            return ends("not_applicable", reason, test=test)
        refutation = refute(exact, seed=seed)
        blame = _blame(claim, refutation, [] if claim.over_samples else remedies(claim, numbers))
        return ends("refuted", blame, test=test, refutation=refutation)

    rows = [(part, item) for part in claim.parts for item in part.certificate.steps] if examiner is None else []
    try:
        require_sound(exact)
        points = Points.of(exact, seed=seed)
        exact.shared.prepare()  # once, before copies of this process need it
        jobs: list[Callable[[], Any]] = [partial(compared, claim, *row, seed) for row in rows]
        jobs += [partial(inject_faults, exact, seed=seed), partial(empty, exact, seed)]
        jobs += [partial(points.at, k) for k in range(1, trials)]
        with shared(jobs, busy=True, small=alone) as finished:
            first = points.at(0)
            if not first.zero:
                return refuted(first)
            done = cache(finished)
            if examiner is None:
                found = _in_discrete_time(claim, exact, symbols, numbers, start, seed, lambda: done()[: len(rows)])
            else:
                found = _in_continuous_time(claim, symbols, numbers, start, seed, examiner)
            controls, nothing, *others = done()[len(rows) :]
    except ValueFault as error:
        return undefined(error)
    except ZeroDivision:
        return undefined(ValueFault("a denominator is zero everywhere; expected rates that are defined, of each state"))
    test = replace(combined([first, *others]), seed=own)
    if not test.zero:
        return refuted(test)
    if found.fault:
        return ends("not_applicable", found.fault, test=test)
    conditions = found.conditions if found.undefined else tuple(over_intervals(list(found.conditions), claim, numbers))
    outcome, reason = _judge(claim, conditions, controls, () if found.undefined else nothing, found.bounds)
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
        uncertain=numbers.stated,
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
    claim: Claim, symbols: Symbols, numbers: Numbers, start: Mapping[str, Any], seed: int, examiner: Examiner
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


def _in_discrete_time(
    claim: Claim,
    exact: data.Claim,
    symbols: Symbols,
    numbers: Numbers,
    start: Mapping[str, Any],
    seed: int,
    rows: Callable[[], Sequence[Compared | Assumption]],
) -> _Found:
    stated = list(discrete_conditions(claim, numbers, start))
    assumed = tuple(discrete_assumptions(claim, exact, symbols, seed))
    statements, states = tuple(discrete_statements(claim)), sampled_states(claim, numbers, seed)
    reached = tuple(reach_conditions(claim))
    conditions, assumptions = sorted_out([*stated, *(explained(claim, item) for item in rows())])
    return _Found((*conditions, *reached), (*assumptions, *assumed), statements, states)


def drawn(claim: data.Claim, fingerprint: str, seed: int) -> int:
    """The seed of this claim's points and primes, derived from the claim: no claim can be written for known primes."""
    found = sha256(f"{seed}:{fingerprint}:{digest(claim)}".encode()).digest()
    return int.from_bytes(found[:8], "big")


def _blame(claim: Claim, refutation: Refutation, lacking: Sequence[Text]) -> Text:
    says, where = refutation.statement, ", ".join(refutation.blame)
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
    controls: Sequence[InjectedFault],
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
