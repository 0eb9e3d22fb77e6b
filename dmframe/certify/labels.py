"""Names for the terms of a claim, printed from the expressions themselves; an author's own are not read."""

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
    """Certificates whose terms bear their names, one name for one vector: two that print alike are
    distinguished by their block, and within a block by a number, so that a name identifies a vector.
    """
    alike = _alike(stated, laws)
    return {name: _named(name, certificate, laws[name], alike) for name, certificate in stated.items()}


@final
@dataclass
class _Alike:
    """One of the different vectors that print as one text, and the blocks that write it."""

    vector: SX
    blocks: set[str]


def _alike(stated: Mapping[str, Certificate], laws: Mapping[str, PrintedLaw]) -> Mapping[str, Sequence[_Alike]]:
    """The different vectors of each text."""
    found = defaultdict[str, list[_Alike]](list)
    for name, certificate in stated.items():
        for text, vector in _written(certificate, laws[name]):
            known = next((item for item in found[text] if not _differ(item.vector, vector)), None)
            if known is None:
                found[text].append(_Alike(vector, {name}))
            else:
                known.blocks.add(name)
    return found


def _written(certificate: Certificate, law: PrintedLaw) -> Iterator[tuple[str, SX]]:
    """Each vector of a certificate, with how it prints."""
    for role in ROLES:
        for term, line in zip(getattr(certificate, role), getattr(law, role), strict=True):
            yield line.vector.text, _vector(term)
            if isinstance(term, NormSquare) and line.by is not None:
                yield line.by.text, ca.SX(term.by)
    for item, formulas in zip(certificate.linear, law.linear, strict=True):
        yield from ((formula.text, ca.SX(z)) for z, formula in zip(item.bounded, formulas, strict=True))


def _vector(term: Any) -> SX:
    """What the name of a term names."""
    if isinstance(term, Lemma):
        return ca.SX(term.first) - ca.SX(term.second)
    return ca.SX(term.other if isinstance(term, Clipped) else term.vector)


def _named(name: str, certificate: Certificate, law: PrintedLaw, alike: Mapping[str, Sequence[_Alike]]) -> Certificate:
    def full(formula: Formula, vector: SX) -> Text:
        if len(alike[formula.text]) == 1:
            return Text(formula)
        own = [item for item in alike[formula.text] if name in item.blocks]
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
    """True for what differs, in shape or somewhere; what cannot be compared counts as different."""
    if one.shape != other.shape:
        return True
    if ca.is_equal(one, other, _DEEP):
        return False
    symbols = ca.vertcat(*ca.symvar(ca.vertcat(ca.vec(one), ca.vec(other))))
    try:
        return not zero_test(ca.Function("difference", [symbols], [ca.densify(one - other)]), trials=1).zero
    except DmframeError:
        return True
