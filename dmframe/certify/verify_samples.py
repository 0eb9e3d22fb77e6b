"""``verify`` of a graph that runs on a clock alone: what its blocks claim from one sample to the next."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from typing import Any, Final, Literal, final

import casadi as ca

from dmframe.block.model import symbols_in
from dmframe.certificate import SX, Assumption, LeastSquaresSteps, NormalisedSteps, Steps
from dmframe.certify.checked import Checked, Numbers, decided
from dmframe.certify.conditions import conditions_stated, decide
from dmframe.certify.controls import Control
from dmframe.certify.delays import decided_delays, delay_conditions
from dmframe.certify.hypotheses import of_the_plant, undefined
from dmframe.certify.identity import BITS, at_random_point
from dmframe.certify.memories import triangle_starts
from dmframe.certify.over import failing_of, over_intervals
from dmframe.certify.projections import outside
from dmframe.certify.reach import reach_conditions
from dmframe.certify.reals import doubt
from dmframe.certify.refute import Refutation, refute
from dmframe.certify.sample_controls import sampled_controls
from dmframe.certify.sample_domains import domains
from dmframe.certify.sample_forms import stepping
from dmframe.certify.sample_states import sampled_states
from dmframe.certify.samples import SampledClaim, SampledPart, sampled_claim_of
from dmframe.certify.statements import Statement, States
from dmframe.certify.symbols import Group, Symbols, symbols_of
from dmframe.diagram import Diagram
from dmframe.diagram.closed_loop import stack
from dmframe.errors import listed
from dmframe.exact import Tape, ZeroTest, zero_test
from dmframe.exact.rational import Interval

SIGNS = "V is positive, what it loses and gains not negative"
LEMMAS: Final[Mapping[type, str]] = {
    NormalisedSteps: "a box is convex, and V weighs each element by itself",
    LeastSquaresSteps: (
        "a box is convex: the nearest point of a face in the norm that V weighs with, or a cut where that is diagonal, "
        "is no farther from what it holds; and G, a sum of h h'/floor of which a share is forgotten, is not negative"
    ),
}
EACH: Final[Mapping[type, str]] = {
    NormalisedSteps: (
        "each normalised step on a row h, y moves |theta - theta_true|^2, weighed with 1/Gamma, by minus the squares "
        "of what the row sees of the error and of what it misses, plus eta^2, each over its norm"
    ),
    LeastSquaresSteps: (
        "each step of least squares on a row h, y moves |theta - theta_true|^2, weighed with 1/Gamma + G, by minus the "
        "square of what the row misses over its norm, plus eta^2 over the floor; what is forgotten takes away more"
    ),
}


@final
@dataclass(frozen=True)
class SampledProof:
    """What was found: the parts of a `Verdict` that differ over samples."""

    claim: SampledClaim
    test: ZeroTest
    reason: str
    outcome: Literal["proved", "refuted", "not_applicable"]
    refutation: Refutation | None = None
    conditions: tuple[Checked, ...] = ()
    assumptions: tuple[Assumption, ...] = ()
    controls: tuple[Control, ...] = ()
    statements: tuple[Statement, ...] = ()
    fixed: tuple[str, ...] = ()
    states: States | None = None


def prove_over_samples(
    diagram: Diagram,
    *,
    trials: int,
    seed: int,
    uncertain: Mapping[str, Sequence[Interval]],
    start: Mapping[str, Any],
) -> SampledProof:
    """Prove V(next) - V, exactly, for all values of states, measurements, commands, gains and the sampling period.
    `start` is the graph's key of that name.

    Raises `NotApplicableError` where no block claims anything over samples, and `ValueFault` where a claim is nowhere
    defined.
    """
    claim = sampled_claim_of(diagram)
    symbols = sampled_symbols(claim, uncertain)
    claimed = claim.equalities()
    function = symbols.function("claim", [equality.expression for equality in claimed])
    digest = sha256(f"{seed}:{diagram.fingerprint}:{function.serialize()}".encode()).digest()
    own = int.from_bytes(digest[:8], "big")
    test = replace(zero_test(function, values=symbols.fixed, trials=trials, seed=own, bits=BITS), seed=seed)
    if not test.zero and (reason := doubt(claimed, symbols, own, "what a sample does")):
        return SampledProof(claim, test, reason, "not_applicable")
    if not test.zero:
        found = refute(claimed, symbols, seed=own)
        return SampledProof(claim, test, f"{found.says} is not what the block claims", "refuted", found)
    controls = sampled_controls(claim, symbols, seed=own)
    numbers = Numbers(claim.base, uncertain)
    conditions, assumptions = _conditions(claim, numbers, start)
    conditions = over_intervals(conditions, claim.base, numbers)
    outcome, reason = _judged(claim, conditions, controls, _empty(claim, symbols, own))
    return SampledProof(
        claim,
        test,
        reason,
        outcome,
        conditions=tuple(conditions),
        assumptions=tuple(dict.fromkeys([*assumptions, *domains(claim, symbols, own), *_hypotheses(claim, symbols)])),
        controls=controls,
        statements=tuple(_statements(claim)),
        states=sampled_states(claim, numbers, own),
        fixed=tuple(g.label for g in symbols.groups if g.values is not None and not any(g.values)),
    )


def sampled_symbols(claim: SampledClaim, uncertain: Mapping[str, Any]) -> Symbols:
    """All symbols of the diagram, and the constants that nobody knows."""
    constants = [
        Group(f"{part.block}.{name}", "constant", symbol)
        for part in claim.parts
        for name, symbol in part.constants.items()
    ]
    return Symbols((*symbols_of(claim.base, uncertain).groups, *constants))


def _empty(claim: SampledClaim, symbols: Symbols, seed: int) -> list[str]:
    """What is identically zero, of which then nothing would be said."""
    named = list[tuple[str, SX]]()
    for part in claim.parts:
        if part.stored:
            named.append((f"{part.block}: V(next) - V", claim.change(part)))
        for role, terms in (("V", part.storage), ("what V loses", part.decrease)):
            named += [(f"{part.block}: term {place} of {role}", t.value) for place, t in enumerate(terms, start=1)]
        named += [(f"{part.block}: the rows of {s.estimate}", stack(h for h, _ in s.rows)) for s in part.steps]
        named += [(f"{part.block}: when {item.state} is stored", ca.SX(item.when)) for item in part.kept]
        named += [(f"{part.block}: the rest of a relation", ca.SX(item.rest)) for item in part.relations]
    tape = Tape.from_function(symbols.function("terms", [expression for _, expression in named]))
    outputs = at_random_point(tape, symbols, seed)
    return [name for (name, _), values in zip(named, outputs, strict=True) if not any(values)]


def _judged(
    claim: SampledClaim, conditions: Sequence[Checked], controls: Sequence[Control], empty: Sequence[str]
) -> tuple[Literal["proved", "not_applicable"], str]:
    if empty:
        return "not_applicable", f"identically zero, so that nothing would be proved: {'; '.join(empty)}"
    missed = [control.fault for control in controls if not control.refuted]
    if not controls or missed:
        told = ", ".join(missed) or "there are none"
        return "not_applicable", f"the negative controls were not refuted: {told}"
    if failing := failing_of(conditions):
        return "not_applicable", failing
    plus = " plus the residual" if claim.left else ""
    return (
        "proved",
        f"V(next) - V equals minus what is lost{plus}, for all measurements, commands, gains and sampling "
        "periods; every condition holds",
    )


def _conditions(
    claim: SampledClaim, numbers: Numbers, start: Mapping[str, Any]
) -> tuple[list[Checked], list[Assumption]]:
    claiming = {part.block for part in claim.parts}
    stated = [(name, item) for name, item in conditions_stated(claim.base) if name in claiming]
    checked, assumed = decide(stated, numbers)
    checked += dict.fromkeys(undefined(claim.base, numbers))
    checked += reach_conditions(claim.base)
    for part in claim.parts:
        checked += _weights(part, numbers)
        checked += delay_conditions(claim, part)
        for item in part.steps:
            checked += _steps(part, item, numbers)
            if isinstance(item, LeastSquaresSteps):
                checked += _least_squares(part, item, numbers, start)
            inside, unknown = _boxed(part, item, numbers)
            checked, assumed = [*checked, *inside], [*assumed, *unknown]
    return checked, assumed


def _weights(part: SampledPart, numbers: Numbers) -> Iterator[Checked]:
    for role, terms in (("V", part.storage), ("what V loses", part.decrease), ("the residual", part.residual)):
        for place, term in enumerate(terms, start=1):
            name, strict = f"{part.block}: weight of term {place} of {role}", role == "V"
            least, sign = _least(term.weight, numbers), ">" if strict else ">="
            yield decided(name, f"weight {sign} 0", SIGNS, least, strict, ca.SX(term.weight))


def _steps(part: SampledPart, item: Steps, numbers: Numbers) -> Iterator[Checked]:
    for role, value in (("gain", item.gain), ("floor", item.floor)):
        name, value = f"{part.block}: {role} of the steps of {item.estimate}", ca.vec(ca.densify(ca.SX(value)))
        yield decided(name, f"{role} > 0", SIGNS, _least(value, numbers), True, value)


def _least_squares(
    part: SampledPart, item: LeastSquaresSteps, numbers: Numbers, start: Mapping[str, Any]
) -> Iterator[Checked]:
    name, share = f"{part.block}: retention of the steps of {item.estimate}", ca.SX(item.retention)
    room = ca.vertcat(share, 1 - share)
    yield decided(name, "0 <= retention <= 1", LEMMAS[LeastSquaresSteps], _least(room, numbers), False, room)
    yield from triangle_starts(part.block, item, numbers, start)


def _least(expression: SX, numbers: Numbers) -> Any:
    return lambda: numbers.least(ca.SX(expression))


def _boxed(part: SampledPart, item: Steps, numbers: Numbers) -> tuple[list[Checked], list[Assumption]]:
    """That the true value lies in the box, decided where parameters tell it, else assumed."""
    if not item.box:
        return [], []
    lower, upper, true = (ca.vec(ca.densify(ca.SX(end))) for end in (*item.box, item.true))
    lemma = LEMMAS[type(item)]
    room = ca.vertcat(true - lower, upper - true)
    known = [row for row in range(room.shape[0]) if symbols_in([room[row]]) <= numbers.known]
    text, checked = f"{part.block}: true value of {item.estimate} inside its box", list[Checked]()
    if known:
        checked.append(
            decided(text, "lower <= true value <= upper", lemma, _least(room[known], numbers), False, room[known])
        )
    loop, free = numbers.claim.loop, [row for row in range(room.shape[0]) if row not in known]
    handed = [row for row in free if symbols_in([loop.on_path(room[row])]) <= symbols_in([loop.time, loop.p])]
    if handed:  # what a source has decides, as far as it is sampled
        checked += outside(text, loop.on_path(room[handed]), loop)
    left = sorted({row % true.shape[0] for row in free})
    if left:
        width, name = (upper - lower)[left], f"{part.block}: box of {item.estimate} holds something"
        checked.append(decided(name, "lower <= upper", lemma, _least(width, numbers), False, width))
    whose = (
        "which a source or constants that nobody knows decide" if handed else "which are constants that nobody knows"
    )
    said = f"{text}, in {len(left)} of {true.shape[0]} elements, {whose}"
    return checked, [Assumption(said, lemma)] if left else []


def _hypotheses(claim: SampledClaim, symbols: Symbols) -> Iterator[Assumption]:
    """What cannot be decided from the graph."""
    yield from of_the_plant(claim.base.diagram)
    held = "samples are one period apart, and what is commanded is held from each to the next"
    yield Assumption(held, "the means over a sample")
    for part in claim.parts:
        for item in part.steps:
            eta = f"{part.block}: eta, what the rows of {item.estimate} leave unexplained of the means over a sample"
            yield Assumption(
                f"{eta}, is small: it is not bounded here, and can be looked at along a run", EACH[type(item)]
            )
        if part.relations and not decided_delays(claim, part):
            text = (
                f"{part.block}: the command that a row holds is what acted in its sample: a delay is as told, or echoed"
            )
            yield Assumption(text, "the means over a sample")
        if part.steps and part.relations:
            text = "its rows are means over a sample of the relations that it states, and its true values theirs"
            yield Assumption(f"{part.block}: {text}", "the means over a sample")
        if part.steps and not part.relations:
            text = f"{part.block}: the plant's motion obeys what its rows say; the block states no relation that does"
            yield Assumption(text, "the means over a sample")
        if part.residual:
            within = symbols_in(map(ca.SX, (piece for term in part.residual for piece in term.pieces)))
            made = [g.label for g in symbols.groups if within & symbols_in([g.symbol]) and g.kind != "parameter"]
            of = listed(made) or "parameters"
            text = f"{part.block}: what V gains beside, made of {of}, is small: nothing bounds it"
            yield Assumption(text, "the identity above")
    for leaf in stepping(claim.base):
        if any(
            symbols_in(map(ca.SX, term.pieces)) & symbols_in([leaf.symbol]) for p in claim.parts for term in p.stored
        ):
            text = f"{leaf.name} is constant: all is said of the time between its steps, each of which begins a new V"
            yield Assumption(text, "V holds it")
    if claim.silent:
        yield Assumption(
            f"of {', '.join(claim.silent)} this proof says nothing: it holds whatever is commanded",
            "the claim's own symbols",
        )
    yield Assumption(
        "joint velocities, and with them the rows, stay bounded; that the robot follows its path is not a part of this "
        "proof",
        "what a proof of tracking would need",
    )


def _statements(claim: SampledClaim) -> Iterator[Statement]:
    for part in claim.parts:
        for item in part.steps:
            name = f"{item.estimate} ({part.block})"
            if item.box:
                yield Statement(name, "is bounded", "it is put back into its box at each sample")
            yield Statement(f"V of {name}", "does not rise where eta is zero", EACH[type(item)])
            many = f", over {len(item.rows)} steps a sample" if len(item.rows) > 1 else ""
            yield Statement(
                f"what the rows see of the error of {name}",
                f"is square-summable where eta is{many}",
                f"summed over the samples, with V >= 0: {EACH[type(item)]}",
            )
        if part.storage:
            says = "does not rise but by its residual" if part.residual else "does not rise"
            yield Statement(f"V of {part.block}", says, "the identity above")


__all__ = ["SampledProof", "prove_over_samples", "sampled_symbols"]
