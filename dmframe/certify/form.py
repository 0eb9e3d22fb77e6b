"""Validity of a certificate: kinds and shapes of its terms; in discrete time, also names and constant expressions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, final

import casadi as ca

from dmframe.block.certificate import (
    MONOTONE,
    SX,
    Assumption,
    Certificate,
    InformationSquare,
    LeastSquaresSteps,
    Lemma,
    LogDet,
    NormSquare,
    Square,
    StableLinear,
)
from dmframe.block.fields import pieces_of
from dmframe.block.model import symbols_in
from dmframe.block.steps import packed_size
from dmframe.common.errors import DmframeError, nearest
from dmframe.formula.law import ROLES
from dmframe.program import EDGES, JUMPS, KINKS, codes

if TYPE_CHECKING:
    from dmframe.certify.claim import Claim, Part
    from dmframe.diagram.pieces import Leaf


@final
class NotApplicableError(DmframeError):
    """A diagram without a claim: a block has no certificate, or a true value is unknown."""


def check_form(name: str, certificate: Certificate) -> None:
    """Check the shapes in a certificate; raises `NotApplicableError`."""
    for text in _ill_formed(certificate):
        raise NotApplicableError(f"{name}: {text}")


def _ill_formed(certificate: Certificate) -> Iterator[str]:
    terms = certificate.dissipation
    if any(isinstance(term, Square) and term.positive for term in certificate.residual):
        yield "expected no weight of the residual to be positive by assumption: a residual needs a bound"
    for what, pieces in _stated(certificate):
        if any(isinstance(piece, ca.MX) for piece in pieces):
            yield f"{what}: expected expressions of its u, x, p and truth, found an MX; write constants as ca.DM"
    for term in (*certificate.storage, *terms, *certificate.residual, *certificate.errors):
        pieces, where = [ca.SX(piece) for piece in term.pieces], term.of or f"a {type(term).__name__}"
        if isinstance(term, Lemma) and term.phi not in MONOTONE:
            yield f"{where}: {term.phi} is not known to be monotone; {nearest(term.phi, MONOTONE)}"
        if isinstance(term, Square) and term.positive and not _is_line(term.positive):
            yield f"{where}: expected positive to be a text of one line, found {term.positive!r:.60}"
        if not _fits(term, pieces):
            yield f"{where}: expected columns of one length, or a square matrix of weights, found other shapes"
    consumed = certificate.consumes
    if consumed is not None and not (ca.SX(consumed.vector).is_column() and ca.SX(consumed.c).is_scalar()):
        yield "expected a cascade to consume a scalar c of a column, found other shapes"
    if not ca.SX(certificate.supply).is_scalar():
        rows, columns = ca.SX(certificate.supply).shape
        yield f"expected a scalar supply, found {rows} x {columns}"
    yield from _wrong_subsystems(certificate.linear)
    for barrier in certificate.barriers:
        if not _columns([ca.SX(piece) for piece in barrier.pieces]):
            yield "expected what a barrier is made of to be columns of one length or scalars, found other shapes"
    if certificate.disturbed:
        squares = certificate.dissipation[: len(certificate.disturbed)]
        diagonal = all(isinstance(term, Square) and ca.SX(term.weight).is_column() for term in squares)
        if len(squares) < len(certificate.disturbed) or not diagonal:
            yield "expected disturbed to have a factor for each of the first dissipated squares, with diagonal weights"
        yield from _wrong_factors(certificate, certificate.disturbed)
    if certificate.dominates:
        if consumed is not None:
            yield "a cascade has consumes and cannot have dominates; expected one of both"
        dominating = terms[: len(certificate.dominates)]
        if len(certificate.dominates) > len(terms):
            factors = len(certificate.dominates)
            yield f"dominates has {factors} factors, expected one for each of {len(terms)} dissipated squares"
        yield from _wrong_factors(certificate, certificate.dominates)
        if not all(isinstance(term, Square) and ca.SX(term.weight).is_column() for term in dominating):
            yield "a certificate with dominates must dissipate squares with diagonal weights only"
        if any(isinstance(term, Square) and term.positive for term in dominating):
            yield "no weight that is positive by assumption can dominate a cascade's cross term"


def _stated(certificate: Certificate) -> Iterator[tuple[str, Sequence[SX]]]:
    """All expressions of a certificate, by its fields."""
    for role in (*ROLES, "linear", "barriers"):
        yield role, list(pieces_of(getattr(certificate, role)))
    yield "consumes", list(pieces_of(certificate.consumes))
    yield "supply and dominates", [certificate.supply, *certificate.dominates]
    yield "disturbed", certificate.disturbed
    yield "truth", list(certificate.truth.values())


def _wrong_factors(certificate: Certificate, stated: Sequence[SX]) -> Iterator[str]:
    """The squares must have the length of the composed vector, so that no element is counted twice."""
    vectors = [ca.SX(term.pieces[0]) for term in certificate.dissipation[: len(stated)]]
    lengths = {vector.numel() for vector in vectors}
    factors = {ca.SX(factor).numel() for factor in stated}
    if len(lengths) > 1 or not factors <= lengths | {1}:
        found = ", ".join(map(str, sorted(lengths | factors)))
        yield f"expected the dominating squares and their factors to be of one length, found {found}"


def _wrong_subsystems(subsystem: Sequence[StableLinear]) -> Iterator[str]:
    for item in subsystem:
        count = len(item.vectors)
        if not count or len(item.rates) != count or any(len(row) != count for row in item.rates):
            yield f"expected {count} rows of {count} rates for the {count} vectors that are driven, found other sizes"
        elif len(item.inputs) not in (0, count):
            yield f"expected no input or {count} for the {count} vectors that are driven, found {len(item.inputs)}"
        elif item.inputs and not (item.otherwise and all(isinstance(c, Assumption) for c in item.otherwise)):
            yield (
                "expected assumptions as otherwise, together with the inputs of a linear subsystem, found none or "
                "conditions"
            )
        elif not _columns([ca.SX(piece) for piece in item.pieces]):
            yield "expected what is subsystem, and its rates, to be columns of one length or scalars"


def _fits(term: object, pieces: Sequence[SX]) -> bool:
    """Columns of equal length or scalars; some terms have a matrix of weights, or a vector of another length."""
    if isinstance(term, InformationSquare):
        vector, weight, memory, regressor, by, forgetting = pieces
        rows, scalars = vector.shape[0], weight.is_scalar() and forgetting.is_scalar()
        fits = memory.shape == (rows, rows) and regressor.shape == (by.shape[0], rows) and by.is_column()
        return bool(scalars and fits)
    if isinstance(term, LogDet):
        matrix, true, weight = pieces
        return bool(matrix.shape == true.shape and matrix.is_square() and weight.is_scalar())
    if isinstance(term, Square | NormSquare):
        if not all(piece.is_column() for piece in pieces[2:]):
            return False
        rows = pieces[0].shape[0]
        return pieces[0].is_column() and pieces[1].shape in ((rows, 1), (1, 1), (rows, rows))
    return _columns(pieces)


def _is_line(text: str) -> bool:
    return bool(text.strip()) and text.isprintable()


def _columns(pieces: Sequence[SX]) -> bool:
    rows = max(piece.shape[0] for piece in pieces)
    return all(piece.shape in ((rows, 1), (1, 1)) for piece in pieces)


def unfit(claim: Claim, part: Part) -> Iterator[str]:
    """Faults in the form of a block's claim."""
    prefix, symbols = f"{part.block}.", claim.sample.symbols
    own = {label.removeprefix(prefix): symbol for label, symbol in symbols.items() if label.startswith(prefix)}
    yield from _inapplicable(part.certificate)
    yield from _misshapen(part, own)
    loop = claim.loop
    constant = loop.constants
    constant |= symbols_in(part.certificate.unknown.values())
    constant |= symbols_in(leaf.symbol for leaf in stepping(claim))  # constant between steps, at which V starts again
    allowed = constant | symbols_in(own.values())
    moving = {s.element_hash(): v.label for v in loop.variables for s in ca.symvar(ca.vec(v.symbol))}
    for term in part.stored:
        for piece in term.pieces:
            for symbol in symbols_in([piece]) - allowed:
                what = moving.get(symbol, "a symbol that is not a parameter")
                yield f"V contains {what}, without its value one sample later; expected its sampled states"
    if symbols_in([ca.SX(term.weight) for term in part.certificate.storage]) - constant:
        yield "the weights of V vary; expected functions of parameters"
    weighed = symbols_in([part.storage]) - constant
    for gained in part.certificate.residual:
        for symbol in symbols_in(map(ca.SX, gained.pieces)) & weighed:
            yield (
                f"the residual contains {moving[symbol]}, which V also contains, so that it could cancel any change "
                "of V; expected a residual without the states of V"
            )
    for item in part.certificate.steps:
        for role, value in item.constant.items():
            if symbols_in([value]) - constant:
                yield f"the {role} of the steps of {item.estimate} varies; expected a function of parameters"
        if any(symbols_in([end]) - constant for end in item.box):
            yield f"the box of {item.estimate} varies; expected a function of parameters"
        rows = symbols_in(map(ca.SX, (piece for row in item.rows for piece in row)))
        for name, state in item.states.items():
            if rows & symbols_in([state]):
                yield f"the rows of {item.estimate} contain {name} itself; expected measured or stored values"
    for relation in part.certificate.plant:
        momentum = ca.Function("momentum", ca.symvar(relation.momentum), [relation.momentum])
        if codes(momentum) & (JUMPS | KINKS | EDGES):
            yield "the momentum of a relation jumps or has a kink, so that it has no derivative; expected a smooth one"
        flowing = symbols_in(variable.symbol for variable in loop.flowing)
        if symbols_in([relation.momentum]) - flowing - constant:
            yield (
                "the momentum of a relation depends on more than continuous states of the plant and constants: on the "
                "time, or on a sampled state; expected continuous states of the plant"
            )


def _inapplicable(certificate: Certificate) -> Iterator[str]:
    """Fields that do not exist in a discrete-time claim."""
    for name in ("linear", "errors", "barriers", "filters", "dominates", "consumes", "task"):
        if getattr(certificate, name):
            yield f"expected no {name} of a block whose stored states are sampled"
    if not ca.SX(certificate.supply).is_zero():
        yield "expected no supply of a block whose stored states are sampled"
    if not all(
        type(term) is Square for term in (*certificate.storage, *certificate.dissipation, *certificate.residual)
    ):
        yield "expected each term over samples to be a Square"


def stepping(claim: Claim) -> list[Leaf]:
    """Sources that declare to be constant between steps, such as a load."""
    resolver = claim.diagram.resolver
    return [leaf for (block, port, _), leaf in resolver.trajectories.items() if resolver.steps(block, port)]


def _misshapen(part: Part, own: Mapping[str, SX]) -> Iterator[str]:
    spoken = (name for item in part.certificate.steps for name in item.names)
    for name in (*spoken, *(item.state for item in part.certificate.delay_lines)):
        if name not in own:
            yield f"certificate() names {name}, which is not one of its sampled states; {nearest(name, own)}"
            return
    for item in part.certificate.steps:
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
                yield f"the steps of {item.estimate} start{start} from another value than that state"
    for memory in part.certificate.delay_lines:
        if not ca.SX(memory.when).is_scalar():
            yield f"{memory.state} is stored when {_size(memory.when.shape)} numbers are set; expected one"
        if not memory.fits(own[memory.state]):
            shape, one = own[memory.state].shape, memory.newest.shape
            yield f"{memory.state} is {_size(shape)}, which is not an integer multiple of {_size(one)}"
    for term in (*part.certificate.storage, *part.certificate.dissipation, *part.certificate.residual):
        vector, weight = map(ca.SX, term.pieces)
        if not vector.is_column() or weight.shape not in (vector.shape, (1, 1)):
            yield "expected columns with a diagonal weight, found other shapes"
    for relation in part.certificate.plant:
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
