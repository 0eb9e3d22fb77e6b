"""Conditions, assumptions and statements of a claim in discrete time, if its identity holds."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import reduce
from operator import or_
from typing import Any, Final, final

import casadi as ca

from dmframe.block.certificate import Assumption, LeastSquaresSteps, NormalisedSteps, Square, Steps
from dmframe.block.model import symbols_in
from dmframe.certify.checked import Checked, Finding, Numbers
from dmframe.certify.claim import Claim, Part
from dmframe.certify.conditions import conditions_stated, decide
from dmframe.certify.delays import decided_delays, delay_conditions
from dmframe.certify.form import stepping
from dmframe.certify.hypotheses import BETWEEN, of_the_plant, undefined
from dmframe.certify.memories import triangle_starts
from dmframe.certify.partial_functions import restricted
from dmframe.certify.points import in_random_field
from dmframe.certify.projections import outside
from dmframe.certify.statements import Statement
from dmframe.certify.symbols import Symbols
from dmframe.common.text import Label, Text, Written, joined, listed_text, name_of, sentence
from dmframe.exact import Evaluation, Trial
from dmframe.exact.ring import dependencies, needed
from dmframe.program import INPUT
from dmframe.prove import claim as data
from dmframe.prove.identity import inputs_at
from dmframe.prove.point import Point
from dmframe.prove.rules import step_result

SIGNS = sentence("{V} is positive, its decrease and its residual are not negative")
LEMMAS: Final[Mapping[type, Text]] = {
    NormalisedSteps: sentence("a box is convex, and {V} weights each element separately"),
    LeastSquaresSteps: sentence(
        "a box is convex: the nearest point of a face in the norm of {V}, or clipping where that norm is diagonal, is "
        "no farther from the points of the box; and {G}, a sum of {share} with forgetting, is positive semidefinite",
        share=Written("h h'/floor", "h hᵀ/floor", r"h h^\top/\text{floor}"),
    ),
}
_ERROR: Final = Written("|theta - theta_true|^2", "|θ − θ_true|²", r"|\theta - \theta_{\mathrm{true}}|^2")
_ETA: Final = Written("eta^2", "η²", r"\eta^2")
EACH: Final[Mapping[type, Text]] = {
    NormalisedSteps: sentence(
        "each normalised step with a row {h}, {y} changes {error}, weighted with {weight}, by minus the squares of the "
        "error in the direction of the row and of the prediction error, plus {eta}, each over its norm",
        error=_ERROR,
        weight=Written("1/Gamma", "1/Γ", r"1/\Gamma"),
        eta=_ETA,
    ),
    LeastSquaresSteps: sentence(
        "each step of least squares with a row {h}, {y} changes {error}, weighted with {weight}, by minus the square "
        "of the prediction error over its norm, plus {eta} over the floor; forgetting decreases it further",
        error=_ERROR,
        weight=Written("1/Gamma + G", "1/Γ + G", r"1/\Gamma + G"),
        eta=_ETA,
    ),
}


SHOWN: Final = 6
"""Largest number of signals that are listed by name."""


def discrete_conditions(claim: Claim, numbers: Numbers, start: Mapping[str, Any]) -> Iterator[Finding]:
    """Conditions of the proof that numbers can decide, and the remaining assumptions."""
    claiming = {part.block for part in claim.parts}
    yield from decide(((name, item) for name, item in conditions_stated(claim) if name in claiming), numbers)
    yield from dict.fromkeys(undefined(claim, numbers))
    for part in claim.parts:
        yield from _weights(part, numbers)
        yield from delay_conditions(claim, part)
        for item in part.certificate.steps:
            yield from _steps(part, item, numbers)
            if isinstance(item, LeastSquaresSteps):
                yield from _least_squares(part, item, numbers, start)
            yield from _boxed(part, item, numbers)


def _weights(part: Part, numbers: Numbers) -> Iterator[Checked]:
    for role, terms in (
        (sentence("{V}"), part.certificate.storage),
        (sentence("the decrease of {V}"), part.certificate.dissipation),
        (Text("the residual"), part.certificate.residual),
    ):
        for place, term in enumerate((term for term in terms if isinstance(term, Square)), start=1):
            name, strict = Text(f"{part.block}: weight of term {place} of ", role), role == "V"
            yield numbers.decide(name, f"weight {'>' if strict else '>='} 0", SIGNS, term.weight, strict)


def _steps(part: Part, item: Steps, numbers: Numbers) -> Iterator[Checked]:
    for role, value in (("gain", item.gain), ("floor", item.floor)):
        name = Text(f"{part.block}: {role} of the steps of ", name_of(item.estimate))
        yield numbers.decide(name, f"{role} > 0", SIGNS, ca.vec(ca.densify(ca.SX(value))))


def _least_squares(
    part: Part, item: LeastSquaresSteps, numbers: Numbers, start: Mapping[str, Any]
) -> Iterator[Checked]:
    name, share = Text(f"{part.block}: retention of the steps of ", name_of(item.estimate)), ca.SX(item.retention)
    room = ca.vertcat(share, 1 - share)
    yield numbers.decide(name, "0 <= retention <= 1", LEMMAS[LeastSquaresSteps], room, strict=False)
    yield from triangle_starts(part.block, item, numbers, start)


def _boxed(part: Part, item: Steps, numbers: Numbers) -> Iterator[Finding]:
    """The true value is inside the box: decided if parameters determine it, otherwise assumed."""
    if not item.box:
        return
    lower, upper, true = (ca.vec(ca.densify(ca.SX(end))) for end in (*item.box, item.true))
    lemma = LEMMAS[type(item)]
    room = ca.vertcat(true - lower, upper - true)
    known = [row for row in range(room.shape[0]) if symbols_in([room[row]]) <= numbers.known]
    estimate = name_of(item.estimate)
    text = Text(f"{part.block}: true value of ", estimate, " inside its box")
    if known:
        yield numbers.decide(text, "lower <= true value <= upper", lemma, room[known], strict=False)
    loop, free = numbers.claim.loop, [row for row in range(room.shape[0]) if row not in known]
    handed = [row for row in free if symbols_in([loop.on_path(room[row])]) <= symbols_in([loop.time, loop.p])]
    if handed:  # decided by the sampled values of the source
        yield from outside(text, loop.on_path(room[handed]), loop)
    left = sorted({row % true.shape[0] for row in free})
    if left:
        width, name = (upper - lower)[left], Text(f"{part.block}: box of ", estimate, " is not empty")
        yield numbers.decide(name, "lower <= upper", lemma, width, strict=False)
        whose = "which depend on a source or unknown constants" if handed else "which are unknown constants"
        yield Assumption(Text(text, f", in {len(left)} of {true.shape[0]} elements, {whose}"), lemma)


def discrete_assumptions(claim: Claim, exact: data.Claim, symbols: Symbols, seed: int) -> Iterator[Assumption]:
    """Facts that cannot be decided from the graph."""
    yield from _domains(claim, exact, seed)
    yield from of_the_plant(claim.diagram)
    held = "samples are one period apart, and commands are held constant between samples"
    yield Assumption(held, "the means over a sample")
    for part in claim.parts:
        for item in part.certificate.steps:
            unexplained = sentence(
                "{block}: {eta}, the error of the rows of {of} in the means over a sample, is small: it is "
                "not bounded here, and can be evaluated along a run",
                block=part.block,
                of=name_of(item.estimate),
            )
            yield Assumption(unexplained, EACH[type(item)])
        if part.certificate.plant and not decided_delays(claim, part):
            acted = "the command in a row was applied in its sample: a delay is as configured, or reported by the robot"
            text = f"{part.block}: {acted}"
            yield Assumption(text, "the means over a sample")
        if part.certificate.steps and not part.certificate.plant:
            implied = (
                "the plant's motion satisfies the equation of its rows; the block states no relation that implies it"
            )
            yield Assumption(f"{part.block}: {implied}", "the means over a sample")
        if part.certificate.residual:
            within = symbols_in(map(ca.SX, (piece for term in part.certificate.residual for piece in term.pieces)))
            made = [g.label for g in symbols.groups if within & symbols_in([g.symbol]) and g.kind != "parameter"]
            of = listed_text(list(map(Label, made))) or "parameters"
            text = Text(
                f"{part.block}: the residual other than that of the steps, a function of ",
                of,
                ", is small: no bound of it is proved",
            )
            yield Assumption(text, "the identity above")
    for leaf in stepping(claim):
        if any(symbols_in(map(ca.SX, term.pieces)) & leaf.identities for p in claim.parts for term in p.stored):
            yield Assumption(Text(Label(leaf.name), " ", sentence(BETWEEN)), sentence("{V} contains it"))
    if claim.silent:
        yield Assumption(
            f"no claim is made about {', '.join(claim.silent)}: the proof holds for all commands",
            "the claim's own symbols",
        )
    yield Assumption(
        "joint velocities, and thus the rows, stay bounded; tracking of the path is not a part of this proof",
        "a proof of tracking would need it",
    )


def discrete_statements(claim: Claim) -> Iterator[Statement]:
    """Conclusions for the estimates and for V."""
    for part in claim.parts:
        for item in part.certificate.steps:
            name, label = Text(name_of(item.estimate), f" ({part.block})"), f"{part.block}.{item.estimate}"
            if item.box:
                yield Statement(name, "is bounded", Text("it is projected onto its box at each sample"), estimate=label)
            falls = "does not rise where eta is zero"
            yield Statement(sentence("{V} of {name}", name=name), falls, EACH[type(item)], estimate=label)
            many = f", over {len(item.rows)} steps a sample" if len(item.rows) > 1 else ""
            yield Statement(
                Text("the error in the direction of the rows, of ", name),
                f"is square-summable where eta is{many}",
                sentence("summed over the samples, with {V} >= 0: {each}", each=EACH[type(item)]),
                estimate=label,
            )
        if part.certificate.storage:
            says = "rises by its residual at most" if part.certificate.residual else "does not rise"
            yield Statement(sentence("{V} of {block}", block=part.block), says, Text("the identity above"))


def _domains(claim: Claim, exact: data.Claim, seed: int) -> Iterator[Assumption]:
    """V and a block's memories are defined at the next sample: assumed if signals decide it.

    Divisors of update steps, such as their norms, and the period are positive, and are left out.
    """
    exact = exact.shared
    made = dependencies(exact.tape, {k: 1 << k for k, s in enumerate(exact.symbols) if s.kind != "parameter"})
    period = 1 << exact.inputs["T"]
    for part, stated in zip(claim.parts, exact.parts, strict=True):
        outs = [exact.moves[label] for label in _becoming(claim, part)]
        wanted = [
            place
            for place in dict.fromkeys(operand for _, operand in _restricted(exact, outs))
            if made[place] and not (made[place] == period and exact.tape.nodes[place].code == INPUT)
        ]
        given = [out for steps in stated.steps for out in steps.parts.values()]
        places = needed(exact.tape, [exact.outputs[out] for out in (*outs, *given)])

        def found(
            trial: Trial,
            steps: Sequence[data.Steps] = stated.steps,
            places: Sequence[int] = places,
            wanted: Sequence[int] = wanted,
        ) -> list[int]:
            inputs = inputs_at(exact, trial)
            point = Point(exact, trial, inputs, Evaluation(exact.tape, inputs, trial, (), places).values)
            divisors = _Dividing(trial)
            for item in steps:
                step_result(divisors, item, {name: point.out(out) for name, out in item.parts.items()})
            return [place for place in wanted if point.values[place] % trial.prime not in divisors.residues]

        left = reduce(or_, (made[place] for place in in_random_field("domains", seed, found)), 0)
        moving = [symbol.label for k, symbol in enumerate(exact.symbols) if left >> k & 1]
        if moving:
            more = "" if len(moving) <= SHOWN else " and others"
            text = (
                "{block}: the divisors in its samples stay away from zero, and the arguments of roots and logarithms "
            )
            text += "stay where these are defined, for any values of {moving}{more}"
            named = joined(list(map(Label, moving[:SHOWN])))
            yield Assumption(sentence(text, block=part.block, moving=named, more=more), "its equations need it")


def _restricted(exact: data.Claim, outs: Sequence[str]) -> Iterator[tuple[int, int]]:
    program = exact.tape.program
    return restricted(program, [source for out in outs for source in program.sources[exact.outputs[out]]])


def _becoming(claim: Claim, of: Part) -> list[str]:
    """States whose next values V and the memories of a block depend on."""
    own = symbols_in([of.storage])
    kept = {f"{of.block}.{item.state}" for item in of.certificate.delay_lines}
    return [label for label, x in claim.sample.symbols.items() if label in kept or own & symbols_in([x])]


@final
class _Dividing:
    """Ring of a trial that collects the residues by which it divides."""

    def __init__(self, trial: Trial) -> None:
        self._trial, self.residues = trial, set[int]()
        self.number, self.reduced, self.call = trial.number, trial.reduced, trial.call

    def inverse(self, value: int) -> int:
        """1 / value; raises `ZeroDivision`."""
        self.residues.add(self._trial.reduced(value))
        return self._trial.inverse(value)


__all__ = ["discrete_assumptions", "discrete_conditions", "discrete_statements"]
