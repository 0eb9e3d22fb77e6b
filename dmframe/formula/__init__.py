"""Printed laws: formulas read from the CasADi expressions that run, written as text, LaTeX and Unicode."""

from dmframe.formula.formula import Formula
from dmframe.formula.law import Line, PrintedLaw, PrintedTerm
from dmframe.formula.laws import laws_of, printed

__all__ = ["Formula", "Line", "PrintedLaw", "PrintedTerm", "laws_of", "printed"]
