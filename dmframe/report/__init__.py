"""Reports: what was proved, on what it rests, and what was measured, for a reader who does not know the tool."""

from dmframe.report.write import write_report

__all__ = ["write_report"]
