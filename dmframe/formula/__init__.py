"""Printed laws: formulas read from the CasADi expressions that run, written as text, LaTeX and Unicode."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from dmframe.formula.formula import Formula
    from dmframe.formula.law import Line, PrintedLaw, PrintedTerm
    from dmframe.formula.laws import laws_of, printed

_HOMES: Final = {
    "Formula": "formula",
    "Line": "law",
    "PrintedLaw": "law",
    "PrintedTerm": "law",
    "laws_of": "laws",
    "printed": "laws",
}
"""The module of each name, imported when its name is first used: most commands compare no laws."""

__all__ = ["Formula", "Line", "PrintedLaw", "PrintedTerm", "laws_of", "printed"]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
