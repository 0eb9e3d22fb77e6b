"""Conditions, assumptions and statements of a claim over samples: what is left once its identity holds."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Final

import casadi as ca

from dmframe.block.model import symbols_in
from dmframe.certificate import SX, Assumption, LeastSquaresSteps, NormalisedSteps, Square, Steps
from dmframe.certify.checked import Checked, Numbers, decided
from dmframe.certify.claim import Claim, Part
from dmframe.certify.conditions import conditions_stated, decide
from dmframe.certify.delays import decided_delays, delay_conditions
from dmframe.certify.form import stepping
from dmframe.certify.hypotheses import BETWEEN, of_the_plant, undefined
from dmframe.certify.memories import triangle_starts
from dmframe.certify.points import at_random_point
from dmframe.certify.projections import outside
from dmframe.certify.risky import risky
from dmframe.certify.statements import Statement
from dmframe.certify.symbols import Symbols
from dmframe.diagram.closed_loop import stack
from dmframe.errors import listed
from dmframe.exact import Tape

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


SHOWN: Final = 6
"""Signals of which so many are named."""


def discrete_conditions(
    claim: Claim, numbers: Numbers, start: Mapping[str, Any]
) -> tuple[list[Checked], list[Assumption]]:
    """What the proof needs and numbers can decide; and what is left to assume."""
    claiming = {part.block for part in claim.parts}
    stated = [(name, item) for name, item in conditions_stated(claim) if name in claiming]
    checked, assumed = decide(stated, numbers)
    checked += dict.fromkeys(undefined(claim, numbers))
    for part in claim.parts:
        checked += _weights(part, numbers)
        checked += delay_conditions(claim, part)
        for item in part.certificate.steps:
            checked += _steps(part, item, numbers)
            if isinstance(item, LeastSquaresSteps):
                checked += _least_squares(part, item, numbers, start)
            inside, unknown = _boxed(part, item, numbers)
            checked, assumed = [*checked, *inside], [*assumed, *unknown]
    return checked, assumed


def _weights(part: Part, numbers: Numbers) -> Iterator[Checked]:
    for role, terms in (
        ("V", part.certificate.storage),
        ("what V loses", part.certificate.dissipation),
        ("the residual", part.certificate.excess),
    ):
        for place, term in enumerate((term for term in terms if isinstance(term, Square)), start=1):
            name, strict = f"{part.block}: weight of term {place} of {role}", role == "V"
            least, sign = _least(term.weight, numbers), ">" if strict else ">="
            yield decided(name, f"weight {sign} 0", SIGNS, least, strict, ca.SX(term.weight))


def _steps(part: Part, item: Steps, numbers: Numbers) -> Iterator[Checked]:
    for role, value in (("gain", item.gain), ("floor", item.floor)):
        name, value = f"{part.block}: {role} of the steps of {item.estimate}", ca.vec(ca.densify(ca.SX(value)))
        yield decided(name, f"{role} > 0", SIGNS, _least(value, numbers), True, value)


def _least_squares(
    part: Part, item: LeastSquaresSteps, numbers: Numbers, start: Mapping[str, Any]
) -> Iterator[Checked]:
    name, share = f"{part.block}: retention of the steps of {item.estimate}", ca.SX(item.retention)
    room = ca.vertcat(share, 1 - share)
    yield decided(name, "0 <= retention <= 1", LEMMAS[LeastSquaresSteps], _least(room, numbers), False, room)
    yield from triangle_starts(part.block, item, numbers, start)


def _least(expression: SX, numbers: Numbers) -> Any:
    return lambda: numbers.least(ca.SX(expression))


def _boxed(part: Part, item: Steps, numbers: Numbers) -> tuple[list[Checked], list[Assumption]]:
    """That the true value lies in the box: decided where parameters determine it, else assumed."""
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
    whose = "which a source or unknown constants decide" if handed else "which are unknown constants"
    said = f"{text}, in {len(left)} of {true.shape[0]} elements, {whose}"
    return checked, [Assumption(said, lemma)] if left else []


def discrete_assumptions(claim: Claim, symbols: Symbols, seed: int) -> Iterator[Assumption]:
    """What cannot be decided from the graph."""
    yield from _domains(claim, symbols, seed)
    yield from of_the_plant(claim.diagram)
    held = "samples are one period apart, and what is commanded is held from each to the next"
    yield Assumption(held, "the means over a sample")
    for part in claim.parts:
        for item in part.certificate.steps:
            eta = f"{part.block}: eta, what the rows of {item.estimate} leave unexplained of the means over a sample"
            yield Assumption(
                f"{eta}, is small: it is not bounded here, and can be looked at along a run", EACH[type(item)]
            )
        if part.certificate.plant and not decided_delays(claim, part):
            acted = "the command that a row holds is what acted in its sample: a delay is as configured, or echoed"
            text = f"{part.block}: {acted}"
            yield Assumption(text, "the means over a sample")
        if part.certificate.steps and not part.certificate.plant:
            text = f"{part.block}: the plant's motion obeys what its rows say; the block states no relation that does"
            yield Assumption(text, "the means over a sample")
        if part.certificate.excess:
            within = symbols_in(map(ca.SX, (piece for term in part.certificate.excess for piece in term.pieces)))
            made = [g.label for g in symbols.groups if within & symbols_in([g.symbol]) and g.kind != "parameter"]
            of = listed(made) or "parameters"
            text = f"{part.block}: the residual besides the steps, made of {of}, is small: nothing bounds it"
            yield Assumption(text, "the identity above")
    for leaf in stepping(claim):
        if any(
            symbols_in(map(ca.SX, term.pieces)) & symbols_in([leaf.symbol]) for p in claim.parts for term in p.stored
        ):
            text = f"{leaf.name} {BETWEEN}"
            yield Assumption(text, "V holds it")
    if claim.silent:
        yield Assumption(
            f"nothing is claimed of {', '.join(claim.silent)}: the proof holds for all commands",
            "the claim's own symbols",
        )
    yield Assumption(
        "joint velocities, and with them the rows, stay bounded; that the robot follows its path is not a part of this "
        "proof",
        "what a proof of tracking would need",
    )


def discrete_statements(claim: Claim) -> Iterator[Statement]:
    """What follows for the estimates and for V."""
    for part in claim.parts:
        for item in part.certificate.steps:
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
        if part.certificate.storage:
            says = "does not rise but by its residual" if part.certificate.excess else "does not rise"
            yield Statement(f"V of {part.block}", says, "the identity above")


def _domains(claim: Claim, symbols: Symbols, seed: int) -> Iterator[Assumption]:
    """That what V and a block's memories hold is defined at the next sample: assumed where signals decide it.

    What steps divide by is positive, such as their norms, and so is the period; both are left out.
    """
    for part in claim.parts:
        wanted = list(_needed(claim, part, symbols))
        norms = [size for item in part.certificate.steps for size in item.sizes]
        tape = Tape.from_function(symbols.function("domains", [stack(wanted), stack(norms)]))
        values, known = at_random_point(tape, symbols, seed)
        left = stack(x for x, value in zip(wanted, values, strict=True) if value not in known)
        moving = [g.label for g in symbols.groups if g.kind != "parameter" and ca.depends_on(left, g.symbol)]
        if moving:
            more = "" if len(moving) <= SHOWN else " and others"
            yield Assumption(
                f"{part.block}: what its samples divide by stays away from zero, and what they take roots or "
                f"logarithms of stays where these are defined, whatever {', '.join(moving[:SHOWN])}{more} do",
                "its equations need it",
            )


def _needed(claim: Claim, part: Part, symbols: Symbols) -> Iterator[SX]:
    """All that what V and the memories hold at the next sample needs, and that moves."""
    own = symbols_in([part.storage])
    kept = {f"{part.block}.{item.state}" for item in part.certificate.delay_lines}
    becomes = [
        claim.sample.next[label] for label, x in claim.sample.symbols.items() if label in kept or own & symbols_in([x])
    ]
    still = symbols_in(group.symbol for group in symbols.groups if group.kind == "parameter")
    period = claim.loop.period.element_hash()
    for _, needed in risky(becomes):
        if needed.element_hash() != period and symbols_in([needed]) - still:
            yield needed


__all__ = ["discrete_assumptions", "discrete_conditions", "discrete_statements"]
