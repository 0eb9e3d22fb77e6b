"""Reports: what was proved, on what it rests, and what was measured, for a reader who does not know the tool."""

from dmframe.report.analysis import Analysis
from dmframe.report.explanation import Explanation
from dmframe.report.verification import Verification
from dmframe.report.write import check_place, write_report

__all__ = ["Analysis", "Explanation", "Verification", "check_place", "write_report"]
