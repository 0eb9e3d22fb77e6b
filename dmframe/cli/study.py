"""``dmframe study``: run a study, print its plan, or repeat one of its runs."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from dmframe.cli import STOPPED
from dmframe.cli.streams import tell
from dmframe.common.columns import columns
from dmframe.common.errors import MissingError, ValueFault, visible
from dmframe.common.trust import remember
from dmframe.graph.progress import counting, progress_line
from dmframe.study.execute import Estimate, State, estimate_of, run_study
from dmframe.study.journal import LOCK
from dmframe.study.plan import Study
from dmframe.study.read import load_study
from dmframe.study.rerun import Rerun, repeat
from dmframe.study.results import Results, default_folder
from dmframe.study.store import polars

if TYPE_CHECKING:
    from dmframe.study.report import Reported

INCOMPLETE: Final = 1
FILE: Final = "study.yaml"
REPORT: Final = "report"
MANY: Final = 64
"""Number of points up to which each is checked before a study runs."""


def one_file(words: Sequence[str]) -> str:
    """Study file of a command."""
    if len(words) > 1:
        raise ValueFault(f"study: expected one file, found {len(words)}: {' '.join(words)[:60]}")
    return words[0]


def study_of(file: str, *, trust: bool = False) -> tuple[Study, Path]:
    """Study of a file or results folder, and its results folder."""
    path = Path(file).expanduser()
    if path.is_dir():
        path /= FILE
        if not path.is_file():
            raise MissingError(f"{file}: expected a study's file, or the folder of its results, found neither")
    if trust:
        remember(path.parent)
    study = load_study(path)
    if path.name == FILE and (path.parent / LOCK).is_file():
        return study, path.parent
    return study, default_folder(study)


def run(
    file: str,
    *,
    workers: int | None,
    scheduler: str | None,
    out: Path | None,
    report: bool,
    force: bool,
    as_json: bool,
    trust: bool,
) -> int:
    """Compute the missing rows and write the report; returns the exit status."""
    polars()  # fail early if it is missing
    study, place = study_of(file, trust=trust)
    place = out or place
    with progress_line(study.name, quiet=as_json) as say:
        say("building its closed loops")
        _check(study)
    last: State | None = None
    try:
        with counting(study.name, study.runs, "runs", quiet=True if as_json else None) as bar:

            def progress(state: State) -> None:
                nonlocal last
                last = state
                bar(state.kept, _note(state, scheduler))

            state = run_study(study, place, workers=workers, scheduler=scheduler, force=force, report=progress)
    except KeyboardInterrupt:
        if last is not None:
            tell(f"{last.kept} of {last.runs} runs are kept in {place}; the same command continues", aside=True)
        return STOPPED
    _print(
        study, state, place, _reported(Results(place), quiet=as_json) if report and state.complete else None, as_json
    )
    return 0 if state.complete else INCOMPLETE


def report(folder: str, *, as_json: bool, trust: bool) -> int:
    """Rewrite the report of a results folder; returns the exit status."""
    if trust:
        remember(Path(folder).expanduser())
    made = _reported(Results(folder), quiet=as_json)
    tell(json.dumps(_answered(made), indent=2) if as_json else f"{made.answer}\nwrote {made.page}")
    return 0


def _answered(made: Reported | None) -> dict[str, Any]:
    if made is None:
        return {"answer": None, "outcome": None, "proofs": None, "report": None}
    return {"answer": made.answer, "outcome": made.outcome, "proofs": list(made.proofs), "report": str(made.page)}


def _reported(results: Results, *, quiet: bool) -> Reported:
    from dmframe.study.report import reported

    with progress_line(results.name, quiet=quiet) as say:
        say("deciding the proof over all samples, and writing the report")
        return reported(results.folder, results)


def _check(study: Study) -> None:
    """Raise faults before any run; of many points only the closed loops are checked, to save time."""
    if len(study.points) <= MANY:
        study.check()
    else:
        _ = study.measures


def _note(state: State, scheduler: str | None) -> str:
    notes = []
    if scheduler is not None:
        notes.append(f"{state.workers} workers" if state.workers else "waiting for workers")
    if state.failed:
        notes.append(f"{len(state.failed)} chunks failed")
    return ", ".join(notes)


def _print(study: Study, state: State, place: Path, made: Reported | None, as_json: bool) -> None:
    counted = _counted(place) if state.kept else {"diverged": 0, "faults": 0}
    if as_json:
        data = {
            "study": study.name,
            "runs": state.runs,
            "kept": state.kept,
            "computed": state.computed,
            **counted,
            "failed": {str(chunk): why for chunk, why in state.failed.items()},
            "lost": state.lost or None,
            "notices": state.notices,
            "seconds": round(state.seconds, 3),
            "workers": state.workers,
            "out": str(place),
            **_answered(made),
        }
        tell(json.dumps(data, indent=2))
        return
    for notice in state.notices:
        tell(visible(notice), aside=True)
    for chunk, why in state.failed.items():
        tell(f"{chunk}: failed three times: {visible(why)}", aside=True)
    if state.lost:
        tell(
            f"{visible(state.lost)}; {state.kept} of {state.runs} runs are kept, the same command continues", aside=True
        )
    rate = f", {state.computed / state.seconds:.3g} runs/s on {_workers(state.workers)}" if state.computed else ""
    tell(f"{study.name}: {state.kept} of {state.runs} runs; {state.computed} computed in {_time(state.seconds)}{rate}")
    if made is not None:
        tell(made.answer)
    tell(f"diverged: {counted['diverged']}, not run for a fault: {counted['faults']}")
    tell(f"results: {place}")
    if made is not None:
        tell(f"report: {made.page}")


def _workers(count: int) -> str:
    return f"{count} worker{'' if count == 1 else 's'}"


def _counted(place: Path) -> dict[str, int]:
    """Numbers of diverged and faulty runs, read column by column."""
    library = polars()
    column = library.col
    table = library.scan_parquet(place / "runs" / "*.parquet")
    names = set(table.collect_schema().names())
    wanted = {"diverged": column("diverged").sum(), "faults": column("fault").is_not_null().sum()}
    present = [expression.alias(name) for name, expression in wanted.items() if {"diverged", "fault"} <= names]
    row = table.select(present).collect().row(0, named=True) if present else {}
    return {name: int(row.get(name) or 0) for name in wanted}


def dry_run(file: str, *, workers: int | None, out: Path | None, as_json: bool, trust: bool) -> int:
    """Print the plan of a study; returns the exit status."""
    study, place = study_of(file, trust=trust)
    with progress_line(study.name, quiet=as_json) as say:
        say("building its closed loops")
        _check(study)
        say("timing some runs")
        found = estimate_of(study, out or place, workers)
    if as_json:
        tell(json.dumps(found.summary | {"out": str(out or place)}, indent=2))
    else:
        tell(_plan_text(study, found, out or place))
    return 0


def _plan_text(study: Study, found: Estimate, place: Path) -> str:
    rows = [
        ("points", str(found.points), _axes(study)),
        ("samples", str(found.samples), f"a point, {study.file.sample.method}, seed {study.file.sample.seed}"),
        ("runs", str(found.runs), f"of {study.bases[''].file.duration:g} s; {found.kept} are kept in {place}"),
        ("chunks", str(found.chunks), f"remaining, of up to {found.each} runs"),
        ("time", _time(found.seconds), f"on {_workers(found.workers)} here, at {found.rate:.3g} runs/s each"),
    ]
    varied = [(column.name, f"[{column.unit}]" if column.unit else "", column.kind) for column in study.varied]
    return "\n".join([f"{study.name}: {study.title}", columns(rows), "varies:", columns(varied)])


def _axes(study: Study) -> str:
    return " x ".join(f"{len(axis.cases)} of {axis.name}" for axis in study.axes) or "no grid"


def _time(seconds: float) -> str:
    if seconds < 100:
        return f"{seconds:.2g} s"
    if seconds < 6000:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.1f} h"


def rerun(file: str, number: int, *, out: Path | None, force: bool, as_json: bool, trust: bool) -> int:
    """Write one run as a graph, run it, and compare it with its row; returns the exit status."""
    study, place = study_of(file, trust=trust)
    place = out or place
    with progress_line(study.name, quiet=as_json) as say:
        say(f"run {number}")
        found = repeat(study, number, place, place if place.is_dir() else Path(), force=force)
    tell(json.dumps(found.summary, indent=2) if as_json else _comparison(study, found))
    return 0 if found.alike else INCOMPLETE


def _comparison(study: Study, found: Rerun) -> str:
    values = ", ".join(f"{key} = {value}" for key, value in study.points[found.point].values.items())
    head = f"run {found.run}: sample {found.sample} of point {found.point}" + (f", {values}" if values else "")
    rows = [("", "unit", "rerun", "row"), *((name, found.units[name], *_pair(found, name)) for name in found.rerun)]
    kept = f"its row is not in {found.place}: no comparison" if found.row is None else found.verdict
    return "\n".join([head, f"wrote {os.fspath(found.graph)}", columns(rows), kept])


def _pair(found: Rerun, name: str) -> tuple[str, str]:
    row: Mapping[str, Any] = found.row or {}
    return _number(found.rerun[name]), _number(row[name]) if name in row else ""


def _number(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
