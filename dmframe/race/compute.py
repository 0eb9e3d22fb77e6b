"""Compute the runs of a race with the executors of a study, and keep their errors in a journal."""

from __future__ import annotations

import json
import math
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby
from pathlib import Path
from typing import Final, final

from dmframe.batch.columns import Columns
from dmframe.batch.figures import ERROR, MeasuredSignals
from dmframe.batch.runner import Runner, Runs
from dmframe.common.errors import DmframeError, EngineError, OutputError, raise_all
from dmframe.common.files import append, writing
from dmframe.graph.graph import Graph
from dmframe.race.plan import Race, Run
from dmframe.study.chunks import Chunk
from dmframe.study.execute import Dispatcher, State
from dmframe.study.executor import Computed, Executor
from dmframe.study.journal import end_line
from dmframe.study.pool import Pool

JOURNAL: Final = "runs.jsonl"
CHUNK: Final = 240
"""Largest number of runs between two entries of the journal."""
MOST: Final = 5
"""Largest number of different faults in an error message."""

Errors = Mapping[Run, float]
"""RMS error over the last eighth of a run in the unit of the race, mm or mrad; infinite for a run that diverged."""


@final
@dataclass(frozen=True)
class Heat:
    """Runs of a race in the form that the executors of a study compute; each point is one run."""

    race: Race
    runs: Sequence[Run]

    @cached_property
    def _runner(self) -> Runner:
        return Runner()

    @property
    def engine(self) -> str:
        """Runner of the last chunk in this process, reused for the next one."""
        return self._runner.engine

    def band(self, point: int, end: int, first: int, stop: int) -> Columns:
        """Errors of the runs [point, end): infinite for divergence; NaN, with the reason, for an invalid run."""
        like: Graph | None = None
        graphs = list[Graph]()
        for run in self.runs[point:end]:
            like = self.race.graph(run, like)
            graphs.append(like)
        try:
            found = self._measured(graphs)
        except DmframeError:  # if one graph cannot be built, each is built separately, so that the others have no fault
            found = [self._alone(graph) for graph in graphs]
        return {"error": [error for error, _ in found], "fault": [fault for _, fault in found]}

    def _alone(self, graph: Graph) -> tuple[float, str]:
        try:
            return self._measured([graph])[0]
        except DmframeError as error:
            return math.nan, str(error)

    def _measured(self, graphs: Sequence[Graph]) -> list[tuple[float, str]]:
        found = list[tuple[float, str]]()
        for measured in self._runner.measure([Runs(graph) for graph in graphs], lambda _: MeasuredSignals(), threads=1):
            figures = measured.signals.get(ERROR)
            if fault := measured.faults.get(0):
                found.append((math.nan, str(fault)))
            elif figures is None or figures.unit != self.race.file.base_unit:
                unit = "no path" if figures is None else f"a path in {figures.unit}"
                file = self.race.file
                text = (
                    f"the error of this race is that of the {file.error} in {file.unit}, and the graph follows {unit}"
                )
                found.append((math.nan, f"{text}; see the key error"))
            else:
                found.append((self._final(1000 * float(figures.rms_by_eighth[0, 0, -1])), ""))
        return found

    def _final(self, error: float) -> float:
        """The error; infinite if the loop diverged or the error exceeded the limit of the race."""
        return error if error <= 1000 * self.race.file.limit else math.inf


@final
class Kept:
    """Journal in the folder of a race: one line per run, with the digest of all its inputs."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / JOURNAL
        self.errors = dict[str, float]()
        with writing(folder, "folder"):
            folder.mkdir(parents=True, exist_ok=True)
            if self.path.exists() and not self.path.is_file():
                raise OutputError(
                    f"{self.path}: expected the journal of a race, found no regular file; name another folder"
                )
            end_line(self.path)
            text = self.path.read_text(encoding="utf-8", errors="replace") if self.path.exists() else ""
        for line in text.splitlines():
            with suppress(ValueError, TypeError, KeyError, RecursionError):  # a line that no race has written in full
                key, error = (row := json.loads(line))["key"], row["error"]
                if isinstance(key, str) and (error is None or (type(error) is float and 0 <= error < math.inf)):
                    self.errors[key] = math.inf if error is None else error

    def write(self, keys: Sequence[str], errors: Sequence[float]) -> None:
        """Append runs to the journal."""
        rows = [
            {"key": key, "error": error if math.isfinite(error) else None}
            for key, error in zip(keys, errors, strict=True)
        ]
        with writing(self.path):
            append(self.path, "".join(f"{json.dumps(row)}\n" for row in rows))
        self.errors |= dict(zip(keys, errors, strict=True))


def computed(
    race: Race,
    runs: Iterable[Run],
    kept: Kept,
    *,
    workers: int | None = None,
    executor: Callable[[Heat], Executor] | None = None,
    report: Callable[[State], None] = lambda _: None,
) -> dict[Run, float]:
    """Errors of some runs; those that the journal lacks are computed, runs of one structure together.

    Raises
    ------
    DmframeError
        A run that cannot be prepared, such as a path out of reach, or a worker that fails.
    """
    wanted = sorted(set(runs), key=lambda run: (race.structure(run), run.cell, run.values))
    keys = {run: race.key(run) for run in wanted}
    missing = tuple(run for run in wanted if keys[run] not in kept.errors)
    state, began = State(len(wanted), kept=len(wanted) - len(missing)), time.monotonic()
    faults = defaultdict[str, list[Run]](list)

    def write(chunk: Chunk, answer: Computed) -> None:
        rows = list(zip(missing[chunk.point : chunk.end], answer.table["error"], answer.table["fault"], strict=True))
        for run, _, fault in rows:
            for line in fault.splitlines():
                faults[line].append(run)
        good = [(keys[run], error) for run, error, fault in rows if not fault]
        kept.write([key for key, _ in good], [error for _, error in good])

    def update() -> None:
        state.seconds = time.monotonic() - began
        report(state)

    update()
    if missing:
        heat = Heat(race, missing)
        with executor(heat) if executor else Pool(heat, workers) as pool:
            Dispatcher(write, pool, state, update).compute(iter(_chunks(race, missing)))
        update()
    for chunk, text in state.failed.items():
        faults[" ".join(text.split())].extend(missing[chunk.point : chunk.end])
    raise_all([EngineError(_listed(text, of)) for text, of in list(faults.items())[:MOST]])
    return {run: kept.errors[keys[run]] for run in wanted}


def _listed(fault: str, runs: Sequence[Run]) -> str:
    """Fault with the first run in which it occurred."""
    more = f" and {len(runs) - 1} more runs" if len(runs) > 1 else ""
    return f"{runs[0].law} in {runs[0].cell.name}{more}: {fault}"


def _chunks(race: Race, runs: Sequence[Run]) -> list[Chunk]:
    """Chunks of runs with one loop structure, which a worker compiles once."""
    found, first = list[Chunk](), 0
    for _, group in groupby(runs, race.structure):
        end = first + len(list(group))
        found += [Chunk(place, min(place + CHUNK, end), 0, 1) for place in range(first, end, CHUNK)]
        first = end
    return found
