"""Reports on a graph: certificate, assumptions, simulated run and linear analysis as HTML, Markdown, JSON or text."""

from dmframe.report.analysis import Analysis
from dmframe.report.explanation import Explanation
from dmframe.report.verification import Verification
from dmframe.report.write import check_place, write_report

__all__ = ["Analysis", "Explanation", "Verification", "check_place", "write_report"]
