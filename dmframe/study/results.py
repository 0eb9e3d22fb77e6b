"""Results of a study: the table in its folder, summary figures, the worst runs as graphs, and the report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np

from dmframe.common.errors import EngineError, MissingError, UnknownNameError, ValueFault
from dmframe.common.files import expanded
from dmframe.graph.progress import counting
from dmframe.results.folder import safe_name
from dmframe.study.execute import State, run_study
from dmframe.study.journal import study_name_in
from dmframe.study.sheet import Sheet, is_time, least_is_worst, names_of, sheet_of
from dmframe.study.statistics import proportion, quantile
from dmframe.study.store import ROW, RUNS, polars

if TYPE_CHECKING:
    import polars as pl
    import xarray as xr

    from dmframe.graph.graph import Graph
    from dmframe.study.plan import Study

STUDY: Final = "study"
"""Name of the study's file in its folder, without the ending."""
FINAL: Final = "rms_final"
"""Default figure for ranking runs."""


@final
@dataclass(frozen=True, repr=False, eq=False)
class Results:
    """The content of a study's folder.

    Parameters
    ----------
    folder
        As `dmframe study` writes it.
    study
        The study; by default that of the folder.

    Raises
    ------
    ValueFault
        A file among its runs holds something else.
    MissingError
        There is no such folder, or it has no runs; or polars is not installed.
    """

    folder: Path
    study: Study

    def __init__(self, folder: str | Path, study: Study | None = None) -> None:
        place = expanded(folder)
        if not place.is_dir():
            raise MissingError(
                f"{folder}: expected the folder of a study; run it first: dmframe study FILE --out {folder}"
            )
        object.__setattr__(self, "folder", place)
        object.__setattr__(self, "study", _study_in(place) if study is None else study)

    @cached_property
    def name(self) -> str:
        """Name under which the study was started: in the folder, the file of every study has the same name."""
        name = study_name_in(self.folder)
        if name:
            return name
        return self.folder.resolve().name if self.study.name == STUDY else self.study.name

    @property
    def frame(self) -> pl.LazyFrame:
        """The table with a row per run, read lazily."""
        library = polars()
        files = sorted(self.folder.joinpath(RUNS).glob("*.parquet"))
        if not files:
            raise MissingError(f"{self.folder}: expected runs in {RUNS}/, found none; run the study first")
        for file in files:
            status = file.stat()
            if not _holds_runs(file, status.st_mtime_ns, status.st_size):
                raise ValueFault(f"{file}: expected runs of a study, found something else; run the study again")
        table: pl.LazyFrame = library.scan_parquet(files, missing_columns="insert", extra_columns="ignore")
        return table

    @cached_property
    def units(self) -> dict[str, str]:
        """Unit of each varied and each measured column."""
        return {column.name: column.unit for column in (*self.study.varied, *self.study.measures)}

    @cached_property
    def names(self) -> list[str]:
        """Names of the grid points in pages; empty for a single point."""
        points = self.study.points
        scales = {column.name for column in self.study.varied if column.how == "scale"}
        return [""] if len(points) == 1 else names_of([dict(point.values) for point in points], self.units, scales)

    @property
    def independent(self) -> bool:
        """True if the samples are independent draws, so that confidence intervals are valid."""
        return self.study.file.sample.method == "random" and self.study.samples > 1

    def sheet(self, *names: str) -> Sheet:
        """Some columns as matrices (points, samples). Raises `UnknownNameError`."""
        known = set(self.frame.collect_schema())
        for name in names:
            if name not in known:
                raise UnknownNameError(f"{self.folder}", "column", name, known)
        return sheet_of(self.frame, len(self.study.points), self.study.samples, names)

    @property
    def main(self) -> str:
        """The figure that ranks runs: the final RMS of the tracking error, else the first suitable measured one."""
        measured = [column.name for column in self.study.measures]
        sampled = [name for name in measured if name.endswith((".rms_final", ".most"))]
        return next((name for name in (FINAL, "error_most", *sampled) if name in measured), "")

    @property
    def table(self) -> pl.DataFrame:
        """A row per grid point: values, numbers of runs and divergences, and median and 99 % quantile of `main`."""
        library = polars()
        sheet, rows = self.sheet(*filter(None, [self.main])), list[dict[str, Any]]()
        for point in self.study.points:
            k = point.index
            row = {"point": k, **{key: plain_value(each) for key, each in point.values.items()}}
            lost = proportion(sheet.of(k, sheet.diverged), independent=self.independent)
            row |= {"runs": lost.runs, "failed": int(sheet.failed[k].sum()), "diverged": lost.count}
            row |= {"low": lost.low, "high": lost.high, "at_most": lost.most}
            if self.main:
                values = sheet.of(k, sheet.figure(self.main))
                for name, p in (("median", 0.5), ("q99", 0.99)):
                    row[f"{self.main}_{name}"] = quantile(values, p, independent=False).value
            rows.append(row)
        table: pl.DataFrame = library.DataFrame(rows, infer_schema_length=None)
        return table

    def worst_runs(self, figure: str = "", n: int = 1, points: Sequence[int] | None = None) -> list[int]:
        """The numbers of the n worst runs: those that diverged, the earliest first, then by the figure.

        Parameters
        ----------
        figure
            A column of the table; by default `main`. The greatest value is the worst; for a ``.least`` the smallest,
            for a time the earliest.
        points
            Grid points to search; by default all.
        """
        figure = figure or self.main
        if isinstance(n, bool) or not isinstance(n, int) or n < 1:
            raise ValueFault(f"worst: expected how many runs, found {n!r:.40}")
        if not figure:
            raise MissingError("worst: expected a figure; this study measures none but divergence")
        sheet = self.sheet(figure)
        values = sheet.figure(figure) * (-1 if least_is_worst(figure) else 1)
        if is_time(figure):  # the event did not happen
            values = np.where(np.isinf(values), np.nan, values)
        if points is not None:
            values = np.where(np.isin(np.arange(sheet.points), points)[:, None], values, np.nan)
        # runs with neither the figure nor a divergence are left out
        flat, when = values.T.ravel(), np.where(sheet.diverged, sheet.diverged_at, np.inf).T.ravel()
        order = np.lexsort((np.arange(flat.size), when, -np.where(np.isnan(flat), -np.inf, flat)))
        return [int(run) for run in order[:n] if not np.isnan(flat[run])]

    def worst(self, figure: str = "", n: int = 1) -> list[Graph]:
        """The n worst runs as graphs with the same numbers. See `worst_runs`."""
        return [self.study.graph_of(run) for run in self.worst_runs(figure, n)]

    def dataset(self) -> xr.Dataset:
        """All figures as an xarray dataset over the grid's dimensions and ``sample``, with units.

        A grid whose points are not all combinations of its values has the single dimension ``point``. Sampled
        quantities are the same at each point and have the dimension ``sample`` only.
        """
        import xarray as xr

        grid = [column.name for column in self.study.varied if column.kind == "grid"]
        values = [{key: plain_value(point.values[key]) for key in grid} for point in self.study.points]
        axes = {key: list(dict.fromkeys(each[key] for each in values)) for key in grid}
        coordinates: dict[str, Any] = {key: (key, axis) for key, axis in axes.items()}
        if not grid or np.prod([len(axis) for axis in axes.values()]) != len(values):  # not all combinations
            coordinates = {key: ("point", [each[key] for each in values]) for key in grid}
            values, axes = [{"point": k} for k in range(len(values))], {"point": list(range(len(values)))}
            coordinates["point"] = ("point", axes["point"])
        shape = [len(axis) for axis in axes.values()]
        indices = np.array([[axis.index(each[key]) for key, axis in axes.items()] for each in values])
        order = np.argsort(np.ravel_multi_index(tuple(indices.T), shape))
        schema = self.frame.collect_schema()
        names = [column.name for column in (*self.study.varied, *self.study.measures) if column.name not in grid]
        sheet = self.sheet(*(name for name in names if name in schema and name not in ("diverged", "diverged_at")))
        units = {**self.units, "diverged": "", "failed": "", "diverged_at": "s"}
        flags = {"diverged": sheet.diverged, "diverged_at": sheet.diverged_at, "failed": sheet.failed}
        sampled = {column.name for column in self.study.varied if column.kind != "grid"}
        data = dict[str, Any]()
        for name, matrix in (flags | sheet.columns).items():
            attributes = {"units": units[name]} if units.get(name) or name not in flags else {}
            if name in sampled and not np.any(_spread(matrix) > 0):  # one row for all points, without missing runs
                data[name] = (("sample",), np.fmin.reduce(matrix, axis=0), attributes)
            else:
                data[name] = ((*axes, "sample"), matrix[order].reshape(*shape, sheet.samples), attributes)
        found = xr.Dataset(data, coords={**coordinates, "sample": ("sample", np.arange(sheet.samples))})
        for key in grid:
            found[key].attrs["units"] = self.units.get(key, "")
        found.attrs["title"] = self.study.title or self.name
        return found

    def report(self) -> Path:
        """Write ``report.html`` with its figures, and the worst runs as graphs. Returns the page."""
        from dmframe.study.report import reported

        return reported(self.folder, self).page

    def __repr__(self) -> str:
        count = len(self.study.points) * self.study.samples
        return f"<Results of {self.name}: {len(self.study.points)} points, {count} runs, in {self.folder}>"


def plain_value(value: Any) -> Any:
    """A grid value as a number or a text."""
    return value if isinstance(value, int | float | str | bool) else str(value)


def _spread(matrix: np.ndarray) -> np.ndarray:
    """Range of each column over its rows, without missing rows."""
    if not len(matrix):
        return np.zeros(0)
    low, high = np.fmin.reduce(matrix, axis=0), np.fmax.reduce(matrix, axis=0)
    return np.where(np.isnan(low), 0.0, high - low)


@lru_cache(maxsize=2**17)
def _holds_runs(file: Path, changed: int, size: int) -> bool:
    """True for a file of rows; time of change and size invalidate the cache."""
    library = polars()
    try:
        kinds = library.read_parquet_schema(file)
    except (OSError, library.exceptions.PolarsError):
        return False
    return all(name in kinds and kinds[name].is_integer() for name in ROW)


def _study_in(folder: Path) -> Study:
    from dmframe.study.read import load_study

    return load_study(folder / f"{STUDY}.yaml")


def default_folder(study: Study) -> Path:
    """Default folder of a study's results."""
    return Path("studies", safe_name(study.name))


def run_whole(
    study: Study,
    out: str | Path | None,
    *,
    workers: int | None,
    scheduler: str | None,
    force: bool,
    progress: bool | None,
) -> Results:
    """See `Study.run`."""
    place = default_folder(study) if out is None else out
    with counting(study.name, study.runs, "runs", quiet=None if progress is None else not progress) as bar:

        def report(state: State) -> None:
            bar(state.kept, f"{len(state.failed)} chunks failed" if state.failed else "")

        state = run_study(study, place, workers=workers, scheduler=scheduler, force=force, report=report)
    if not state.complete:
        why = [state.lost] if state.lost else [f"{chunk}: {text}" for chunk, text in state.failed.items()]
        kept = f"{state.kept} of {state.runs} runs are kept in {place}, the same call continues"
        raise EngineError(f"{study.name}: {why[0]}{f'; and {len(why) - 1} more' if len(why) > 1 else ''}; {kept}")
    return Results(place, study)
