"""V and dV/dt term by term: each square with its weight in symbols and in numbers."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, final

import casadi as ca
import numpy as np

from dmframe.certificate import SX, Bounded, Clipped, Dissipated, Gathered, Lemma, NormSquare, Stored
from dmframe.certify.claim import Claim, Part, total
from dmframe.report.expression import expression_latex
from dmframe.report.laws import Row, law_of
from dmframe.report.notation import GREEK, latex, name_latex

FEW = 4
"""Elements of a diagonal up to which each is written out."""

_STATED: Final = re.compile(rf"((?:[A-Za-z]|{'|'.join(sorted(GREEK))})(?:_[A-Za-z0-9]+)?)[.,;:]")


@final
@dataclass(frozen=True)
class TermRow:
    """One term of V or of the dissipation.

    Parameters
    ----------
    symbol
        W_i, D_i or l_i, by which the formula calls its weight (or, of a lemma, the term itself); LaTeX.
    of
        The vector whose square it is, LaTeX; of a lemma, its name as text.
    factor
        ``kappa`` or ``1``, as in the JSON.
    weight
        The weight in the graph's parameters, LaTeX.
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
    legend: tuple[Legend, ...]


def terms_of(claim: Claim) -> Terms:
    """Write out what a claim says."""
    names = Names(claim)
    storage = _numbered(claim, names, "storage", "W")
    dissipation = _numbered(claim, names, "dissipation", "D")
    excess = _numbered(claim, names, "excess", "E")
    projections = tuple((rf"\pi_{{{k}}}", p.name) for k, p in enumerate(claim.loop.projections, start=1))
    consumed = [part.certificate.consumes for part in claim.parts if part.certificate.consumes is not None]
    share = names.weight(total(consumed)) if consumed else ""
    consumption = rf"{rf'({share})' if ' + ' in share else share}\, |\sigma|^2" if share else ""
    lost = [(row, _formula(row)) for row in dissipation]
    left = [(row, _formula(row)) for row in excess]
    gained = [rf"+ {_kappa(claim)}{symbol}" for symbol, _ in projections] + [f"+ {consumption}"] * bool(consumption)
    return Terms(
        V=(Row("V", "= " + _sum([(row, rf"\tfrac12 {_formula(row)}") for row in storage], "")),),
        rate=(Row(r"\dot V", "= " + " ".join([_sum(lost, "-") or "0", *[_sum(left, "+")] * bool(left), *gained])),),
        storage=storage,
        dissipation=dissipation,
        excess=excess,
        projections=projections,
        consumption=consumption,
        legend=names.legend(),
    )


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


def _numbered(claim: Claim, names: Names, role: str, letter: str) -> tuple[TermRow, ...]:
    rows, counts = list[TermRow](), {letter: 0, r"\ell": 0, r"\varepsilon": 0}
    for part in claim.parts:
        for term in getattr(part.certificate, role):
            mine = r"\ell" if isinstance(term, Lemma) else r"\varepsilon" if isinstance(term, Clipped) else letter
            counts[mine] += 1
            rows.append(_row(claim, names, part, term, f"{mine}_{{{counts[mine]}}}"))
    return tuple(rows)


def _row(claim: Claim, names: Names, part: Part, term: Stored | Dissipated | Bounded, symbol: str) -> TermRow:
    factor = "1" if part.cascade or claim.kappa.is_constant() else "kappa"
    if isinstance(term, Lemma):
        weight, value = names.weight(term.weight), names.value(term.weight)
        return TermRow(part.block, "lemma", symbol, term.of, factor, weight, value)
    if isinstance(term, Clipped):
        width = names.weight(term.width)
        return TermRow(part.block, "clipped", symbol, latex(term.of), factor, width, names.value(term.width))
    written = names.mass(part.block, term.weight)
    if not written:
        written = names.weight(term.weight) if term.weight.is_column() else r"\text{a full matrix}"
    by = rf"|{latex(term.by_of)}|\, " if isinstance(term, NormSquare) else ""
    value, metric = names.value(term.weight), r"\, G" if isinstance(term, Gathered) else ""
    kind = "gathered" if metric else "square"
    return TermRow(part.block, kind, symbol, latex(term.of), factor, written, value, by, metric)


@final
class Names:
    """What the symbols of a claim are called, and which of them have been used."""

    def __init__(self, claim: Claim) -> None:
        self.claim = claim
        self._parameters = {parameter.label: parameter for parameter in claim.loop.parameters}
        variables = (*claim.loop.controller, *claim.loop.plant)
        known = {parameter.label: parameter.symbol for parameter in claim.loop.parameters}
        known |= {variable.label: variable.symbol for variable in variables}
        known |= {leaf.name: leaf.symbol for leaf in claim.loop.trajectories}
        self._owner = {
            element.element_hash(): (label, place)
            for label, symbol in known.items()
            for place, element in enumerate(_elements(symbol), start=1)
        }
        self._names = _distinct({label: _notation(claim, label, symbol) for label, symbol in known.items()})
        self._used = dict[str, None]()

    def __call__(self, symbol: SX) -> str:
        """The LaTeX of a scalar symbol, its index left away: what is diagonal is written once for all elements."""
        label, place = self._owner.get(symbol.element_hash(), ("", 0))
        if not label:
            return name_latex(symbol.name())
        self._used[label] = None
        # the robot's numbers are of many kinds, in one column
        return rf"{self._names[label]}_{{{place}}}" if label.startswith("robot.") else self._names[label]

    def weight(self, weight: SX) -> str:
        """A diagonal weight: one formula, where it is the same for all elements."""
        written = [expression_latex(element, self) for element in ca.vertsplit(ca.densify(weight))]
        if None in written:
            return r"\text{a function of the state}"
        found = list(dict.fromkeys(str(text) for text in written))
        return found[0] if len(found) == 1 else r"\mathrm{diag}(" + r",\; ".join(found) + ")"

    def mass(self, block: str, weight: SX) -> str:
        """``M(q)`` if the weight is the robot's, recognised by its values at a random state; else empty."""
        loop, model = self.claim.loop, self.claim.diagram.models[block]
        if model.robot is None or "q" not in model.states:
            return ""
        M = model.robot.mass_matrix(model.states["q"])
        if M.shape != weight.shape:
            return ""
        difference = ca.Function("difference", [loop.state, loop.p], [weight - M], {"allow_free": True})
        state = np.random.default_rng(0).uniform(-1, 1, loop.state.numel())
        alike = not difference.has_free() and np.allclose(difference(state, loop.p_values).full(), 0, atol=1e-12)
        return "M(q)" if alike else ""

    def value(self, weight: SX) -> str:
        """The weight's elements at the graph's numbers; one where all are equal, their range where they are many."""
        loop = self.claim.loop
        function = ca.Function("value", [loop.p], loop.joined([ca.vec(ca.densify(weight))]), {"allow_free": True})
        if function.has_free():
            return "varies with the pose"
        return shown(function(loop.p_values).full().ravel())

    def legend(self) -> tuple[Legend, ...]:
        """The parameters that have been named so far."""
        used = [self._parameters[label] for label in self._used if label in self._parameters]
        return tuple(Legend(self._names[p.label], p.label, shown(p.value.ravel()), p.unit) for p in used)


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


def _elements(symbol: SX) -> list[Any]:
    return list(ca.vertsplit(ca.vec(ca.densify(symbol)))) if symbol.numel() else []


def _notation(claim: Claim, label: str, symbol: SX) -> str:
    """What the block calls a parameter in its equations: as its page says first, ``B_0.`` or ``c, the share of``, or by
    the output that is that parameter.
    """
    block, _, key = label.partition(".")
    model = claim.diagram.models.get(block)
    if model is not None and key in model.parameters:
        stated = _STATED.match(law_of(type(model.block)).parameters.get(key, ""))
        if stated:
            return name_latex(stated[1])
        for port, expression in model.equations.outputs.items():
            if expression.shape == symbol.shape and ca.is_equal(expression, symbol):
                return name_latex(port)
    return name_latex(key)


def _distinct(names: Mapping[str, str]) -> dict[str, str]:
    """Where two blocks have a parameter of one name, each carries its block's name."""
    values = list(names.values())
    return {
        label: name if values.count(name) == 1 else rf"{name}^{{\text{{{label.partition('.')[0]}}}}}"
        for label, name in names.items()
    }
