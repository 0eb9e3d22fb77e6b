"""Report of a study: one page, its plots as files, and its worst runs as graphs."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from dmframe.block.port import Side
from dmframe.common.copies import shared
from dmframe.common.files import write_bytes, write_text, writing
from dmframe.common.plotting import files_of
from dmframe.study.answer import ReportData, Saved, best_of, lead
from dmframe.study.figures import figures_of
from dmframe.study.findings import Findings, findings_of
from dmframe.study.packing import write_graph
from dmframe.study.pages import study_page
from dmframe.study.proof import proofs_of
from dmframe.study.sections import scope, sections

if TYPE_CHECKING:
    from dmframe.study.results import Results

PAGE: Final = "report.html"
FIGURES: Final = "figures"
WORST: Final = "worst_{}.yaml"


class Reported(NamedTuple):
    """A report that was written.

    Parameters
    ----------
    page
        Its file.
    answer
        Its first sentence: the verdict on the proof, and the result of the runs.
    outcome
        Common outcome: ``proved``, ``refuted``, ``not_applicable`` or ``open``.
    proofs
        For each examined setting its name, and ``proved``, ``refuted``, ``not_applicable`` or ``not_known``.
    """

    page: Path
    answer: str
    outcome: str
    proofs: Sequence[Mapping[str, str]]


def reported(folder: str | Path, results: Results | None = None, *, proofs: bool = True) -> Reported:
    """Write ``report.html``, ``figures/`` and the worst runs, ``worst_1.yaml`` and so on, into a study's folder.

    Earlier ones are replaced. No simulation: the table is read, and the proof is decided over the sampled box.

    Parameters
    ----------
    results
        Those of the folder, if they have been read already.
    proofs
        Decide the proof, which takes about two seconds per grid point, for at most a dozen.

    Raises
    ------
    DmframeError
        The folder has no study, the table lacks a figure of the report, or the folder cannot be written.
    """
    from dmframe.study.results import Results

    results = results or Results(folder)
    found = findings_of(results)
    data = ReportData(
        found,
        tuple(_saved(results, found)),
        tuple(proofs_of(results.study, results.names)) if proofs else (),
        _robots(results),
        _commands(results),
        _made(results.folder),
    )
    page, files = results.folder / PAGE, _figures(found)
    _write_figures(results.folder / FIGURES, files)
    pictures = {Path(name).stem: content.decode() for name, content in files.items() if name.endswith(".svg")}
    write_text(page, as_html(data, pictures))
    answer = lead(data)
    text = f"{answer.headline}: {answer.sentence.text}".replace("`", "")
    return Reported(page, text, answer.outcome, [{"setting": each.name, "proof": each.state} for each in data.proofs])


def as_html(data: ReportData, pictures: Mapping[str, str]) -> str:
    """The page, as one self-contained file; `pictures` are SVG by name."""
    results = data.found.results
    note, parts = scope(results.study), list(sections(data, pictures))
    return study_page("Study of a control loop", results.name, results.study.title, note, lead(data), parts)


def _figures(found: Findings) -> dict[str, bytes]:
    """All plots as files, on several cores, since matplotlib takes most of a report's time."""
    name = found.results.name
    jobs = [partial(files_of, figure, each, name) for each, figure in figures_of(found).items()]
    with shared(jobs) as finished:
        return {file: content for files in finished() for file, content in files.items()}


def _write_figures(place: Path, files: Mapping[str, bytes]) -> None:
    with writing(place):
        place.mkdir(exist_ok=True)
        for old in (*place.glob("*.png"), *place.glob("*.svg")):
            old.unlink()
    for name, content in files.items():
        write_bytes(place / name, content)


def _saved(results: Results, findings: Findings) -> list[Saved]:
    """Write the worst runs by each figure of the section ``report`` as graphs, and the worst of the best setting.

    Without the latter, a single bad setting could have all of the worst runs.
    """
    study, there = results.study, set(results.frame.collect_schema())
    runs = dict[int, str]()
    for figure, number in study.file.report.worst.items():
        if figure in there:
            for run in results.worst_runs(figure, number):
                runs.setdefault(run, figure)
    best = best_of(findings)
    if runs and best is not None and all(run % len(study.points) != best[0].index for run in runs):
        runs |= dict.fromkeys(results.worst_runs(results.main, 1, [best[0].index]), results.main)
    with writing(results.folder):
        for old in results.folder.glob(WORST.format("*")):
            old.unlink()
    if not runs:
        return []
    sampled = [column.name for column in study.varied if column.kind == "sampled"]
    sheet, found = results.sheet(*dict.fromkeys([*runs.values(), *sampled])), list[Saved]()
    for place, (run, figure) in enumerate(runs.items(), start=1):
        sample, point = divmod(run, len(study.points))
        file = WORST.format(place)
        write_graph(study.graph_of(run), results.folder / file)
        found.append(
            Saved(
                file,
                run,
                results.names[point],
                figure,
                float(sheet.figure(figure)[point, sample]),
                float(sheet.diverged_at[point, sample]),
                {name: float(sheet.columns[name][point, sample]) for name in sampled if name in sheet.columns},
            )
        )
    return found


def _robots(results: Results) -> bool:
    """True if a parameter of the plant is sampled."""
    blocks = results.study.points[0].graph.blocks
    drawn = {label.partition(".")[0] for factor in results.study.factors for label in factor.labels}
    return any(blocks[name].side is Side.PLANT for name in drawn & blocks.keys())


def _commands(results: Results) -> Sequence[tuple[str, str]]:
    """Commands relative to the working directory or, for a folder elsewhere, to the folder's parent."""
    folder, here = results.folder.resolve(), Path.cwd()
    place = quote(str(folder.relative_to(here)) if folder.is_relative_to(here) else folder.name)
    return (
        (f"dmframe study {place}", "computes the missing runs"),
        (f"dmframe study {place}/study.yaml --out AGAIN", "repeats all runs in another folder"),
        (
            f"dmframe study {place} --rerun RUN",
            "repeats one run by its number, as a graph, and compares it with its row",
        ),
        (f"dmframe study report {place}", "writes this page again from the existing runs"),
    )


def _made(folder: Path) -> Sequence[tuple[str, str]]:
    """Versions and machine, from the folder's provenance."""
    try:
        found = json.loads((folder / "provenance.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return ()
    return [(key, _flat(value)) for key, value in found.items() if value not in (None, "", [], {})][:14]


def _flat(value: Any) -> str:
    if isinstance(value, dict):
        counted = all(isinstance(each, int) for each in value.values())
        return ", ".join(f"{key} ({each})" if counted else f"{key} {_flat(each)}" for key, each in value.items())
    return " ".join(map(str, value)) if isinstance(value, list) else str(value)
