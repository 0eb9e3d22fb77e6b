"""Samples of a simulation for the test of an exported controller."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final, NamedTuple, final

import numpy as np

from dmframe.build.compiler import CompileFailed, find_compiler
from dmframe.build.trial import called
from dmframe.common.errors import EngineError
from dmframe.common.files import encoded
from dmframe.config import BaseGraph
from dmframe.diagram import Diagram
from dmframe.export.compare import compared
from dmframe.export.program import Member, Program
from dmframe.runtime.controller import Controller
from dmframe.simulate import Log, simulate

SAMPLES: Final = 250
"""Largest number of samples in the test."""

NUMBERS: Final = 1 << 17
"""Largest number of state values in the test: 3 MB of text."""


@final
class Samples(NamedTuple):
    """First samples of a simulation, one row each; `states` has one more row, after the last sample."""

    times: np.ndarray
    measured: np.ndarray
    commanded: np.ndarray
    states: np.ndarray

    def first(self, count: int) -> Samples:
        """The first of them."""
        return Samples(self.times[:count], self.measured[:count], self.commanded[:count], self.states[: count + 1])


@final
class Computed(NamedTuple):
    """Samples that the C computed, and a description of each sample at which rounding decides a switch."""

    samples: Samples
    switched: tuple[str, ...]


def samples_of(graph: BaseGraph, program: Program) -> Samples:
    """Measurements of a simulation, and the commands and states that the controller computes from them.

    Raises `EngineError` if the first results are not finite.
    """
    count = max(1, min(SAMPLES, round(graph.file.duration / program.period)))
    run = simulate(
        graph.diagram, count * program.period, **{**graph.settings, "solver": graph.solver.automatic, "log": Log()}
    )
    times, commanded, states = run.time[:count], list[np.ndarray](), list[np.ndarray]()
    measured = np.hstack([run[item.label][: len(times)].reshape(len(times), -1) for item in program.measured])
    controller = Controller(graph.diagram, program.period, start=graph.start, engine="interpreted")
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
            f"{graph.name}: commands or states of the first sample are not finite; there is no law to export"
        )
    return Samples(times[:done], measured[:done], np.array(commanded), np.array(states))


def _row(values: Mapping[str, np.ndarray], members: Iterable[Member]) -> np.ndarray:
    return np.concatenate([np.zeros(0), *(values[item.label] for item in members)])


def computed_by_c(diagram: Diagram, program: Program, texts: Mapping[str, str], samples: Samples) -> Computed | None:
    """Results of the compiled C for the samples; None if no compiler works.

    Each sample is compared with the interpreter's from the same state, so that a law that amplifies rounding, or
    switches by it, is accepted.

    Raises `EngineError` for a compiler whose results differ from the interpreter's.
    """
    compiler = find_compiler()
    if compiler is None:
        return None
    with TemporaryDirectory(prefix="dmframe-") as folder:
        place = Path(folder)
        library = place / "replay.so"
        try:
            for name, text in texts.items():
                (place / name).write_bytes(encoded(text))  # temporary: no sync to the disk
            compiler.build_plain([place / f"{program.name}.c", place / "replay.c"], library, define="DM_NO_MAIN")
        except (OSError, CompileFailed):
            return None
        given = (samples.measured, samples.times, 0 * samples.commanded, 0 * samples.states, np.zeros(1))
        found = called(library, "dm_chain", [{"doubles": np.ravel(array).tolist()} for array in given])
    if found is None:
        return None
    count, width = len(samples.times), samples.states.shape[1]
    states = np.reshape(found[3][: (count + 1) * width], (count + 1, width))
    mine = samples._replace(commanded=np.reshape(found[2], (count, -1)), states=states)
    return Computed(*compared(diagram, program, mine, round(found[4][0]), compiler.command[0]))


def kept(samples: Samples) -> Samples:
    """Samples of an exported folder; fewer if the law has thousands of states."""
    return samples.first(max(8, NUMBERS // max(1, samples.states.shape[1])))


def sizes_as_c(samples: Samples, *, exact: bool) -> str:
    """Sizes of the samples as C."""
    lines = [
        "/* Measurements of a robot in a simulation, and commands of the controller. */",
        f"#define DM_SAMPLES {len(samples.times)}",
        f"#define DM_MEASURED {samples.measured.shape[1]}",
        f"#define DM_COMMANDED {samples.commanded.shape[1]}",
        f"#define DM_STATES {samples.states.shape[1]}",
        f"#define DM_EXACT {int(exact)} /* 1: computed by this C; 0: by an interpreter, to rounding */",
    ]
    return "\n".join([*lines, ""])


def samples_as_c(samples: Samples, *, exact: bool) -> str:
    """Samples as C."""
    lines = [sizes_as_c(samples, exact=exact)]
    for name, array in zip(("times", "measured", "commands", "state"), samples, strict=True):
        rows = np.atleast_2d(array) if array.size else np.zeros((1, 1))
        lines.append(f"static const double dm_{name}[{max(1, array.size)}] = {{")
        lines += [f"    {', '.join(float(value).hex() for value in row)}," for row in rows]
        lines.append("};")
    return "\n".join([*lines, ""])


def first_sample(program: Program, samples: Samples) -> str:
    """First sample as the initial value of a struct."""
    parts = np.split(samples.measured[0], np.cumsum([item.size for item in program.measured])[:-1])
    return ", ".join(f"{{{', '.join(map(repr, part.tolist()))}}}" for part in parts)
