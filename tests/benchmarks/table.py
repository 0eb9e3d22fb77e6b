"""Rows of measurements, and their table as text, Markdown or JSON."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

Status = Literal["ok", "missing", "disagrees", "failed"]
COLUMNS = ("what", "version", "measured", "ratio", "agreement", "method and remarks")


@dataclass(frozen=True)
class Row:
    """One measurement.

    Attributes
    ----------
    part : the section's letter
    name : the measured quantity
    value, unit : None without a measurement
    ratio : how many times better dmframe is; None for its own reference and for rows that are not compared
    status : only "ok" is compared
    agreement : distance from dmframe's result, or the reason why there is none
    """

    part: str
    name: str
    value: float | None = None
    unit: str = ""
    ratio: float | None = None
    status: Status = "ok"
    version: str = ""
    agreement: str = ""
    note: str = ""

    @property
    def key(self) -> str:
        """Key of its ratio in a baseline."""
        return f"{self.part}/{self.name}"

    def cells(self) -> tuple[str, ...]:
        """The row as shown in the table."""
        measured = "" if self.value is None else f"{figures(self.value)} {self.unit}".strip()
        ratio = "" if self.ratio is None else figures(self.ratio)
        agreement = self.agreement
        if self.status == "disagrees":
            measured, ratio, agreement = f"({measured})", "does not count", f"does not agree: {agreement}"
        if self.status == "missing":
            measured = "missing"
        if self.status == "failed":
            measured = "failed"
        return self.name, self.version, measured, ratio, agreement, self.note


@dataclass(frozen=True)
class Section:
    """A part of the table.

    Attributes
    ----------
    title : the measured quantity and the circumstances
    against : the reference of `ratio`
    """

    part: str
    title: str
    against: str
    rows: tuple[Row, ...]
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True)
class Report:
    """A whole run."""

    command: str
    machine: dict[str, str]
    sections: tuple[Section, ...] = field(default=())

    @property
    def rows(self) -> list[Row]:
        """All rows."""
        return [row for section in self.sections for row in section.rows]

    def as_json(self) -> str:
        """All rows as data for other programs."""
        return json.dumps(asdict(self), indent=2) + "\n"

    @classmethod
    def from_json(cls, text: str) -> Report:
        """The inverse of `as_json`."""
        data: dict[str, Any] = json.loads(text)
        sections = tuple(
            Section(s["part"], s["title"], s["against"], tuple(Row(**row) for row in s["rows"]), tuple(s["remarks"]))
            for s in data["sections"]
        )
        return cls(data["command"], data["machine"], sections)

    def as_text(self) -> str:
        """For a terminal; notes follow each section."""
        lines = [f"{key}: {value}" for key, value in self.machine.items()]
        for section in self.sections:
            lines += ["", f"({section.part}) {section.title}", f"    ratio: {section.against}", ""]
            cells = [COLUMNS[:-1], *(row.cells()[:-1] for row in section.rows)]
            lines += ["  " + line for line in aligned(cells)]
            noted = [f"  {row.name}: {row.note}" for row in section.rows if row.note]
            lines += ["", *noted] if noted else []
            lines += [f"  {remark}" for remark in section.remarks]
        return "\n".join(lines) + "\n"

    def as_markdown(self) -> str:
        """For a page."""
        lines = [f"- made by: `{self.command}`"]
        lines += [f"- {key}: {value}" for key, value in self.machine.items()]
        for section in self.sections:
            lines += ["", f"### ({section.part}) {section.title}", "", f"Ratio: {section.against}.", ""]
            lines += ["| " + " | ".join(COLUMNS) + " |", "|---|---|---|---|---|---|"]
            lines += [
                "| " + " | ".join(cell.replace("|", "\\|") for cell in row.cells()) + " |" for row in section.rows
            ]
            for remark in section.remarks:
                lines += ["", remark]
        return "\n".join(lines) + "\n"


def aligned(rows: Iterable[Sequence[str]]) -> list[str]:
    """Cells in columns of the width of their widest entry."""
    kept = [list(row) for row in rows]
    widths = [max(len(row[k]) for row in kept) for k in range(len(kept[0]))]
    return ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in kept]


def figures(value: float) -> str:
    """Three significant digits, with an exponent only for very large or small numbers."""
    return f"{value:.0f}" if abs(value) >= 100 else f"{value:.3g}"
