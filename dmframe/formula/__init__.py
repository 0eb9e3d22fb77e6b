"""Laws, printed from the code that runs: read from CasADi expressions, written as text, LaTeX and Unicode."""

from dmframe.formula.formula import Formula
from dmframe.formula.law import Line, PrintedLaw, PrintedTerm
from dmframe.formula.laws import laws_of, printed

__all__ = ["Formula", "Line", "PrintedLaw", "PrintedTerm", "laws_of", "printed"]
