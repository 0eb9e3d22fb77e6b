"""Whether an adaptive law is worth it on an identified robot: the race's protocol on the best fit and on draws."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, final

import numpy as np

from dmframe.build.compiler import find_compiler
from dmframe.errors import DisagreementError, DmframeError
from dmframe.files import write_text
from dmframe.identification.drawn import bodies_of
from dmframe.identification.found import Identified
from dmframe.identification.race_text import not_applicable, place_in, race_text
from dmframe.identification.robot_file import urdf_text
from dmframe.race.compute import Heat
from dmframe.race.protocol import Row
from dmframe.race.read import load_race
from dmframe.race.run import Finished, run_race
from dmframe.study.execute import State
from dmframe.study.executor import Executor
from dmframe.units import plain

DRAWS: Final = 20
LEAST_DRAWS: Final = 8
"""Fewest draws whose range counts as an interval."""
WORTH: Final = 0.2
"""Least decrease of the error, relative to that of the best rival, that is worth an adaptive law."""
RACE, FOLDER, ROBOT = "verdict.yaml", "verdict", "twin.urdf"

WORTH_IT, NOT_WORTH_IT, CANNOT_TELL, BY_PATH, NOT_COMPUTED = (
    "worth it",
    "not worth it",
    "cannot tell",
    "depends on the path",
    "not computed",
)


@final
@dataclass(frozen=True)
class Judged:
    """One law on one path.

    Parameters
    ----------
    error, interval
        Median, least and largest error over the draws [mm]; infinite for a run that diverged.
    values
        Tuned parameters.
    """

    law: str
    path: str
    error: float
    interval: tuple[float, float]
    values: Mapping[str, float]
    adaptive: bool

    @property
    def summary(self) -> dict[str, Any]:
        """Plain data for JSON; null instead of an infinite number."""
        error, low, high = (value if math.isfinite(value) else None for value in (self.error, *self.interval))
        about = {"law": self.law, "path": self.path, "error": error, "interval": [low, high]}
        return about | {"values": dict(self.values), "adaptive": self.adaptive}

    def __str__(self) -> str:
        return f"{_mm(self.error)} ({_mm(self.interval[0])} to {_mm(self.interval[1])})"


@final
@dataclass(frozen=True)
class Verdict:
    """The answer.

    Parameters
    ----------
    sentence
        In words.
    outcome
        worth it, not worth it, cannot tell, depends on the path, or not computed.
    laws
        Each law on each path.
    paths
        The paths on which the laws are judged, as parameters of `epicycles`, by name.
    draws, clock, resolution
        Number of draws, sampling period of the controllers [s], and error of the tool below which none counts [mm].
    """

    sentence: str
    outcome: str = NOT_COMPUTED
    laws: Sequence[Judged] = ()
    paths: Mapping[str, Any] = field(default_factory=dict)
    draws: int = 0
    clock: float = 0.0
    resolution: float = 0.0

    @property
    def summary(self) -> dict[str, Any]:
        """Plain data for JSON."""
        found: dict[str, Any] = {"sentence": self.sentence, "outcome": self.outcome}
        if self.outcome == NOT_COMPUTED:
            return found | {"laws": []}
        found |= {"laws": [judged.summary for judged in self.laws], "path": dict(self.paths), "draws": self.draws}
        return found | {"clock": self.clock, "resolution": self.resolution}


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
    """
    why = not_applicable(found) or ("" if find_compiler() else "there is no C compiler, without which it takes hours")
    place = None if why else place_in(found)
    if place is None:
        return Verdict(f"not computed: {why or 'no path of the tool fits within the joint positions of the log'}")

    def report(stage: str, state: State) -> None:
        say(f"verdict, {stage}: {state.kept} of {state.runs} runs after {state.seconds:.0f} s")

    chain = found.fit.unknowns.model.chain
    with tempfile.TemporaryDirectory() as temporary:
        where = folder or Path(temporary)
        write_text(where / ROBOT, urdf_text(chain, bodies_of(found.fit.unknowns, found.number("beta")[0])[0]))
        write_text(where / RACE, race_text(found, draws, place))
        try:
            finished = run_race(load_race(where / RACE), where / FOLDER, executor=executor, report=report)
        except DmframeError as error:
            return Verdict(f"not computed: the race of the laws failed: {error}")
    return decided(finished, 1000 * place.spread * found.fit.unknowns.log.noise)


def decided(finished: Finished, resolution: float) -> Verdict:
    """The verdict of a race.

    On each path, the adaptive law is worth it with a draw if its error is below that of the rival with the least median
    error by more than `WORTH` of it, and by more than the resolution [mm].

    Raises
    ------
    DisagreementError
        There are fewer than `LEAST_DRAWS` draws.
    """
    race, paths = finished.race, dict[str, list[Row]]()
    for row in finished.rows:
        paths.setdefault(row.cell.path, []).append(row)
    draws = min(len(rows) for rows in paths.values())
    if draws < LEAST_DRAWS:
        raise DisagreementError(f"verdict: expected at least {LEAST_DRAWS} draws for an interval, found {draws}")
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
    sentence = f"{'; '.join(texts)} ({draws} draws of the identified robot, sampled at {plain(clock, 's')})"
    judged_paths = {path: {**race.file.paths[path].parameters, "repeats": race.file.paths[path].repeats} for path in paths}
    return Verdict(sentence, outcome, laws, judged_paths, draws, clock, resolution)


def outcome_of(rows: Sequence[Row], rival: str, resolution: float) -> str:
    """The outcome on one path: the rows are the draws."""
    gains = [_worth(row.error, row.errors[rival], resolution) for row in rows]
    if any(math.isinf(row.error) and not math.isinf(row.errors[rival]) for row in rows):
        return NOT_WORTH_IT
    return WORTH_IT if all(gains) else CANNOT_TELL if any(gains) else NOT_WORTH_IT


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
    return (
        f"{outcome} on {where}{advice}; the tool's error is {entrant} with {entrant.law} and {rival} with "
        f"{rival.law}, the best of the tuned laws without a model"
    )


def _mm(value: float) -> str:
    return "diverged" if math.isinf(value) else f"{value:.2g} mm"
