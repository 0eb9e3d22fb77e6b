"""What a claim has to be, so that the identity of its data is one of V: every rule that a file could break."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Final, final

from dmframe.common.errors import ValueFault
from dmframe.exact.ring import needed
from dmframe.exact.tangent import between
from dmframe.program import CONST, INPUT, JUMPS, sign_of
from dmframe.prove.claim import Claim, Line, Out, Part, Steps, Term

STILL: Final = frozenset(("parameter", "weight", "constant", "stepping"))
"""Kinds of symbols that have the same value at all times; a stepping one between its steps, where V begins anew."""

MOVING: Final = {"flow": frozenset(("time", "state", "trajectory")), "sample": frozenset(("state",))}
"""Kinds of symbols that move, by the operator."""

KINDS: Final = {
    "flow": frozenset(("parameter", "weight", "projection")) | MOVING["flow"],
    "sample": STILL - {"weight"} | MOVING["flow"] | {"projection", "period", "noise", "command"},
}
"""All kinds of symbols, by the operator."""

TERMS: Final[Mapping[str, frozenset[str]]] = {
    "square": frozenset(("vector", "weight")),
    "norm_square": frozenset(("value", "vector")),
    "gathered": frozenset(("value", "vector")),
    "potential": frozenset(("value", "vector")),
    "monotone": frozenset(("value",)),
    "log_det": frozenset(("value",)),
    "clipped": frozenset(("value",)),
}
"""The parts of a term, by its rule."""

ROLES: Final[Mapping[str, frozenset[str]]] = {
    "stored": frozenset(("square", "gathered", "potential", "log_det")),
    "dissipation": frozenset(("square", "norm_square", "monotone", "gathered")),
    "residual": frozenset(("square", "norm_square", "clipped")),
    "errors": frozenset(("square",)),
}
"""The rules of which a term may be, by its role."""

CONSTANT: Final = frozenset(("true", "gain", "floor", "retention", "lower", "upper"))
"""Parts of steps that must not move."""

LARGEST: Final = 10**6
"""Elements of all inputs, and of all outputs, that a claim may have."""


def hold_sound(claim: Claim) -> None:
    """Raise `ValueFault` for a claim whose data do not belong together, or of which D V would not be that of V."""
    for fault in _Rules(claim).faults():
        raise ValueFault(f"a claim: {fault}")


@final
class _Rules:
    """The rules, each a text for what breaks it; later ones read only what earlier ones have held."""

    def __init__(self, claim: Claim) -> None:
        self._of = claim
        self._kinds = {symbol.label: symbol.kind for symbol in claim.symbols}
        self._sizes = {symbol.label: symbol.size for symbol in claim.symbols}
        self._shapes = {pattern.name: (pattern.rows, pattern.size) for pattern in claim.program.outputs}
        self._read = list[Out]()

    def faults(self) -> Iterator[str]:
        """All that is broken."""
        yield from self._symbols()
        yield from self._program()
        yield from self._moves(self._of.moves, MOVING[self._of.operator])
        yield from self._moves(self._of.plant_moves, frozenset(("state",)))
        for part in self._of.parts:
            for fault in self._part(part):
                yield f"{part.block}: {fault}"
        yield from self._composed()
        yield from self._labels()
        counts = Counter(self._read)
        for out in self._shapes:
            if counts[out] != 1:
                yield f"expected each output to be read once, found {out} read {counts[out]} times"
        yield from self._dependence()

    def _symbols(self) -> Iterator[str]:
        of = self._of
        labels = [*(symbol.label for symbol in of.symbols), *(f"{gain}.changed" for gain in of.gains)]
        for label, count in Counter(labels).items():
            if count > 1:
                yield f"expected each symbol to have a label of its own, found {label} twice"
        for symbol in of.symbols:
            if symbol.kind not in KINDS[of.operator]:
                yield f"{symbol.label}: expected one of {', '.join(sorted(KINDS[of.operator]))}, found {symbol.kind}"
            if symbol.kind in ("time", "weight", "period") and symbol.size != 1:
                yield f"{symbol.label}: expected one number, found {symbol.size}"
            if symbol.values is not None and (symbol.kind != "parameter" or len(symbol.values) != symbol.size):
                yield f"{symbol.label}: expected values of a parameter alone, one for each element"
        for label in of.gains:
            if self._kinds.get(label) != "parameter":
                yield f"expected gains to be parameters, found {label}"

    def _program(self) -> Iterator[str]:
        of, program = self._of, self._of.program
        wanted = [(symbol.label, symbol.size) for symbol in of.symbols]
        wanted += [(f"{label}.changed", self._sizes[label]) for label in of.gains]
        found = [(item.name, item.size) for item in program.inputs if item.rows == item.size]
        if len(found) != len(program.inputs) or found != wanted:
            yield "expected the program's inputs to be columns: the symbols and the copies of the gains"
        if len(self._shapes) != len(program.outputs):
            yield "expected each output to have a name of its own"
        if max(sum(item.size for item in side) for side in (program.inputs, program.outputs)) > LARGEST:
            yield f"expected at most {LARGEST} elements"
        for item in program.outputs:
            if (item.size and not item.rows) or item.size % max(item.rows, 1):
                yield f"the output {item.name}: expected whole columns, found {item.size} elements in {item.rows} rows"
            if len({*item.places}) != len(item.places) or not all(0 <= place < item.size for place in item.places):
                yield f"the output {item.name}: expected places of its own elements, each once"

    def _moves(self, moves: Mapping[str, Out], kinds: Collection[str]) -> Iterator[str]:
        for label, out in moves.items():
            if self._kinds.get(label) not in kinds:
                yield f"expected moves of {sorted(kinds)}, found one of {label}"
            else:
                yield from self._column(out, self._sizes[label], f"the move of {label}")
            if self._kinds.get(label) == "time" and self._shapes.get(out) == (1, 1) and not self._is_one(out):
                yield f"expected {label} to move by 1 a second"

    def _part(self, part: Part) -> Iterator[str]:
        samples = self._of.over_samples
        if part.weight and (samples or self._kinds.get(part.weight) != "weight"):
            yield f"expected a weight that is a symbol of that kind, and none over samples, found {part.weight}"
        for role, allowed in ROLES.items():
            for term in getattr(part, role):
                yield from self._term(role, term, frozenset(("square",)) if samples else allowed)
        if part.consumed is not None:
            yield from self._term("consumed", part.consumed, frozenset(("square",)))
            if self._shapes.get(part.consumed.parts.get("weight", ""), (1, 1))[1] != 1:
                yield "expected a cross term with one number as its weight"
        for name in ("supply", "lemma"):
            if getattr(part, name):
                yield from self._column(getattr(part, name), 1, name)
        yield from (self._over_samples if samples else self._of_a_flow)(part)

    def _of_a_flow(self, part: Part) -> Iterator[str]:
        if part.steps or part.lines or part.plant or part.solved:
            yield "expected no steps, lines, relations and solved equations in continuous time"
        for _, matrix, rate in part.memories:
            yield from self._square(matrix, "an information matrix")
            yield from self._sized(rate, {self._shapes.get(matrix, (0, 0))[1]}, "its rate")
        gathered = {term.name for term in (*part.stored, *part.dissipation) if term.rule == "gathered"}
        named = {name for name, _, _ in part.memories}
        if bool(gathered) != bool(named) or not named <= gathered:
            yield "expected the information matrices of the terms that gather them"
        for _, matrix in part.symmetric:
            yield from self._square(matrix, "a symmetric matrix")

    def _over_samples(self, part: Part) -> Iterator[str]:
        if part.memories or part.symmetric or part.consumed or part.lemma:
            yield "expected no information matrices, cross terms and projections over samples"
        for steps in part.steps:
            yield from self._steps(part.block, steps)
        for line in part.lines:
            yield from self._line(part.block, line)
        for relation in part.plant:
            for out in (relation.momentum, relation.rest):
                yield from self._column(out, self._shapes.get(relation.momentum, (0, 0))[1], "a relation")
        for out in part.solved:
            yield from self._known(out, "a solved equation")

    def _term(self, role: str, term: Term, allowed: Collection[str]) -> Iterator[str]:
        if term.rule not in allowed or frozenset(term.parts) != TERMS[term.rule]:
            yield f"{role}: expected terms {sorted(allowed)} of their parts, found {term.rule} of {sorted(term.parts)}"
            return
        if "vector" in term.parts:
            n = self._shapes.get(term.parts["vector"], (0, 0))[1]
            yield from self._column(term.parts["vector"], n, f"the vector of {term.name}")
            if "weight" in term.parts:
                yield from self._sized(term.parts["weight"], {1, n, n * n}, f"the weight of {term.name}")
        if "value" in term.parts:
            yield from self._column(term.parts["value"], 1, f"the value of {term.name}")

    def _steps(self, block: str, steps: Steps) -> Iterator[str]:
        squares, size = steps.rule == "least_squares", sum(steps.sizes)
        wanted = {"theta": size, "true": size, "gain": size, "floor": 1}
        wanted |= dict.fromkeys(("lower", "upper") if steps.box else (), size)
        triangles = sum(n * (n + 1) // 2 for n in steps.sizes)
        wanted |= {"gathered": triangles, "retention": 1} if squares else {}
        if len(steps.parts) != len(wanted) + 2 * steps.rows or min(steps.sizes, default=0) < 1:
            yield f"the steps of {steps.estimate}: expected {len(wanted)} parts and {steps.rows} rows of two"
            return
        for k in range(steps.rows):
            wanted |= {f"h{k}": size, f"y{k}": len(steps.sizes)}
        if wanted.keys() != steps.parts.keys() or bool(steps.memory) != squares or steps.memory == steps.estimate:
            yield f"the steps of {steps.estimate}: expected the parts {sorted(wanted)}, and a memory of least squares"
            return
        for name, count in wanted.items():
            yield from self._column(steps.parts[name], count, f"the steps of {steps.estimate}: {name}")
        for state, part in ((steps.estimate, "theta"), (steps.memory, "gathered"))[: 1 + squares]:
            yield from self._is_state(f"{block}.{state}", steps.parts[part])

    def _line(self, block: str, line: Line) -> Iterator[str]:
        label = f"{block}.{line.state}"
        yield from self._known(line.before, f"{label} before")
        yield from self._is_state(label, line.before)
        yield from self._known(line.newest, f"the newest entry of {label}")
        if line.when is not None:
            yield from self._column(line.when, 1, f"when {label} is stored")
        shapes = [_shape(self._shapes.get(out, (0, 0))) for out in (line.newest, line.before)]
        pairs = list(zip(*shapes, strict=True))
        if not (any(a == b for a, b in pairs) and all(a and b % a == 0 for a, b in pairs)):
            yield f"{label}: expected a whole number of entries"

    def _composed(self) -> Iterator[str]:
        blocks = [part.block for part in self._of.parts]
        if len({*blocks}) != len(blocks) or not all(blocks):
            yield "expected each part to be of a block of its own"
        if not any(part.stores for part in self._of.parts):
            yield "expected a part that stores something"
        for dominating, consuming, composed, wanted in self._of.composed:
            if self._of.over_samples or not {dominating, consuming} <= {*blocks}:
                yield f"expected a cross term of two blocks in continuous time, found {dominating} and {consuming}"
            for out in (composed, wanted):
                yield from self._column(out, self._shapes.get(wanted, (0, 0))[1], "a composed vector")

    def _labels(self) -> Iterator[str]:
        of = self._of
        for label, count in Counter((*of.reversed, *of.stored_states)).items():
            if count > (label in of.reversed) + (label in of.stored_states):
                yield f"expected {label} once"
            if label not in of.moves or self._kinds[label] != "state":
                yield f"expected a state that moves, found {label}"
        if not of.over_samples and (of.stored_states or of.plant_moves):
            yield "expected no sampled states and no moves of the plant between samples in continuous time"

    def _dependence(self) -> Iterator[str]:
        """What V holds has a move, does not jump, and holds no copy of a gain."""
        of, moves = self._of, {*self._of.moves.values()}
        steps = [item for part in of.parts for item in part.steps]
        constant = [out for item in steps for name, out in item.parts.items() if name in CONSTANT]
        for outs, moving in ((of.differentiated, of.moved), (constant, ()), (of.momenta, of.plant_moves)):
            for label in self._held(outs):
                if self._kinds.get(label) not in STILL and label not in moving:
                    yield f"V, or what it is made of, holds {label}, which has no move"
        for label in self._held([out for out in self._shapes if out not in moves]):
            if label not in self._kinds:
                yield f"expected {label} in the moves alone"
        yield from self._jumps(of.momenta, of.plant_moves)
        if not of.over_samples:
            yield from self._jumps(of.differentiated, of.moves)

    def _jumps(self, outs: Collection[Out], moves: Collection[str]) -> Iterator[str]:
        of = self._of
        for place in between(of.tape, [of.inputs[label] for label in moves], [of.outputs[out] for out in outs]):
            if of.tape.nodes[place].code in JUMPS:
                yield f"what is differentiated holds {sign_of(of.tape.nodes[place].code)}, which jumps"

    def _held(self, outs: Collection[Out]) -> Iterator[str]:
        """The inputs that these outputs depend on."""
        nodes, inputs = self._of.tape.nodes, self._of.program.inputs
        places = needed(self._of.tape, [self._of.outputs[out] for out in outs])
        return (inputs[k].name for k in sorted({nodes[place].a for place in places if nodes[place].code == INPUT}))

    def _known(self, out: Out, what: str) -> Iterator[str]:
        self._read.append(out)
        if out not in self._shapes:
            yield f"{what}: expected an output of the program, found {out}"

    def _sized(self, out: Out, sizes: Collection[int], what: str) -> Iterator[str]:
        yield from self._known(out, what)
        if out in self._shapes and self._shapes[out][1] not in sizes:
            yield f"{what}: expected {sorted(sizes)} elements, found {self._shapes[out][1]}"

    def _column(self, out: Out, size: int, what: str) -> Iterator[str]:
        yield from self._sized(out, {size}, what)
        if out in self._shapes and self._shapes[out][0] != size:
            yield f"{what}: expected a column of {size}, found {self._shapes[out][0]} rows"

    def _square(self, out: Out, what: str) -> Iterator[str]:
        rows, size = self._shapes.get(out, (0, 0))
        yield from self._known(out, what)
        if rows * rows != size:
            yield f"{what}: expected a square matrix, found {rows} rows of {size} elements"

    def _is_state(self, label: str, out: Out) -> Iterator[str]:
        """An output that is a state itself, of which steps or a delay line say the move."""
        if label not in self._of.moves:
            yield f"expected a move of {label}"
            return
        position, item = self._of.inputs[label], self._of.outputs[out]
        found = [self._of.program.nodes[place] for place in self._of.program.sources[item]]
        own = [node.b for node in found if node.code == INPUT and node.a == position]
        if own != list(range(self._sizes[label])) or list(self._of.program.outputs[item].places) != own:
            yield f"expected {label} itself, found {out}"

    def _is_one(self, out: Out) -> bool:
        program = self._of.program
        sources = program.sources[self._of.outputs[out]]
        return all(
            program.nodes[k].code == CONST and self._of.tape.numbers[program.nodes[k].constant] == 1 for k in sources
        ) and bool(sources)


def _shape(pattern: Sequence[int]) -> tuple[int, int]:
    rows, size = pattern
    return rows, size // max(rows, 1)
