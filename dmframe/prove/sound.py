"""Validity rules of a claim: if its data satisfy them, its identity is an identity of V."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Final, final

from dmframe.common.errors import ValueFault
from dmframe.exact.ring import needed
from dmframe.exact.tangent import between
from dmframe.program import CONST, INPUT, JUMPS, sign_of
from dmframe.prove.claim import Claim, Line, Out, Part, Steps, Term

FIXED_KINDS: Final = frozenset(("parameter", "weight", "constant", "stepping"))
"""Kinds of symbols that are constant; a stepping one is constant between its steps, at which V restarts."""

MOVING: Final = {"flow": frozenset(("time", "state", "trajectory")), "sample": frozenset(("state",))}
"""Kinds of symbols that vary with time, by the operator."""

KINDS: Final = {
    "flow": frozenset(("parameter", "weight", "projection")) | MOVING["flow"],
    "sample": FIXED_KINDS - {"weight"} | MOVING["flow"] | {"projection", "period", "noise", "command"},
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
"""Parts of a term, by its rule."""

ROLES: Final[Mapping[str, frozenset[str]]] = {
    "stored": frozenset(("square", "gathered", "potential", "log_det")),
    "dissipation": frozenset(("square", "norm_square", "monotone", "gathered")),
    "residual": frozenset(("square", "norm_square", "clipped")),
    "errors": frozenset(("square",)),
}
"""Rules that a term can have, by its role."""

CONSTANT: Final = frozenset(("true", "gain", "floor", "retention", "lower", "upper"))
"""Parts of update steps that must be constant."""

LARGEST: Final = 10**6
"""Largest number of elements of all inputs, and of all outputs."""


def require_sound(claim: Claim) -> None:
    """Raise `ValueFault` for a claim with inconsistent data, or in which D V would not be the derivative of V."""
    for fault in _Rules(claim).faults():
        raise ValueFault(f"a claim: {fault}")


@final
class _Rules:
    """The rules, each with a message for its violation; later rules rely on earlier ones."""

    def __init__(self, claim: Claim) -> None:
        self._claim = claim
        self._kinds = {symbol.label: symbol.kind for symbol in claim.symbols}
        self._sizes = {symbol.label: symbol.size for symbol in claim.symbols}
        self._shapes = {pattern.name: (pattern.rows, pattern.size) for pattern in claim.program.outputs}
        self._read = list[Out]()

    def faults(self) -> Iterator[str]:
        """Messages for all violations."""
        yield from self._symbols()
        yield from self._program()
        yield from self._moves(self._claim.moves, MOVING[self._claim.operator])
        yield from self._moves(self._claim.plant_moves, frozenset(("state",)))
        for part in self._claim.parts:
            for fault in self._part(part):
                yield f"{part.block}: {fault}"
        yield from self._composed()
        yield from self._labels()
        counts = Counter(self._read)
        for out in self._shapes:
            if counts[out] != 1:
                yield f"expected each output to be used once, found {out} used {counts[out]} times"
        yield from self._dependence()

    def _symbols(self) -> Iterator[str]:
        of = self._claim
        labels = [*(symbol.label for symbol in of.symbols), *(f"{gain}.changed" for gain in of.gains)]
        for label, count in Counter(labels).items():
            if count > 1:
                yield f"expected each symbol to have a unique label, found {label} twice"
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
        of, program = self._claim, self._claim.program
        wanted = [(symbol.label, symbol.size) for symbol in of.symbols]
        wanted += [(f"{label}.changed", self._sizes[label]) for label in of.gains]
        found = [(item.name, item.size) for item in program.inputs if item.rows == item.size]
        if len(found) != len(program.inputs) or found != wanted:
            yield "expected the program's inputs to be columns: the symbols and the copies of the gains"
        if len(self._shapes) != len(program.outputs):
            yield "expected each output to have a unique name"
        if max(sum(item.size for item in side) for side in (program.inputs, program.outputs)) > LARGEST:
            yield f"expected at most {LARGEST} elements"
        for item in program.outputs:
            if (item.size and not item.rows) or item.size % max(item.rows, 1):
                yield f"the output {item.name}: expected complete columns, found {item.size} elements, {item.rows} rows"
            if len({*item.places}) != len(item.places) or not all(0 <= place < item.size for place in item.places):
                yield f"the output {item.name}: expected the position of each stored element once"

    def _moves(self, moves: Mapping[str, Out], kinds: Collection[str]) -> Iterator[str]:
        for label, out in moves.items():
            if self._kinds.get(label) not in kinds:
                yield f"expected moves of {sorted(kinds)}, found one of {label}"
            else:
                yield from self._column(out, self._sizes[label], f"the move of {label}")
            if self._kinds.get(label) == "time" and self._shapes.get(out) == (1, 1) and not self._is_one(out):
                yield f"expected {label} to have the rate 1"

    def _part(self, part: Part) -> Iterator[str]:
        samples = self._claim.over_samples
        if part.weight and (samples or self._kinds.get(part.weight) != "weight"):
            yield f"expected a symbol of the kind weight, and none in discrete time, found {part.weight}"
        for role, allowed in ROLES.items():
            for term in getattr(part, role):
                yield from self._term(role, term, frozenset(("square",)) if samples else allowed)
        if part.consumed is not None:
            yield from self._term("consumed", part.consumed, frozenset(("square",)))
            if self._shapes.get(part.consumed.parts.get("weight", ""), (1, 1))[1] != 1:
                yield "expected a cross term with a scalar weight"
        for name in ("supply", "lemma"):
            if getattr(part, name):
                yield from self._column(getattr(part, name), 1, name)
        yield from (self._over_samples if samples else self._of_a_flow)(part)

    def _of_a_flow(self, part: Part) -> Iterator[str]:
        if part.steps or part.lines or part.plant or part.solved:
            yield "expected no steps, lines, plant identities and solved equations in continuous time"
        for _, matrix, rate in part.memories:
            yield from self._square(matrix, "an information matrix")
            yield from self._sized(rate, {self._shapes.get(matrix, (0, 0))[1]}, "its rate")
        gathered = {term.name for term in (*part.stored, *part.dissipation) if term.rule == "gathered"}
        named = {name for name, _, _ in part.memories}
        if bool(gathered) != bool(named) or not named <= gathered:
            yield "expected the information matrices of the terms that contain them"
        for _, matrix in part.symmetric:
            yield from self._square(matrix, "a symmetric matrix")

    def _over_samples(self, part: Part) -> Iterator[str]:
        if part.memories or part.symmetric or part.consumed or part.lemma:
            yield "expected no information matrices, cross terms and projections in discrete time"
        for steps in part.steps:
            yield from self._steps(part.block, steps)
        for line in part.lines:
            yield from self._line(part.block, line)
        for relation in part.plant:
            for out in (relation.momentum, relation.rest):
                yield from self._column(out, self._shapes.get(relation.momentum, (0, 0))[1], "a plant identity")
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
            yield from self._column(line.when, 1, f"the storage condition of {label}")
        shapes = [_shape(self._shapes.get(out, (0, 0))) for out in (line.newest, line.before)]
        pairs = list(zip(*shapes, strict=True))
        if not (any(a == b for a, b in pairs) and all(a and b % a == 0 for a, b in pairs)):
            yield f"{label}: expected a whole number of entries"

    def _composed(self) -> Iterator[str]:
        blocks = [part.block for part in self._claim.parts]
        if len({*blocks}) != len(blocks) or not all(blocks):
            yield "expected one part per block"
        if not any(part.stores for part in self._claim.parts):
            yield "expected a part with a stored term"
        for dominating, consuming, composed, wanted in self._claim.composed:
            if self._claim.over_samples or not {dominating, consuming} <= {*blocks}:
                yield f"expected a cross term of two blocks in continuous time, found {dominating} and {consuming}"
            for out in (composed, wanted):
                yield from self._column(out, self._shapes.get(wanted, (0, 0))[1], "a composed vector")

    def _labels(self) -> Iterator[str]:
        of = self._claim
        for label, count in Counter((*of.reversed, *of.stored_states)).items():
            if count > (label in of.reversed) + (label in of.stored_states):
                yield f"expected {label} once"
            if label not in of.moves or self._kinds[label] != "state":
                yield f"expected a state that moves, found {label}"
        if not of.over_samples and (of.stored_states or of.plant_moves):
            yield "expected no sampled states and no moves of the plant between samples in continuous time"

    def _dependence(self) -> Iterator[str]:
        """Each state in V has a rate, V is continuous, and V contains no copy of a gain."""
        of, moves = self._claim, {*self._claim.moves.values()}
        steps = [item for part in of.parts for item in part.steps]
        constant = [out for item in steps for name, out in item.parts.items() if name in CONSTANT]
        for outs, moving in ((of.differentiated, of.moved), (constant, ()), (of.momenta, of.plant_moves)):
            for label in self._inputs_of(outs):
                if self._kinds.get(label) not in FIXED_KINDS and label not in moving:
                    yield f"V depends on {label}, which has no rate"
        for label in self._inputs_of([out for out in self._shapes if out not in moves]):
            if label not in self._kinds:
                yield f"expected {label} only in rates or next values"
        yield from self._jumps(of.momenta, of.plant_moves)
        if not of.over_samples:
            yield from self._jumps(of.differentiated, of.moves)

    def _jumps(self, outs: Collection[Out], moves: Collection[str]) -> Iterator[str]:
        of = self._claim
        for place in between(of.tape, [of.inputs[label] for label in moves], [of.outputs[out] for out in outs]):
            if of.tape.nodes[place].code in JUMPS:
                yield f"a differentiated output contains {sign_of(of.tape.nodes[place].code)}, which is discontinuous"

    def _inputs_of(self, outs: Collection[Out]) -> Iterator[str]:
        """Inputs that these outputs depend on."""
        nodes, inputs = self._claim.tape.nodes, self._claim.program.inputs
        places = needed(self._claim.tape, [self._claim.outputs[out] for out in outs])
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
        """An output that is itself a state whose rate is determined by update steps or a delay line."""
        if label not in self._claim.moves:
            yield f"expected a move of {label}"
            return
        position, item = self._claim.inputs[label], self._claim.outputs[out]
        found = [self._claim.program.nodes[place] for place in self._claim.program.sources[item]]
        own = [node.b for node in found if node.code == INPUT and node.a == position]
        if own != list(range(self._sizes[label])) or list(self._claim.program.outputs[item].places) != own:
            yield f"expected the state {label}, found {out}"

    def _is_one(self, out: Out) -> bool:
        program = self._claim.program
        sources = program.sources[self._claim.outputs[out]]
        return all(
            program.nodes[k].code == CONST and self._claim.tape.numbers[program.nodes[k].constant] == 1 for k in sources
        ) and bool(sources)


def _shape(pattern: Sequence[int]) -> tuple[int, int]:
    rows, size = pattern
    return rows, size // max(rows, 1)
