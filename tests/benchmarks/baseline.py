"""A baseline of ratios, and the comparison of a new table with it.

Times differ between machines; ratios that are measured in one run on a quiet machine differ much less. Every ratio is
larger if dmframe is better, or if a cost has grown less, so a smaller ratio is worse.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from tests.benchmarks.table import Report

FILE = Path(__file__).with_name("baseline.json")
TOLERANCE = 1.5
"""A ratio may decrease to its baseline divided by this; below it is a regression, or the machine was too busy."""


@dataclass(frozen=True)
class Regression:
    """A row below the baseline, or one that is no longer comparable."""

    key: str
    expected: float
    found: float | None
    why: str = ""

    def __str__(self) -> str:
        if self.found is None:
            return f"{self.key}: expected a ratio of about {self.expected:.3g}, found none: {self.why}"
        return f"{self.key}: expected a ratio of about {self.expected:.3g}, found {self.found:.3g}"


def write(report: Report, file: Path = FILE) -> None:
    """The ratios of comparable rows."""
    ratios = {row.key: float(f"{row.ratio:.4g}") for row in report.rows if row.ratio is not None}
    kept = {"command": report.command, "tolerance": TOLERANCE, "ratios": ratios}
    file.write_text(json.dumps(kept, indent=2) + "\n", encoding="utf-8")


def read(file: Path = FILE) -> dict[str, float]:
    """The ratios kept."""
    ratios: dict[str, float] = json.loads(file.read_text(encoding="utf-8"))["ratios"]
    return ratios


def regressions(report: Report, ratios: dict[str, float], tolerance: float = TOLERANCE) -> list[Regression]:
    """The rows below the baseline. A tool that is not installed here, or a part that was not run, is no regression."""
    found = list[Regression]()
    for row in report.rows:
        expected = ratios.get(row.key)
        if expected is None or row.status == "missing":
            continue
        if row.ratio is None:
            found.append(Regression(row.key, expected, None, row.agreement or "its reference is missing"))
        elif row.ratio < expected / tolerance:
            found.append(Regression(row.key, expected, row.ratio))
    return found
