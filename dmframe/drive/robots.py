"""The robots that can be driven, by what is typed: ``sim``, ``sim:2``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, final

from dmframe.config.experiment import Experiment
from dmframe.diagram import Diagram
from dmframe.errors import DriveError, UnknownNameError, ValueFault
from dmframe.runtime.robot import Robot
from dmframe.runtime.simulated import SimulatedRobot
from dmframe.simulate.engine import Choice

MOST_DELAY: Final = 100


@final
@dataclass(frozen=True)
class Kind:
    """A kind of driver.

    Parameters
    ----------
    real
        It moves something: limits and a rehearsal are asked for.
    make
        From what stands after the colon, the graph and the time to drive [s].
    """

    real: bool
    make: Callable[[str, Experiment, Diagram, float, Choice], Robot]


def simulated_robot(
    experiment: Experiment, diagram: Diagram, duration: float, engine: Choice = "auto", **options: Any
) -> SimulatedRobot:
    """The graph's own robot; options as of `SimulatedRobot`."""
    own = {key: experiment.settings[key] for key in ("start", "solver", "seed", "jitter")}
    return SimulatedRobot(diagram, clock_of(experiment), duration=duration, engine=engine, **{**own, **options})


def clock_of(experiment: Experiment) -> float:
    """The sampling period [s]. Raises `DriveError` in continuous time."""
    clock = experiment.file.clock
    if clock is None:
        raise DriveError(
            f"{experiment.name}: expected a clock such as 8 ms, found continuous; set one: --set clock='8 ms'"
        )
    return clock


def _simulated(text: str, experiment: Experiment, diagram: Diagram, duration: float, engine: Choice) -> Robot:
    if text and not (text.isascii() and text.isdigit() and int(text) <= MOST_DELAY):
        raise ValueFault(
            f"--robot sim:{text}: expected how many samples late commands act, sim:2, at most {MOST_DELAY}"
        )
    return simulated_robot(experiment, diagram, duration, engine, delay=int(text or 0))


KINDS: Final[dict[str, Kind]] = {"sim": Kind(real=False, make=_simulated)}
"""By what stands before the colon."""


def kind_of(name: str) -> tuple[Kind, str]:
    """The kind of driver, and what stands after the colon. Raises `UnknownNameError`."""
    word, _, rest = name.partition(":")
    if word not in KINDS:
        raise UnknownNameError(f"--robot {name}", "kind of robot", word, KINDS)
    return KINDS[word], rest
