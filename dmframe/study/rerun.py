"""Repeat one run of a study as a graph of its own, and compare it with its row."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, final

from dmframe.common.errors import OutputError
from dmframe.graph.load import load
from dmframe.study.packing import write_graph
from dmframe.study.plan import Study
from dmframe.study.results import Results
from dmframe.study.store import RUNS, polars

ROUNDING: Final = 1e-9
"""Relative tolerance: a single run sums its figures in another order than a batch."""


@final
@dataclass(frozen=True)
class Rerun:
    """Repeated run, and the row of the same run.

    Parameters
    ----------
    graph
        The file that was written and run.
    rerun, row
        Figures by column; the row is None if the study's folder does not hold it.
    units
        Units by column.
    """

    run: int
    point: int
    sample: int
    graph: Path
    place: Path
    rerun: Mapping[str, Any]
    row: Mapping[str, Any] | None
    units: Mapping[str, str]

    @property
    def difference(self) -> float:
        """Largest relative difference; infinite if only one of them diverged."""
        row = self.row or {}
        return max((_difference(self.rerun[name], value, _size(name, row)) for name, value in row.items()), default=0.0)

    @property
    def alike(self) -> bool:
        """True if they agree to rounding, or there is no row."""
        return self.difference <= ROUNDING

    @property
    def verdict(self) -> str:
        """The comparison in a sentence."""
        if self.difference == 0:
            return "equal to its row, bit by bit"
        if self.alike:
            return f"equal to its row to rounding: they differ by at most {self.difference:.1e} of a figure"
        return f"differs from its row, by up to {self.difference:.1e} of a figure"

    @property
    def summary(self) -> dict[str, Any]:
        """Plain data for JSON."""
        which = {"run": self.run, "point": self.point, "sample": self.sample, "graph": str(self.graph)}
        row = None if self.row is None else _finite(self.row)
        difference = None if self.row is None or math.isinf(self.difference) else self.difference
        return {**which, "rerun": _finite(self.rerun), "row": row, "difference": difference, "alike": self.alike}


def repeat(study: Study, run: int, place: Path, into: Path, *, force: bool = False) -> Rerun:
    """Write a run as a graph into the folder `into`, run that file, and read its row in the study's folder `place`.

    Raises
    ------
    DmframeError
        There is no such run, or its file exists and `force` is not set.
    """
    graph = study.graph_of(run)
    sample, point = divmod(run, len(study.points))
    target = into / f"{study.name}_run_{run}.yaml"
    if target.exists() and not force and target.read_text(encoding="utf-8") != graph.text:
        raise OutputError(f"{target}: expected a new file, found another one; move it, or use --force")
    write_graph(graph, target)
    done = load(target).run(progress=False)
    figures = study.row_of(done.recording, graph)
    units = {column.name: column.unit for column in study.measures}
    row = _row(study, place, run, list(figures))
    return Rerun(run, point, sample, target, place, figures, row, {name: units.get(name, "") for name in figures})


def _row(study: Study, place: Path, run: int, names: list[str]) -> Mapping[str, Any] | None:
    if not any((place / RUNS).glob("*.parquet")):
        return None
    column = polars().col
    found = Results(place, study).frame.filter(column("run") == run).select(names).collect()
    return dict(found.row(0, named=True)) if len(found) else None


def _size(name: str, row: Mapping[str, Any]) -> float:
    """Largest figure of the same signal, the scale for rounding errors of its small figures."""
    signal, _, figure = name.rpartition(".")
    if not signal or figure == "crossed":
        return 0.0
    others = [key for key in row if key.rpartition(".")[0] == signal and not key.endswith("crossed")]
    alike = [abs(row[key]) for key in others]
    return max((value for value in alike if math.isfinite(value)), default=0.0)


def _difference(a: Any, b: Any, size: float = 0.0) -> float:
    if a == b or (a != a and b != b):  # nan equals nan
        return 0.0
    if isinstance(a, bool) or a != a or b != b:
        return math.inf
    return float(abs(a - b) / max(abs(a), abs(b), size))


def _finite(figures: Mapping[str, Any]) -> dict[str, Any]:
    return {
        name: None if isinstance(value, float) and not math.isfinite(value) else value
        for name, value in figures.items()
    }
