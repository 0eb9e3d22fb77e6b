"""Samples of a simulation, to which an exported controller's test holds any compiler."""

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
from dmframe.export.program import Program
from dmframe.files import write_text
from dmframe.runtime.controller import Controller
from dmframe.simulate import Log, simulate

SAMPLES: Final = 250
"""Of a simulation, that the test holds the C to."""

NEAR: Final = 1e-9
"""Relative to one plus a number: how far the C's may be from an interpreter's, whose sines are another library's."""


@final
class Samples(NamedTuple):
    """The first samples of a simulation, a row each, and the controller's states after the last."""

    times: np.ndarray
    measured: np.ndarray
    commanded: np.ndarray
    state: np.ndarray


def samples_of(experiment: Experiment, diagram: Diagram, program: Program) -> Samples:
    """What the plant showed in a simulation, and what the controller makes of it when it begins there.

    Raises `EngineError` for a law whose first numbers are not finite.
    """
    count = max(1, min(SAMPLES, round(experiment.file.duration / program.period)))
    run = simulate(diagram, count * program.period, **{**experiment.settings, "log": Log()})
    times, commanded = run.time[:count], list[np.ndarray]()
    measured = np.hstack([run[item.label][: len(times)].reshape(len(times), -1) for item in program.measured])
    controller = Controller(diagram, program.period, start=experiment.start, engine="interpreted")
    for k, (t, row) in enumerate(zip(times.tolist(), measured, strict=True)):
        parts = np.split(row, np.cumsum([item.size for item in program.measured])[:-1])
        for item, part in zip(program.measured, parts, strict=True):
            controller.measured[item.label][:] = part
        if k == 0:
            controller.reset(measured=True, t=t)
        if not controller.step(t):
            break
        commanded.append(np.concatenate([controller.commanded[item.label] for item in program.commanded]))
    done = len(commanded)
    if done == 0:
        raise EngineError(
            f"{experiment.name}: its first sample leads to numbers that are not finite; there is no law to export"
        )
    state = np.concatenate([np.zeros(0), *(controller.states[item.label] for item in program.states)])
    return Samples(times[:done], measured[:done], np.array(commanded), state)


def computed_by_c(program: Program, texts: Mapping[str, str], samples: Samples) -> Samples | None:
    """What the C itself makes of the samples; None where no compiler works here.

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
        count = sum(item.size for item in program.states)
        given = (samples.measured, samples.times, 0 * samples.commanded, np.zeros(max(1, count)))
        found = called(library, "dm_replay", [{"doubles": np.ravel(array).tolist()} for array in given])
    if found is None:
        return None
    commanded, state = np.reshape(found[2], samples.commanded.shape), np.array(found[3][:count])
    for mine, theirs in ((commanded, samples.commanded), (state, samples.state)):
        if not np.allclose(mine, theirs, rtol=NEAR, atol=NEAR):
            raise EngineError(
                f"{compiler.command[0]} makes of it a program that computes other numbers; name another compiler by $CC"
            )
    return samples._replace(commanded=commanded, state=state)


def samples_as_c(samples: Samples, *, exact: bool) -> str:
    """The samples as C."""
    lines = [
        "/* What a robot showed in a simulation, and what the controller then commands. */",
        f"#define DM_SAMPLES {len(samples.times)}",
        f"#define DM_MEASURED {samples.measured.shape[1]}",
        f"#define DM_COMMANDED {samples.commanded.shape[1]}",
        f"#define DM_EXACT {int(exact)} /* 1: computed by this C; 0: by an interpreter, to rounding */",
    ]
    for name, array in zip(("times", "measured", "commands", "state"), samples, strict=True):
        rows = np.atleast_2d(array) if array.size else np.zeros((1, 1))
        lines.append(f"static const double dm_{name}[{max(1, array.size)}] = {{")
        lines += [f"    {_row(row)}," for row in rows]
        lines.append("};")
    return "\n".join([*lines, ""])


def _row(values: Iterable[float]) -> str:
    """Numbers of C that are these doubles to the last bit."""
    return ", ".join(float(value).hex() for value in values)


def first_sample(program: Program, samples: Samples) -> str:
    """The first sample as the initial value of a struct."""
    parts = np.split(samples.measured[0], np.cumsum([item.size for item in program.measured])[:-1])
    return ", ".join(f"{{{', '.join(map(repr, part.tolist()))}}}" for part in parts)
