"""What is wrong with the form of a claim over samples: names, shapes, and what moves that must not."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

import casadi as ca

from dmframe.block.model import symbols_in
from dmframe.certificate import SX, LeastSquaresSteps
from dmframe.errors import nearest
from dmframe.program import EDGES, JUMPS, KINKS, codes
from dmframe.steps import packed_size

if TYPE_CHECKING:
    from dmframe.certify.claim import Claim
    from dmframe.certify.samples import SampledClaim, SampledPart
    from dmframe.diagram.resolve import Leaf


def unfit(claim: SampledClaim, part: SampledPart) -> Iterator[str]:
    """What is wrong with the form of a block's claim."""
    own = {
        label.partition(".")[2]: symbol for label, symbol in claim.symbols.items() if label.startswith(f"{part.block}.")
    }
    yield from _misshapen(part, own)
    loop = claim.base.loop
    constant = symbols_in(parameter.symbol for parameter in loop.parameters)
    constant |= symbols_in(part.constants.values())
    constant |= symbols_in(leaf.symbol for leaf in stepping(claim.base))  # between steps, each of which begins a new V
    allowed = constant | symbols_in(own.values())
    moving = {s.element_hash(): v.label for v in loop.variables for s in ca.symvar(ca.vec(v.symbol))}
    for term in part.stored:
        for piece in term.pieces:
            for strange in symbols_in([piece]) - allowed:
                what = moving.get(strange, "what is no parameter")
                yield f"V holds {what}, of which nothing says what it is one sample later; expected its sampled states"
    if symbols_in([ca.SX(term.weight) for term in part.storage]) - constant:
        yield "V weighs with what moves; expected weights made of parameters"
    weighed = symbols_in([part.V]) - constant
    for term in part.residual:
        for symbol in symbols_in(map(ca.SX, term.pieces)) & weighed:
            yield (
                f"what V gains holds {moving[symbol]}, which V holds too, so that V could do anything; expected a "
                "residual made of what is not in V"
            )
    for item in part.steps:
        for role, value in item.constant.items():
            if symbols_in([value]) - constant:
                yield f"the {role} of the steps of {item.estimate} moves; expected one made of parameters"
        if any(symbols_in([end]) - constant for end in item.box):
            yield f"the box of {item.estimate} moves; expected one made of parameters"
        rows = symbols_in(map(ca.SX, (piece for row in item.rows for piece in row)))
        for name, state in item.states.items():
            if rows & symbols_in([state]):
                yield f"the rows of {item.estimate} hold {name} itself; expected what is measured or stored"
    for relation in part.relations:
        momentum = ca.Function("momentum", ca.symvar(relation.momentum), [relation.momentum])
        if codes(momentum) & (JUMPS | KINKS | EDGES):
            yield "the momentum of a relation jumps or has a kink, so that it has no derivative; expected a smooth one"
        flowing = symbols_in(variable.symbol for variable in loop.flowing)
        if symbols_in([relation.momentum]) - flowing - constant:
            yield (
                "the momentum of a relation holds more than what the plant moves between samples and constants: the "
                "time, or what jumps at a sample; expected states of the plant"
            )


def stepping(claim: Claim) -> list[Leaf]:
    """What sources declare to be constant between steps, such as a load."""
    resolver = claim.diagram.resolver
    return [leaf for (block, port, _), leaf in resolver.trajectories.items() if resolver.steps(block, port)]


def _misshapen(part: SampledPart, own: Mapping[str, SX]) -> Iterator[str]:
    spoken = (name for item in part.steps for name in item.names)
    for name in (*spoken, *(item.state for item in part.kept)):
        if name not in own:
            yield f"certificate() speaks of {name}, which is none of its sampled states; {nearest(name, own)}"
            return
    for item in part.steps:
        size = ca.SX(item.theta).numel()
        wanted = [("theta", item.theta), ("true", item.true), ("gain", item.gain)]
        wanted += [(f"row {place}", h) for place, (h, _) in enumerate(item.rows)]
        wanted += [("end of the box", end) for end in item.box]
        for what, piece in wanted:
            if ca.SX(piece).shape != (size, 1):
                yield f"the steps of {item.estimate}: expected a {what} of {size} x 1, found {_size(piece.shape)}"
        if sum(item.parts) != size or min(item.parts, default=0) < 1:
            yield f"the steps of {item.estimate}: expected parts that make up {size} parameters, found {item.parts}"
        if any(y.shape != (len(item.parts), 1) for _, y in item.rows):
            yield f"the steps of {item.estimate}: expected {len(item.parts)} measured numbers a row, found others"
        if not ca.SX(item.floor).is_scalar():
            yield f"the steps of {item.estimate}: expected one floor, found {_size(item.floor.shape)}"
        if len(item.box) not in (0, 2):
            yield f"the steps of {item.estimate}: expected a box of two ends, found {len(item.box)}"
        if isinstance(item, LeastSquaresSteps):
            yield from _unfit_memory(item)
        for name, symbol in item.states.items():
            if own[name].shape != symbol.shape or not ca.is_equal(symbol, own[name], 2):
                start = "" if name == item.estimate else f" for {name}"
                yield f"the steps of {item.estimate} start{start} from something else than that state"
    for memory in part.kept:
        if not ca.SX(memory.when).is_scalar():
            yield f"{memory.state} is stored when {_size(memory.when.shape)} numbers say so; expected one"
        if not memory.fits(own[memory.state]):
            shape, one = own[memory.state].shape, memory.newest.shape
            yield f"{memory.state} is {_size(shape)}, which is no whole number of {_size(one)}"
    for term in (*part.storage, *part.decrease, *part.residual):
        vector, weight = map(ca.SX, term.pieces)
        if not vector.is_column() or weight.shape not in (vector.shape, (1, 1)):
            yield "expected columns with a diagonal weight, found other shapes"
    for relation in part.relations:
        if not relation.momentum.is_column() or relation.momentum.shape != relation.rest.shape:
            yield "expected the momentum and the rest of a relation to be columns of one length"


def _unfit_memory(item: LeastSquaresSteps) -> Iterator[str]:
    of = f"the steps of {item.estimate}"
    if len(item.states) != len(item.names):
        yield f"{of}: expected their memory to be a state of its own, found {item.memory}"
    if not ca.SX(item.retention).is_scalar():
        yield f"{of}: expected one retention, found {_size(item.retention.shape)}"
    size = packed_size(item.parts)
    if item.gathered.shape != (size, 1):
        yield f"{of}: expected lower triangles of {size} x 1, found {_size(item.gathered.shape)}"


def _size(shape: Sequence[int]) -> str:
    return f"{shape[0]} x {shape[1]}"
