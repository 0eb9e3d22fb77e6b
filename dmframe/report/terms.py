"""V and dV/dt term by term, with symbolic and numeric weights."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from typing import Any, Final, final

import casadi as ca
import numpy as np

from dmframe.block.certificate import SX, Clipped, InformationSquare, Lemma, LogDet, Potential
from dmframe.block.parameter import Spec
from dmframe.block.port import Signal, State
from dmframe.certify.claim import Claim, Part
from dmframe.common.names import latex_name
from dmframe.diagram.closed_loop import Parameter
from dmframe.diagram.truths import value_of
from dmframe.diagram.view import owners_of
from dmframe.formula import Line, PrintedLaw, PrintedTerm
from dmframe.formula.robot import CONSTANTS
from dmframe.formula.tree import Name, Node
from dmframe.report.parts import Row

FEW = 4
"""Largest number of elements of a diagonal that are listed one by one."""
FEW_OF_MATRIX = 9
"""Largest number of elements of a matrix that are listed one by one."""
_LETTERS: Final[Mapping[type, str]] = {
    Lemma: r"\ell",
    Clipped: r"\varepsilon",
    Potential: "U",
    LogDet: r"\Delta",
}
_WHOLE: Final = ("lemma", "clipped", "potential", "log det")
"""Kinds of terms with their own symbol in the formula."""


@final
@dataclass(frozen=True)
class TermRow:
    """Term of V or of dV/dt.

    Parameters
    ----------
    symbol
        Symbol of the weight (W_i, D_i), or of the term itself for a lemma, a potential or a log-det divergence; LaTeX.
    of
        Vector in the square, or argument of a lemma, LaTeX.
    factor
        ``kappa`` or ``1``, as in the JSON.
    weight
        Weight in the symbols of the block, LaTeX.
    value
        Weight at the parameter values of the graph.
    by
        Norm that multiplies a square, LaTeX; may be empty.
    metric
        Information matrix of a square, LaTeX; may be empty.
    beside
        Limit of a potential, or true matrix of a log-det divergence, LaTeX; may be empty.
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
    beside: str = ""


@final
@dataclass(frozen=True)
class Legend:
    """Symbol in the weights: LaTeX, parameter or signal, value, unit."""

    symbol: str
    label: str
    value: str
    unit: str


@final
@dataclass(frozen=True)
class Terms:
    """V and dV/dt as formulas and tables, with a legend of the symbols."""

    V: tuple[Row, ...]
    rate: tuple[Row, ...]
    storage: tuple[TermRow, ...]
    dissipation: tuple[TermRow, ...]
    residual: tuple[TermRow, ...]
    projections: tuple[tuple[str, str], ...]
    consumption: str
    definitions: tuple[Row, ...]
    legend: tuple[Legend, ...]


def terms_of(claim: Claim) -> Terms:
    """Print the terms of a certificate in the symbols of its blocks."""
    laws = claim.laws
    storage = _numbered(claim, laws, "storage", "W")
    dissipation = _numbered(claim, laws, "dissipation", "D")
    residual = _numbered(claim, laws, "residual", "E")
    projections = tuple((rf"\pi_{{{k}}}", p.name) for k, p in enumerate(claim.loop.projections, start=1))
    consumed = [law.consumption.whole.latex for law in laws.values() if law.consumption is not None]
    lost = [(row, _formula(row)) for row in dissipation]
    left = [(row, _formula(row)) for row in residual]
    kappa = "" if claim.kappa.is_constant() else r"\kappa\,"
    gained = [rf"+ {kappa}{symbol}" for symbol, _ in projections] + [f"+ {term}" for term in consumed]
    named = _used(claim, laws)
    return Terms(
        V=(Row("V", "= " + _sum([(row, rf"\tfrac12 {_formula(row)}") for row in storage], "")),),
        rate=(Row(r"\dot V", "= " + " ".join([_sum(lost, "-") or "0", *[_sum(left, "+")] * bool(left), *gained])),),
        storage=storage,
        dissipation=dissipation,
        residual=residual,
        projections=projections,
        consumption=" + ".join(consumed),
        definitions=tuple(
            rows_of_lines([line for _, law, names in named for line in law.definitions if line.name in names])
        ),
        legend=tuple(_legend(claim, named)),
    )


def rows_of_lines(lines: Sequence[Line]) -> list[Row]:
    """Equations as rows, without duplicates."""
    rows = (Row(line.left.latex, f"= {line.right.latex}") for line in lines)
    return list(dict.fromkeys(rows))


def _formula(row: TermRow) -> str:
    if row.kind in _WHOLE:
        return row.symbol
    return rf"{row.by}|{row.of}|^2_{{{row.symbol}{row.metric}}}"


def _sum(rows: Sequence[tuple[TermRow, str]], sign: str) -> str:
    """Sum of terms, kappa written with each term of the servo level so that lines can break."""
    lead, text = sign, ""
    for row, term in rows:
        text += f" {lead} " + (r"\kappa\, " if row.factor == "kappa" else "") + term
        lead = sign or "+"
    return text.strip().replace(r"\kappa\, \tfrac12", r"\tfrac{\kappa}{2}")


def _numbered(claim: Claim, laws: Mapping[str, PrintedLaw], role: str, letter: str) -> tuple[TermRow, ...]:
    rows, counts = list[TermRow](), {letter: 0} | dict.fromkeys(_LETTERS.values(), 0)
    for part in claim.parts:
        for term, printed in zip(getattr(part.certificate, role), getattr(laws[part.block], role), strict=True):
            mine = _LETTERS.get(type(term), letter)
            counts[mine] += 1
            rows.append(_row(claim, part, term, printed, f"{mine}_{{{counts[mine]}}}"))
    return tuple(rows)


def _row(claim: Claim, part: Part, term: Any, printed: PrintedTerm, symbol: str) -> TermRow:
    by = rf"|{printed.by.latex}|\, " if printed.kind == "norm square" and printed.by is not None else ""
    weight = term.width if isinstance(term, Clipped) else term.weight
    return TermRow(
        block=part.block,
        kind=printed.kind if printed.kind in (*_WHOLE, "gathered") else "square",
        symbol=symbol,
        of=printed.vector.latex,
        factor="1" if part.cascade or claim.kappa.is_constant() else "kappa",
        weight=printed.weight.latex,
        value=_value(claim, ca.SX(weight)),
        by=by,
        metric=r"\, G" if isinstance(term, InformationSquare) else "",
        beside=printed.by.latex if isinstance(term, Potential | LogDet) and printed.by is not None else "",
    )


def _value(claim: Claim, weight: SX) -> str:
    """Weight at the parameter values of the graph, if it depends on parameters only."""
    loop = claim.loop
    function = ca.Function("value", [loop.p], loop.joined([ca.vec(ca.densify(weight))]), {"allow_free": True})
    if function.has_free():
        return "varies with the pose"
    numbers = function(loop.p_values).full().ravel()
    return shown(numbers if weight.is_column() else numbers.reshape(weight.shape, order="F"))


Used = tuple[str, PrintedLaw, list[str]]
"""Block, its law, and the names in its weights."""


def _used(claim: Claim, laws: Mapping[str, PrintedLaw]) -> list[Used]:
    """Names in the weights of each block, with those in their definitions."""
    found = list[Used]()
    for part in claim.parts:
        law = laws[part.block]
        formulas = [term.weight for term in (*law.storage, *law.dissipation, *law.residual)]
        formulas += [] if law.consumption is None else [law.consumption.weight]
        names = list(dict.fromkeys(name for formula in formulas for name in names_in(formula.node)))
        for line in law.definitions[::-1]:
            if line.name in names:
                names += [name for name in names_in(line.right.node) if name not in names]
        found.append((part.block, law, names))
    return found


def names_in(item: Any) -> Iterator[str]:
    """Names in a formula, from left to right."""
    if isinstance(item, Name):
        yield item.name
    elif isinstance(item, tuple):
        for part in item:
            yield from names_in(part)
    elif isinstance(item, Node) and is_dataclass(item):
        for field in fields(item):
            yield from names_in(getattr(item, field.name))


def _legend(claim: Claim, used: Sequence[Used]) -> Iterator[Legend]:
    """Legend of the names in the weights, except those with a printed definition."""
    seen, parameters = set[tuple[str, str]](), {item.label: item for item in claim.loop.parameters}
    for block, law, names in used:
        defined, owners = {line.name for line in law.definitions}, owners_of(claim.diagram, block, claim.truths)
        for name in names:
            row = _meaning(claim, parameters, block, name, owners.get(name))
            if row is None or (name, row.label) in seen or (name in defined and row.label not in parameters):
                continue
            seen.add((name, row.label))
            yield row


def _meaning(
    claim: Claim, parameters: Mapping[str, Parameter], block: str, name: str, owner: str | None
) -> Legend | None:
    """Legend of a block parameter, a true value of another block, a robot constant or a signal."""
    model, symbol = claim.diagram.models[block], latex_name(name)
    if name in model.parameters:
        label = f"{block}.{name}"
        return Legend(symbol, label, _number(claim, parameters[label]), parameters[label].unit)
    if owner is not None:
        value = claim.loop.joined([value_of(claim.diagram, owner, name, claim.truths)])[0]
        same = [item for item in parameters.values() if _is(item.symbol, value)]
        if same:
            return Legend(symbol, same[0].label, _number(claim, same[0]), same[0].unit)
        unit = next(port.unit for port in model.block.truth if port.name == name)
        return Legend(symbol, f"{owner}.{name}", _value(claim, value), unit)
    constant = next((f"robot.{key}" for key, sign in CONSTANTS.items() if sign == name), "")
    if constant in parameters:
        return Legend(symbol, constant, _number(claim, parameters[constant]), parameters[constant].unit)
    signals: list[Signal | State] = [*model.block.inputs, *model.block.outputs, *model.block.states]
    units = [item.unit for item in signals if item.name == name]
    return Legend(symbol, f"{block}.{name}", "a signal", units[0]) if units else None


def _number(claim: Claim, parameter: Parameter) -> str:
    """Value of a parameter; a matrix as given to its block, not as the vector of the loop."""
    block, _, key = parameter.label.partition(".")
    values = claim.diagram.models[block].values if block in claim.diagram.models else {}
    return shown(values.get(key, parameter.value))


def _is(symbol: SX, value: SX) -> bool:
    return bool(symbol.shape == value.shape and ca.is_equal(symbol, value))


def shown(values: np.ndarray) -> str:
    """Format numbers: one value if all are equal, a short list, else their range."""
    values = np.atleast_1d(values)
    if values.size == 0:
        return "none"
    if values.ndim == 2 and min(values.shape) > 1:
        return _rows(values)
    values = values.ravel()
    if np.all(values == values[0]):
        return f"{values[0]:.4g}"
    if values.size <= FEW:
        return ", ".join(f"{value:.4g}" for value in values)
    return f"{values.size} values {_range(values)}"


def _rows(values: np.ndarray) -> str:
    """Format a matrix: a small one as in a graph, else its size and ranges on and off the diagonal."""
    if values.size <= FEW_OF_MATRIX:
        return "[" + ", ".join("[" + ", ".join(f"{value:.4g}" for value in row) + "]" for row in values) + "]"
    rows, columns = values.shape
    if rows != columns or not np.allclose(values, values.T, rtol=1e-12):
        return f"{rows} x {columns}, {_range(values)}"
    others = values[~np.eye(rows, dtype=bool)]
    return f"{rows} x {columns}, diagonal {_range(np.diag(values))}, off the diagonal {_range(others)}"


def _range(values: np.ndarray) -> str:
    least, most = f"{np.min(values):.4g}", f"{np.max(values):.4g}"
    return least if least == most else f"from {least} to {most}"


def parameter_text(value: np.ndarray, spec: Spec) -> str:
    """Format a parameter; a box or a ball with both parts, lists in brackets."""
    between = {"box": "to", "ball": "plus or minus"}.get(spec.form)
    if between is None:
        return shown(value)
    parts = [shown(value[..., end]) for end in (0, 1)]
    return f" {between} ".join(f"[{part}]" if " " in part else part for part in parts)
