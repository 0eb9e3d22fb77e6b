"""Run a race: tune, judge, and write the table, the worst cells as graphs, and the page."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, final

from dmframe.common.errors import OutputError
from dmframe.common.files import write_text, writing
from dmframe.race.compute import JOURNAL, Heat, Kept, computed
from dmframe.race.plan import Race, Run
from dmframe.race.protocol import Choice, Row, chosen, judged_runs, rows_of, tuning_runs
from dmframe.study.execute import State
from dmframe.study.executor import Executor
from dmframe.study.kernel_lock import exclusive
from dmframe.study.packing import write_graph

WORST: Final = 6
"""Cells with the largest ratios that are saved as graphs."""
TABLE, CHOICES, PAGE, FILE = "table.json", "tuned.json", "report.html", "race.yaml"

Report = Callable[[str, State], None]
"""Callback (stage, state), called at each change and twice a second."""


@final
@dataclass(frozen=True)
class Finished:
    """Result of a race.

    Parameters
    ----------
    worst
        The rows with the largest ratios, each with the files of its graphs by law.
    """

    race: Race
    folder: Path
    choices: Sequence[Choice]
    rows: Sequence[Row]
    worst: Sequence[tuple[Row, Mapping[str, str]]]


def run_race(
    race: Race,
    out: str | Path,
    *,
    workers: int | None = None,
    executor: Callable[[Heat], Executor] | None = None,
    report: Report = lambda stage, state: None,
) -> Finished:
    """Compute the missing runs, and write the results.

    Parameters
    ----------
    out
        The folder. Its journal holds runs by everything that decides them, so that an interrupted race continues, and a
        race with another law computes the runs of that law only.
    workers
        Processes; by default as many as there are cores.
    executor
        Makes what computes the runs instead of these processes, such as `InProcess`.

    Raises
    ------
    DmframeError
        A run that cannot be prepared, or a folder that cannot be written.
    """
    folder = Path(out)
    with writing(folder, "folder"):
        folder.mkdir(parents=True, exist_ok=True)
    with exclusive(folder):
        _check_folder(folder)
        kept = Kept(folder)

        def errors(stage: str, runs: Sequence[Run]) -> dict[Run, float]:
            def update(state: State) -> None:
                report(stage, state)

            return computed(race, runs, kept, workers=workers, executor=executor, report=update)

        choices = chosen(race, errors("tuning", tuning_runs(race)))
        rows = rows_of(race, errors("held-out cells", judged_runs(race, choices)))
        found = Finished(race, folder, choices, rows, _worst(race, choices, rows, folder))
        _write(found)
    return found


def _check_folder(folder: Path) -> None:
    """Raise `OutputError` for a folder with other files, which the files of the race would replace."""
    with writing(folder, "folder"):
        others = sorted(item.name for item in folder.iterdir() if not item.name.startswith("."))
    if others and JOURNAL not in others:
        text = f"{folder}: expected an empty or a new folder, or that of a race, found {others[0]}"
        raise OutputError(f"{text}; name another with --out")


def _worst(
    race: Race, choices: Sequence[Choice], rows: Sequence[Row], folder: Path
) -> list[tuple[Row, Mapping[str, str]]]:
    """Write the cells with the largest ratios as graphs, of the entrant and of the best rival."""
    best = {(choice.law, choice.clock): choice.best for choice in choices}
    with writing(folder):
        for old in folder.glob("worst_*.yaml"):
            old.unlink()
    found = list[tuple[Row, Mapping[str, str]]]()
    for place, row in enumerate(sorted(rows, key=lambda row: row.ratio, reverse=True)[:WORST], start=1):
        files = dict[str, str]()
        for law, ending in ((row.law, ""), (row.best_rival, "_rival")):
            if (tried := best[law, row.cell.clock]) is not None:
                files[law] = f"worst_{place}{ending}.yaml"
                run = Run(law, row.cell, tried.values, race.file.seed + 1)
                write_graph(race.graph(run), folder / files[law])
        found.append((row, files))
    return found


def _write(found: Finished) -> None:
    from dmframe.race.page import as_html

    write_text(found.folder / FILE, found.race.text)
    rows = [{**row.summary, "errors": row.errors} for row in found.rows]
    write_text(found.folder / TABLE, _json(rows))
    write_text(found.folder / CHOICES, _json([_choice(choice) for choice in found.choices]))
    write_text(found.folder / PAGE, as_html(found))


def _choice(choice: Choice) -> dict[str, Any]:
    tried = [{"values": dict(each.values), "score": each.score, "rejected": each.why} for each in choice.tried]
    best = choice.best
    values = None if best is None else dict(best.values)
    return {"law": choice.law, "clock": choice.clock, "values": values, "candidates": tried}


def _json(rows: Any) -> str:
    """JSON with null for infinite numbers."""
    return json.dumps(json.loads(json.dumps(rows), parse_constant=lambda _: None), indent=1) + "\n"
