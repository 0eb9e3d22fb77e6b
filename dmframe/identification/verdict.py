"""Whether an adaptive law is worth it on an identified robot: the race's protocol on the best fit and on draws."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from dmframe.build.compiler import find_compiler
from dmframe.common.errors import DisagreementError, DmframeError, OutputError, ValueFault
from dmframe.common.files import write_text
from dmframe.common.units import plain
from dmframe.identification.answer import (
    BY_PATH,
    NOT_WORTH_IT,
    UNDECIDED,
    WORTH_IT,
    Judged,
    Verdict,
    millimetres,
)
from dmframe.identification.found import Identified
from dmframe.identification.race_text import FIT, noise_of, not_applicable, place_in, race_text
from dmframe.identification.write import RACE, ROBOT, VERDICT, robot_text, written
from dmframe.race.compute import Heat
from dmframe.race.plan import Run
from dmframe.race.protocol import Row
from dmframe.race.read import load_race
from dmframe.race.run import Finished, run_race
from dmframe.study.execute import State
from dmframe.study.executor import Executor
from dmframe.study.packing import write_graph

DRAWS: Final = 20
LEAST_DRAWS: Final = 8
"""Fewest draws whose range counts as an interval."""
WORTH: Final = 0.2
"""Least decrease of the error, relative to that of the best rival, that is worth an adaptive law."""
LEAST: Final = 1e-3
"""Smallest resolution: of a log without noise [mm]."""


def with_verdict(
    found: Identified, folder: Path | None = None, say: Callable[[str], None] = lambda text: None
) -> Identified:
    """The result with its verdict; in a folder, its files are written again."""
    found = replace(found, verdict=verdict_of(found, folder, say=say))
    if folder is not None:
        written(found, folder)
    return found


def verdict_of(
    found: Identified,
    folder: Path | None = None,
    *,
    draws: int = DRAWS,
    executor: Callable[[Heat], Executor] | None = None,
    say: Callable[[str], None] = lambda text: None,
) -> Verdict:
    """Tune the laws on the best fit, run them on draws from the covariance of the fit, and decide.

    Parameters
    ----------
    folder
        Where the race is kept, as ``verdict.yaml`` with its results in ``verdict/``; a temporary one by default.
    executor
        Makes what computes the runs, as in `run_race`.

    Raises
    ------
    ValueFault, OutputError
        Too few draws, or a folder that cannot be written.
    """
    if draws < LEAST_DRAWS:
        raise ValueFault(f"draws: expected at least {LEAST_DRAWS} for an interval, found {draws}")
    why = not_applicable(found) or ("" if find_compiler() else "there is no C compiler, without which it takes hours")
    place = None if why else place_in(found)
    if place is None:
        return Verdict(f"not computed: {why or 'no path of the tool fits within the joint positions of the log'}")

    def report(stage: str, state: State) -> None:
        say(f"verdict, {stage}: {state.kept} of {state.runs} runs after {state.seconds:.0f} s")

    with tempfile.TemporaryDirectory() as temporary:
        where = folder or Path(temporary)
        write_text(where / ROBOT, robot_text(found))
        write_text(where / RACE, race_text(found, draws, place))
        try:
            finished = run_race(load_race(where / RACE), where / VERDICT, executor=executor, report=report)
        except OutputError:
            raise
        except DmframeError as error:
            return Verdict(f"not computed: the race of the laws failed: {error}")
        _write_graphs(finished, where / VERDICT)
    return decided(finished, max(LEAST, 1000 * place.spread * noise_of(found)))


def _write_graphs(finished: Finished, folder: Path) -> None:
    """Write each tuned law on the best fit as a graph, on the first of the paths on which the laws are judged."""
    race = finished.race
    cell = replace(race.held_out[0], plant=FIT)
    for choice in finished.choices:
        if choice.best is not None:
            graph = race.graph(Run(choice.law, cell, choice.best.values, race.file.seed + 1))
            write_graph(graph.set({"arm.bodies": None}), folder / f"{choice.law}.yaml")  # those of the robot's file


def decided(finished: Finished, resolution: float) -> Verdict:
    """The verdict of a race.

    On each path, the adaptive law is worth it with a draw if its error is below that of the rival with the least median
    error by more than `WORTH` of it, and by more than the resolution [mm].

    Raises
    ------
    DisagreementError
        There are fewer than `LEAST_DRAWS` draws, or a law was not tuned with as many candidates as the race prescribes.
    """
    race, paths = finished.race, dict[str, list[Row]]()
    for row in finished.rows:
        paths.setdefault(row.cell.path, []).append(row)
    draws = min(len(rows) for rows in paths.values())
    if draws < LEAST_DRAWS:
        raise DisagreementError(f"verdict: expected at least {LEAST_DRAWS} draws for an interval, found {draws}")
    tried = {choice.law: len(choice.tried) for choice in finished.choices}
    if untuned := [law for law in race.file.laws if tried.get(law) != race.file.budget]:
        raise DisagreementError(
            f"verdict: {untuned[0]} was not tuned by the protocol: expected {race.file.budget} candidates, found "
            f"{tried.get(untuned[0], 0)}"
        )
    values = {choice.law: dict(choice.best.values) for choice in finished.choices if choice.best is not None}
    laws, outcomes, texts = list[Judged](), list[str](), list[str]()
    for path, rows in paths.items():
        own = {
            law: _judged(law, path, [row.errors[law] for row in rows], values.get(law, {}), law == race.file.entrant)
            for law in race.file.laws
        }
        rival = min((judged for judged in own.values() if not judged.adaptive), key=lambda judged: judged.error)
        outcomes.append(outcome_of(rows, rival.law, resolution))
        texts.append(_text(outcomes[-1], own[race.file.entrant], rival, race.file.paths[path].repeats is not None))
        laws += sorted(own.values(), key=lambda judged: judged.error)
    outcome = outcomes[0] if len(set(outcomes)) == 1 else BY_PATH
    clock = race.file.clocks[0]
    sentence = (
        f"{', '.join(texts)}; RMS of the tool's error over {draws} draws of the identified robot, sampled at "
        f"{plain(clock, 's')}; a difference below {millimetres(resolution)} mm, the position noise at the tool, "
        "does not count"
    )
    drawn = {name: race.file.paths[name] for name in paths}
    about = {name: {**path.parameters, "repeats": path.repeats} for name, path in drawn.items()}
    return Verdict(sentence, outcome, laws, about, draws, clock, resolution)


def outcome_of(rows: Sequence[Row], rival: str, resolution: float) -> str:
    """The outcome on one path: the rows are the draws."""
    gains = [_worth(row.error, row.errors[rival], resolution) for row in rows]
    if any(math.isinf(row.error) and not math.isinf(row.errors[rival]) for row in rows):
        return NOT_WORTH_IT
    return WORTH_IT if all(gains) else UNDECIDED if any(gains) else NOT_WORTH_IT


def _worth(error: float, rival: float, resolution: float) -> bool:
    return error < rival if math.isinf(rival) else rival - error > max(WORTH * rival, resolution)


def _judged(law: str, path: str, errors: Sequence[float], values: Mapping[str, float], adaptive: bool) -> Judged:
    ordered = np.sort(errors)
    middle = ordered[(len(ordered) - 1) // 2 : len(ordered) // 2 + 1]
    return Judged(law, path, float(np.mean(middle)), (float(ordered[0]), float(ordered[-1])), values, adaptive)


def _text(outcome: str, entrant: Judged, rival: Judged, repeats: bool) -> str:
    """The outcome on one path in words."""
    where = "a path that repeats" if repeats else "a path that never repeats"
    advice = f": take {rival.law}" if outcome == NOT_WORTH_IT else ""
    return f"{outcome} on {where}{advice} ({entrant}; {rival})"
