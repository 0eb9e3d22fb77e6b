"""Names for the terms of a claim, printed from the expressions; names given by an author are not used."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, final

import casadi as ca

from dmframe.block.certificate import SX, Certificate, Clipped, Lemma, NormSquare
from dmframe.common.errors import DmframeError
from dmframe.common.text import Text, joined, name_of
from dmframe.exact import zero_test
from dmframe.formula.formula import Formula
from dmframe.formula.law import ROLES, PrintedLaw, PrintedTerm
from dmframe.formula.tree import Unprinted

_DEEP: Final = 1000


def labelled(stated: Mapping[str, Certificate], laws: Mapping[str, PrintedLaw]) -> dict[str, Certificate]:
    """Certificates with names for their terms, one name for each vector.

    Different vectors with the same printed text are distinguished by their block and, within a block, by a number.
    """
    same_text = _same_text(stated, laws)
    return {name: _named(name, certificate, laws[name], same_text) for name, certificate in stated.items()}


@final
@dataclass
class _SameText:
    """One of the different vectors with the same printed text, and the blocks that use it."""

    vector: SX
    blocks: set[str]


def _same_text(stated: Mapping[str, Certificate], laws: Mapping[str, PrintedLaw]) -> Mapping[str, Sequence[_SameText]]:
    """The different vectors of each text."""
    found = defaultdict[str, list[_SameText]](list)
    for name, certificate in stated.items():
        for text, vector in _written(certificate, laws[name]):
            known = next((item for item in found[text] if not _differ(item.vector, vector)), None)
            if known is None:
                found[text].append(_SameText(vector, {name}))
            else:
                known.blocks.add(name)
    return found


def _written(certificate: Certificate, law: PrintedLaw) -> Iterator[tuple[str, SX]]:
    """Each vector of a certificate, with its printed text."""
    for role in ROLES:
        for term, line in zip(getattr(certificate, role), getattr(law, role), strict=True):
            yield line.vector.text, _vector(term)
            if isinstance(term, NormSquare) and line.by is not None:
                yield line.by.text, ca.SX(term.by)
    for item, formulas in zip(certificate.linear, law.linear, strict=True):
        yield from ((formula.text, ca.SX(z)) for z, formula in zip(item.bounded, formulas, strict=True))


def _vector(term: Any) -> SX:
    """Vector to which the name of a term refers."""
    if isinstance(term, Lemma):
        return ca.SX(term.first) - ca.SX(term.second)
    return ca.SX(term.other if isinstance(term, Clipped) else term.vector)


def _named(
    name: str, certificate: Certificate, law: PrintedLaw, same_text: Mapping[str, Sequence[_SameText]]
) -> Certificate:
    def full(formula: Formula, vector: SX) -> Text:
        if len(same_text[formula.text]) == 1:
            return Text(formula)
        own = [item for item in same_text[formula.text] if name in item.blocks]
        place = next(k for k, item in enumerate(own, 1) if not _differ(item.vector, vector))
        return Text(formula if len(own) == 1 else _numbered(formula, place), f" ({name})")

    def named(terms: Sequence[Any], printed: Sequence[PrintedTerm]) -> tuple[Any, ...]:
        return tuple(_with(term, line, full) for term, line in zip(terms, printed, strict=True))

    driven = tuple(
        replace(item, of=tuple(full(f, ca.SX(z)) for f, z in zip(formulas, item.bounded, strict=True)))
        for item, formulas in zip(certificate.linear, law.linear, strict=True)
    )
    return replace(
        certificate,
        storage=named(certificate.storage, law.storage),
        dissipation=named(certificate.dissipation, law.dissipation),
        residual=named(certificate.residual, law.residual),
        errors=named(certificate.errors, law.errors),
        linear=driven,
    )


def _numbered(formula: Formula, place: int) -> Text:
    """``expression 2 of y, x``, or ``x no. 2``."""
    if isinstance(formula.node, Unprinted) and formula.node.names:
        return Text(f"expression {place} of ", joined([name_of(name) for name in formula.node.names]))
    return Text(formula, f" no. {place}")


def _with(term: Any, line: PrintedTerm, full: Callable[[Formula, SX], Text]) -> Any:
    named = replace(term, of=full(line.vector, _vector(term)))
    if isinstance(term, NormSquare) and line.by is not None:
        return replace(named, by_of=full(line.by, ca.SX(term.by)))
    return named


def _differ(one: SX, other: SX) -> bool:
    """True if two expressions differ in shape or value; if they cannot be compared, they count as different."""
    if one.shape != other.shape:
        return True
    if ca.is_equal(one, other, _DEEP):
        return False
    symbols = ca.vertcat(*ca.symvar(ca.vertcat(ca.vec(one), ca.vec(other))))
    try:
        return not zero_test(ca.Function("difference", [symbols], [ca.densify(one - other)]), trials=1).zero
    except DmframeError:
        return True
