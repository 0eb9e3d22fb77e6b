"""The form of a certificate: terms of the known kinds, of shapes that fit, which the conditions can be decided on."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final, final

import casadi as ca

from dmframe.certificate import (
    MONOTONE,
    SX,
    Assumption,
    Barrier,
    Certificate,
    Clipped,
    Consumed,
    Driven,
    Gathered,
    Lemma,
    LogDet,
    NormSquare,
    Potential,
    Square,
)
from dmframe.errors import DmframeError, nearest
from dmframe.formula.law import ROLES

STORED: Final = (Square, Gathered, Potential, LogDet)
DISSIPATED: Final = (Square, NormSquare, Lemma, Gathered)
BOUNDED: Final = (Square, NormSquare, Clipped)
"""Terms by what they may be; exactly these types, since a subclass could say anything of itself."""


@final
class NotApplicableError(DmframeError):
    """A diagram that makes no claim: a block without a certificate, or a truth that nobody knows."""


def check_form(name: str, certificate: Certificate) -> None:
    """Hold a certificate to the shapes that the conditions decide on; raises `NotApplicableError`."""
    for text in _ill_formed(certificate):
        raise NotApplicableError(f"{name}: {text}")


def _ill_formed(certificate: Certificate) -> Iterator[str]:
    terms = certificate.dissipation
    if not all(type(term) in STORED for term in certificate.storage):
        yield (
            "expected each term of the storage to be a Square, Gathered, a Potential or a LogDet; nothing else is "
            "known to be positive"
        )
    if not all(type(term) in DISSIPATED for term in terms):
        yield "expected each term of the dissipation to be a Square, a NormSquare, a Lemma or Gathered"
    if any(isinstance(term, Square) and term.positive for term in certificate.excess):
        yield "expected no weight of the excess to be positive by assumption: it is a bound that is asked for there"
    if not all(type(term) in BOUNDED for term in certificate.excess):
        yield "expected each term of the excess to be a Square, a NormSquare or a Clipped; nothing else has a bound"
    if not all(type(term) is Square for term in certificate.errors):
        yield "expected each of the errors to be a Square"
    for what, pieces in _stated(certificate):
        if any(isinstance(piece, ca.MX) for piece in pieces):
            yield f"{what}: expected expressions of its u, x, p and truth, found an MX; write constants as ca.DM"
    for term in (*certificate.storage, *terms, *certificate.excess, *certificate.errors):
        pieces, where = [ca.SX(piece) for piece in term.pieces], term.of or f"a {type(term).__name__}"
        if isinstance(term, Lemma) and term.phi not in MONOTONE:
            yield f"{where}: {term.phi} is not known to be monotone; {nearest(term.phi, MONOTONE)}"
        if isinstance(term, Square) and term.positive and not _is_said(term.positive):
            yield f"{where}: expected positive to be a text of one line, found {term.positive!r:.60}"
        if not _fits(term, pieces):
            yield f"{where}: expected columns of one length, or a square matrix of weights, found other shapes"
    consumed = certificate.consumes
    if consumed is not None and type(consumed) is not Consumed:
        yield f"expected consumes to be Consumed(vector, c), found {type(consumed).__name__}"
    elif consumed is not None and not (ca.SX(consumed.vector).is_column() and ca.SX(consumed.c).is_scalar()):
        yield "expected a cascade to consume a scalar c of a column, found other shapes"
    if not ca.SX(certificate.supply).is_scalar():
        rows, columns = ca.SX(certificate.supply).shape
        yield f"expected a scalar supply, found {rows} x {columns}"
    yield from _ill_driven(certificate.driven)
    for barrier in certificate.barriers:
        if type(barrier) is not Barrier:
            yield f"expected each of barriers to be a Barrier, found {type(barrier).__name__}"
        elif not _columns([ca.SX(piece) for piece in barrier.pieces]):
            yield "expected what a barrier is made of to be columns of one length or scalars, found other shapes"
    if certificate.pays:
        if consumed is not None:
            yield "a cascade consumes and cannot pay; expected one of consumes and pays"
        paying = terms[: len(certificate.pays)]
        if len(certificate.pays) > len(terms):
            yield f"pays has {len(certificate.pays)} shares, expected one for each of {len(terms)} dissipated squares"
        yield from _ill_paid(certificate)
        if not all(isinstance(term, Square) and ca.SX(term.weight).is_column() for term in paying):
            yield "whoever pays for a cascade must dissipate squares with diagonal weights alone"
        if any(isinstance(term, Square) and term.positive for term in paying):
            yield "nobody pays for a cascade with a weight that is positive by assumption"


def _stated(certificate: Certificate) -> Iterator[tuple[str, Sequence[SX]]]:
    """All expressions of a certificate, by its fields."""
    for role in (*ROLES, "driven", "barriers"):
        yield role, [piece for term in getattr(certificate, role) for piece in term.pieces]
    consumed = certificate.consumes
    yield "consumes", [] if consumed is None else [consumed.vector, consumed.c]
    yield "supply and pays", [certificate.supply, *certificate.pays]
    yield "truth", list(certificate.truth.values())


def _ill_paid(certificate: Certificate) -> Iterator[str]:
    """What pays has the length of what it composes: of a shorter one, each element would pay more than once."""
    vectors = [ca.SX(term.pieces[0]) for term in certificate.dissipation[: len(certificate.pays)]]
    lengths = {vector.numel() for vector in vectors}
    shares = {ca.SX(share).numel() for share in certificate.pays}
    if len(lengths) > 1 or not shares <= lengths | {1}:
        found = ", ".join(map(str, sorted(lengths | shares)))
        yield f"expected the squares that pay, and their shares, to be of one length, found {found}"


def _ill_driven(driven: Sequence[object]) -> Iterator[str]:
    for item in driven:
        if type(item) is not Driven:
            yield f"expected each of driven to be a Driven, found {type(item).__name__}"
            continue
        count = len(item.vectors)
        if not count or len(item.rates) != count or any(len(row) != count for row in item.rates):
            yield f"expected {count} rows of {count} rates for the {count} vectors that are driven, found other sizes"
        elif len(item.inputs) not in (0, count):
            yield f"expected no input or {count} for the {count} vectors that are driven, found {len(item.inputs)}"
        elif item.inputs and not (item.otherwise and all(isinstance(c, Assumption) for c in item.otherwise)):
            yield "expected assumptions, as otherwise, beside the inputs of what is driven, found none or conditions"
        elif not _columns([ca.SX(piece) for piece in item.pieces]):
            yield "expected what is driven, and its rates, to be columns of one length or scalars"


def _fits(term: object, pieces: Sequence[SX]) -> bool:
    """Columns of one length or scalars; some terms have a matrix of weights, or a vector of another length."""
    if isinstance(term, Gathered):
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


def _is_said(text: str) -> bool:
    return bool(text.strip()) and text.isprintable()


def _columns(pieces: Sequence[SX]) -> bool:
    rows = max(piece.shape[0] for piece in pieces)
    return all(piece.shape in ((rows, 1), (1, 1)) for piece in pieces)
