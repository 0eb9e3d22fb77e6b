"""Samples of a simulation, with which an exported controller's test compares what a compiler makes of it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final, NamedTuple, final

import numpy as np

from dmframe.build.cache import CompileFailed
from dmframe.build.compiler import find_compiler
from dmframe.build.trial import called
from dmframe.config.experiment import Experiment
from dmframe.diagram import Diagram
from dmframe.errors import EngineError
from dmframe.export.compare import compared
from dmframe.export.program import Member, Program
from dmframe.files import write_text
from dmframe.runtime.controller import Controller
from dmframe.simulate import Log, simulate

SAMPLES: Final = 250
"""Of a simulation, with which the test compares the C, at most."""

NUMBERS: Final = 1 << 17
"""Of the states in the shipped test, at most: 3 MB of text."""


@final
class Samples(NamedTuple):
    """The first samples of a simulation, a row each; of the controller's states one more, that after the last."""

    times: np.ndarray
    measured: np.ndarray
    commanded: np.ndarray
    states: np.ndarray

    def first(self, count: int) -> Samples:
        """The first of them."""
        return Samples(self.times[:count], self.measured[:count], self.commanded[:count], self.states[: count + 1])


@final
class Computed(NamedTuple):
    """Samples as the C computes them, and the words for each sample at which rounding decides a switch."""

    samples: Samples
    switched: tuple[str, ...]


def samples_of(experiment: Experiment, diagram: Diagram, program: Program) -> Samples:
    """What the plant showed in a simulation, and what the controller makes of it when it begins there.

    Raises `EngineError` for a law whose first numbers are not finite.
    """
    count = max(1, min(SAMPLES, round(experiment.file.duration / program.period)))
    run = simulate(diagram, count * program.period, **{**experiment.settings, "log": Log()})
    times, commanded, states = run.time[:count], list[np.ndarray](), list[np.ndarray]()
    measured = np.hstack([run[item.label][: len(times)].reshape(len(times), -1) for item in program.measured])
    controller = Controller(diagram, program.period, start=experiment.start, engine="interpreted")
    for k, (t, row) in enumerate(zip(times.tolist(), measured, strict=True)):
        parts = np.split(row, np.cumsum([item.size for item in program.measured])[:-1])
        for item, part in zip(program.measured, parts, strict=True):
            controller.measured[item.label][:] = part
        if k == 0:
            controller.reset(measured=True, t=t)
            states.append(_row(controller.states, program.states))
        if not controller.step(t):
            break
        commanded.append(_row(controller.commanded, program.commanded))
        states.append(_row(controller.states, program.states))
    done = len(commanded)
    if done == 0:
        raise EngineError(
            f"{experiment.name}: its first sample leads to numbers that are not finite; there is no law to export"
        )
    return Samples(times[:done], measured[:done], np.array(commanded), np.array(states))


def _row(values: Mapping[str, np.ndarray], members: Iterable[Member]) -> np.ndarray:
    return np.concatenate([np.zeros(0), *(values[item.label] for item in members)])


def computed_by_c(diagram: Diagram, program: Program, texts: Mapping[str, str], samples: Samples) -> Computed | None:
    """What the C itself makes of the samples; None where no compiler works here.

    Each sample of the C is compared with the interpreter's from the same state, so that a law that amplifies rounding,
    or switches by it, does not count as another law. It costs one evaluation a sample.

    Raises `EngineError` for a compiler whose numbers are not those of the interpreter.
    """
    compiler = find_compiler()
    if compiler is None:
        return None
    with TemporaryDirectory(prefix="dmframe-") as folder:
        place = Path(folder)
        for name, text in texts.items():
            write_text(place / name, text)
        library = place / "replay.so"
        try:
            compiler.build_plain([place / f"{program.name}.c", place / "replay.c"], library, define="DM_NO_MAIN")
        except (OSError, CompileFailed):
            return None
        given = (samples.measured, samples.times, 0 * samples.commanded, 0 * samples.states, np.zeros(1))
        found = called(library, "dm_chain", [{"doubles": np.ravel(array).tolist()} for array in given])
    if found is None:
        return None
    count, width = len(samples.times), samples.states.shape[1]
    commanded, states = (
        np.reshape(found[2], (count, -1)),
        np.reshape(found[3][: (count + 1) * width], (count + 1, width)),
    )
    mine = samples._replace(commanded=commanded, states=states)
    return Computed(*compared(diagram, program, mine, round(found[4][0]), compiler.command[0]))


def kept(samples: Samples) -> Samples:
    """Those that an exported folder holds: fewer where the law has thousands of states."""
    return samples.first(max(8, NUMBERS // max(1, samples.states.shape[1])))


def sizes_as_c(samples: Samples, *, exact: bool) -> str:
    """How many samples there are, and of which sizes, as C."""
    lines = [
        "/* What a robot showed in a simulation, and what the controller then commands. */",
        f"#define DM_SAMPLES {len(samples.times)}",
        f"#define DM_MEASURED {samples.measured.shape[1]}",
        f"#define DM_COMMANDED {samples.commanded.shape[1]}",
        f"#define DM_STATES {samples.states.shape[1]}",
        f"#define DM_EXACT {int(exact)} /* 1: computed by this C; 0: by an interpreter, to rounding */",
    ]
    return "\n".join([*lines, ""])


def samples_as_c(samples: Samples, *, exact: bool) -> str:
    """The samples as C."""
    lines = [sizes_as_c(samples, exact=exact)]
    for name, array in zip(("times", "measured", "commands", "state"), samples, strict=True):
        rows = np.atleast_2d(array) if array.size else np.zeros((1, 1))
        lines.append(f"static const double dm_{name}[{max(1, array.size)}] = {{")
        lines += [f"    {', '.join(float(value).hex() for value in row)}," for row in rows]
        lines.append("};")
    return "\n".join([*lines, ""])


def first_sample(program: Program, samples: Samples) -> str:
    """The first sample as the initial value of a struct."""
    parts = np.split(samples.measured[0], np.cumsum([item.size for item in program.measured])[:-1])
    return ", ".join(f"{{{', '.join(map(repr, part.tolist()))}}}" for part in parts)
