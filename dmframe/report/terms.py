"""V and dV/dt term by term: each square with its weight in symbols and in numbers."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from typing import Any, final

import casadi as ca
import numpy as np

from dmframe.certificate import SX, Clipped, Gathered, Lemma
from dmframe.certify.claim import Claim, Part
from dmframe.formula import Line, PrintedLaw, PrintedTerm
from dmframe.formula.names import latex_name
from dmframe.formula.tree import Name, Node
from dmframe.report.laws import Row

FEW = 4
"""Elements of a diagonal up to which each is written out."""


@final
@dataclass(frozen=True)
class TermRow:
    """One term of V or of the dissipation.

    Parameters
    ----------
    symbol
        W_i, D_i or l_i, by which the formula calls its weight (or, of a lemma, the term itself); LaTeX.
    of
        The vector whose square it is, or the difference of a lemma, LaTeX.
    factor
        ``kappa`` or ``1``, as in the JSON.
    weight
        The weight in the block's symbols, LaTeX.
    value
        The weight at the graph's numbers.
    by
        The norm that multiplies a square, LaTeX; empty for most.
    metric
        The matrix that weighs a square beside its weight, LaTeX; empty for most.
    """

    block: str
    kind: str
    symbol: str
    of: str
    factor: str
    weight: str
    value: str
    by: str = ""
    metric: str = ""


@final
@dataclass(frozen=True)
class Legend:
    """A symbol of the weights: LaTeX, the parameter that it stands for, its value and unit."""

    symbol: str
    label: str
    value: str
    unit: str


@final
@dataclass(frozen=True)
class Terms:
    """V and dV/dt as formulas, as tables, and with what their symbols mean."""

    V: tuple[Row, ...]
    rate: tuple[Row, ...]
    storage: tuple[TermRow, ...]
    dissipation: tuple[TermRow, ...]
    excess: tuple[TermRow, ...]
    projections: tuple[tuple[str, str], ...]
    consumption: str
    definitions: tuple[Row, ...]
    legend: tuple[Legend, ...]


def terms_of(claim: Claim) -> Terms:
    """Write out what a claim says, in the words of its blocks' laws."""
    laws = claim.laws
    storage = _numbered(claim, laws, "storage", "W")
    dissipation = _numbered(claim, laws, "dissipation", "D")
    excess = _numbered(claim, laws, "excess", "E")
    projections = tuple((rf"\pi_{{{k}}}", p.name) for k, p in enumerate(claim.loop.projections, start=1))
    consumed = [law.consumption.whole.latex for law in laws.values() if law.consumption is not None]
    lost = [(row, _formula(row)) for row in dissipation]
    left = [(row, _formula(row)) for row in excess]
    gained = [rf"+ {_kappa(claim)}{symbol}" for symbol, _ in projections] + [f"+ {term}" for term in consumed]
    named = _used(claim, laws)
    return Terms(
        V=(Row("V", "= " + _sum([(row, rf"\tfrac12 {_formula(row)}") for row in storage], "")),),
        rate=(Row(r"\dot V", "= " + " ".join([_sum(lost, "-") or "0", *[_sum(left, "+")] * bool(left), *gained])),),
        storage=storage,
        dissipation=dissipation,
        excess=excess,
        projections=projections,
        consumption=" + ".join(consumed),
        definitions=tuple(rows_of_lines([item for _, law, names in named for item in _definitions(law, names)])),
        legend=tuple(_legend(claim, named)),
    )


def rows_of_lines(lines: Sequence[Line]) -> list[Row]:
    """Equations as rows, each once."""
    rows = (Row(line.left.latex, f"= {line.right.latex}") for line in lines)
    return list(dict.fromkeys(rows))


def _formula(row: TermRow) -> str:
    if row.kind in ("lemma", "clipped"):
        return row.symbol
    return rf"{row.by}|{row.of}|^2_{{{row.symbol}{row.metric}}}"


def _kappa(claim: Claim) -> str:
    return "" if claim.kappa.is_constant() else r"\kappa\,"


def _sum(rows: Sequence[tuple[TermRow, str]], sign: str) -> str:
    """Kappa stands with each term of the servo level, so that lines may break between them."""
    lead, text = sign, ""
    for row, term in rows:
        text += f" {lead} " + (r"\kappa\, " if row.factor == "kappa" else "") + term
        lead = sign or "+"
    return text.strip().replace(r"\kappa\, \tfrac12", r"\tfrac{\kappa}{2}")


def _numbered(claim: Claim, laws: Mapping[str, PrintedLaw], role: str, letter: str) -> tuple[TermRow, ...]:
    rows, counts = list[TermRow](), {letter: 0, r"\ell": 0, r"\varepsilon": 0}
    for part in claim.parts:
        for term, printed in zip(getattr(part.certificate, role), getattr(laws[part.block], role), strict=True):
            mine = r"\ell" if isinstance(term, Lemma) else r"\varepsilon" if isinstance(term, Clipped) else letter
            counts[mine] += 1
            rows.append(_row(claim, part, term, printed, f"{mine}_{{{counts[mine]}}}"))
    return tuple(rows)


def _row(claim: Claim, part: Part, term: Any, printed: PrintedTerm, symbol: str) -> TermRow:
    by = rf"|{printed.by.latex}|\, " if printed.kind == "norm square" and printed.by is not None else ""
    weight = term.width if isinstance(term, Clipped) else term.weight
    return TermRow(
        block=part.block,
        kind=printed.kind if printed.kind in ("lemma", "clipped", "gathered") else "square",
        symbol=symbol,
        of=printed.vector.latex,
        factor="1" if part.cascade or claim.kappa.is_constant() else "kappa",
        weight=printed.weight.latex,
        value=_value(claim, ca.SX(weight)),
        by=by,
        metric=r"\, G" if isinstance(term, Gathered) else "",
    )


def _value(claim: Claim, weight: SX) -> str:
    """The weight's elements at the graph's numbers; one where all are equal, their range where they are many."""
    loop = claim.loop
    function = ca.Function("value", [loop.p], loop.joined([ca.vec(ca.densify(weight))]), {"allow_free": True})
    return "varies with the pose" if function.has_free() else shown(function(loop.p_values).full().ravel())


Used = tuple[str, PrintedLaw, list[str]]
"""A block, its law, and the names that its weights hold."""


def _used(claim: Claim, laws: Mapping[str, PrintedLaw]) -> list[Used]:
    """What the weights of each block are made of, named parts with what they are made of in turn."""
    found = list[Used]()
    for part in claim.parts:
        law = laws[part.block]
        formulas = [term.weight for term in (*law.storage, *law.dissipation, *law.excess)]
        formulas += [] if law.consumption is None else [law.consumption.weight]
        names = list(dict.fromkeys(name for formula in formulas for name in names_in(formula.node)))
        for line in law.definitions[::-1]:
            if line.name in names:
                names += [name for name in names_in(line.right.node) if name not in names]
        found.append((part.block, law, names))
    return found


def names_in(item: Any) -> Iterator[str]:
    """All names of a formula, from left to right."""
    if isinstance(item, Name):
        yield item.name
    elif isinstance(item, tuple):
        for part in item:
            yield from names_in(part)
    elif isinstance(item, Node) and is_dataclass(item):
        for field in fields(item):
            yield from names_in(getattr(item, field.name))


def _definitions(law: PrintedLaw, names: Sequence[str]) -> Iterator[Line]:
    yield from (line for line in law.definitions if line.name in names)


def _legend(claim: Claim, used: Sequence[Used]) -> Iterator[Legend]:
    """The parameters behind the names: the block's own, or those that another block hands out as a truth."""
    known = {parameter.label: parameter for parameter in claim.loop.parameters}
    told = set[tuple[str, str]]()
    for block, _, names in used:
        for name in names:
            label = f"{block}.{name}"
            parameter = known.get(label) or known.get(_handed_out(claim, name))
            if parameter is None or (name, parameter.label) in told:
                continue
            told.add((name, parameter.label))
            yield Legend(latex_name(name), parameter.label, shown(parameter.value.ravel()), parameter.unit)


def _handed_out(claim: Claim, name: str) -> str:
    """The parameter that an output of this name is."""
    for block, model in claim.diagram.models.items():
        expression = model.equations.outputs.get(name)
        for key, symbol in model.parameters.items():
            if expression is not None and expression.shape == symbol.shape and ca.is_equal(expression, symbol):
                return f"{block}.{key}"
    return ""


def shown(values: np.ndarray) -> str:
    """Numbers for a table."""
    values = np.atleast_1d(values)
    if values.size == 0:
        return "none"
    if np.all(values == values[0]):
        return f"{values[0]:.4g}"
    if values.size <= FEW:
        return ", ".join(f"{value:.4g}" for value in values)
    return f"{values.size} values from {np.min(values):.4g} to {np.max(values):.4g}"
