"""Simulation of several twins at once along the commands of a log, compiled, or interpreted without a compiler."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from importlib.resources import files
from typing import Any, Final, final

import numpy as np

from dmframe.build import load
from dmframe.build.library import address
from dmframe.build.trial import called
from dmframe.codegen.function import SIMD, written
from dmframe.codegen.source import shipped
from dmframe.diagram.rosenbrock import ROS34PW2
from dmframe.identification.log import Log
from dmframe.identification.model import Array, Model

LONGEST: Final = 2e-3
"""Longest step of the integrator [s]."""
METHOD: Final = ROS34PW2
"""Linearly implicit in the joint velocities: the velocity loop of a light joint and dry friction are stiff."""


@final
@dataclass(frozen=True, eq=False)
class Schedule:
    """Segments of constant command between the samples of a log, for delays near one value.

    Parameters
    ----------
    length, slope
        Seconds of a segment, and their slope in the delay.
    command
        Row of the commands.
    steps
        Integrator steps.
    record
        Sample at the end of the segment, or -1.
    commands
        (rows, n) commands: rest, then those of the log.
    slot, gain
        (rows, n), the number of the twin that is added to a command, or -1, and the factor of it.
    """

    length: Array
    slope: Array
    command: Array
    steps: Array
    record: Array
    commands: Array
    slot: Array
    gain: Array
    samples: int


def schedule(log: Log, delay: float, step: float = LONGEST) -> Schedule:
    """Segments for commands that act `delay` [s] after they are sent; before the first command acts there is none.

    Row 0 of the commands is rest, row k + 1 the command k.
    """
    time = log.time
    acting, factor = log.acting(delay)
    instants = np.concatenate([time, acting])
    kinds = np.concatenate([np.zeros(len(time), int), np.ones(len(acting), int)])
    factors = np.concatenate([np.zeros(len(time)), factor])
    places = np.concatenate([np.arange(len(time)), np.arange(len(acting))])
    order = np.lexsort((kinds, instants))
    order = order[(instants[order] <= time[-1]) & (instants[order] >= time[0])]
    early = int(np.sum(acting < time[0]))
    instants, kinds, places = instants[order], kinds[order], places[order]
    row = np.maximum.accumulate(np.where(kinds == 1, places + 1, early))
    length, slope = np.diff(instants), np.diff(factors[order])
    steps = np.maximum(1, np.ceil(length / step - 1e-9)).astype(np.int64)
    record = np.where(kinds[1:] == 0, places[1:], -1).astype(np.int64)
    slot, gain = np.full((len(log.u) + 1, log.u.shape[1]), -1), np.zeros((len(log.u) + 1, log.u.shape[1]))
    for k, part in enumerate(log.unknown):
        slot[np.array(part.rows) + 1, part.joint] = k
        gain[np.array(part.rows) + 1, part.joint] = part.gains
    commands = np.vstack([np.zeros(log.u.shape[1]), log.u])
    return Schedule(
        length, slope, row[:-1].astype(np.int64), steps, record, commands, slot.astype(np.int64), gain, len(time)
    )


@final
@dataclass(frozen=True, eq=False)
class Twins:
    """A simulator of the twins of a robot.

    Parameters
    ----------
    model
        Their equations.
    library
        The compiled loop, or None.
    width
        Twins that one call of the loop advances.
    notice
        Why it is interpreted, or None.
    """

    model: Model
    library: Any
    width: int
    notice: str | None

    def positions(self, plan: Schedule, p: Array) -> Array:
        """Q of each twin at the samples: (samples, n, count) for the columns of p; NaN after a divergence."""
        count, found = p.shape[1], np.empty((plan.samples, self.model.n, p.shape[1]))
        for first in range(0, count, self.width):
            some = p[:, first : first + self.width]
            advanced = self._compiled if self.library is not None else self._interpreted
            found[:, :, first : first + some.shape[1]] = advanced(plan, some)
        found[0] = p[self.model.places["q_0"]]
        return found

    def _compiled(self, plan: Schedule, p: Array) -> Array:
        filled = np.ascontiguousarray(p[:, np.minimum(np.arange(self.width), p.shape[1] - 1)])
        q = np.empty((plan.samples, self.model.n, self.width))
        arrays = (plan.length, plan.slope, plan.command, plan.steps, plan.record)
        segments = ctypes.c_int64(len(plan.length))
        commands = map(address, (plan.commands, plan.slot, plan.gain))
        self.library.dm_twin(address(filled), *commands, segments, *map(address, arrays), address(q))
        return q[:, :, : p.shape[1]]

    def _interpreted(self, plan: Schedule, p: Array) -> Array:
        count, place, first = p.shape[1], self.model.places["delay"].start, self.model.places["command"].start
        x = np.array(self.model.begin.map(count)(p))
        q = np.full((plan.samples, self.model.n, count), np.nan)
        for k in range(len(plan.length)):
            row = plan.command[k]
            u = plan.commands[row][:, None] + plan.gain[row][:, None] * p[first + np.maximum(plan.slot[row], 0)]
            h = (plan.length[k] + plan.slope[k] * p[place]) / plan.steps[k]
            for _ in range(plan.steps[k]):
                x = self._step(x, u, p, h)
            if plan.record[k] >= 0:
                q[plan.record[k]] = x[: self.model.n]
        return q

    def _step(self, x: Array, u: Array, p: Array, h: Array) -> Array:
        """One step of the Rosenbrock method, as in ``twin.c``."""
        n, count = self.model.n, x.shape[1]
        rate, stages = self.model.rate.map(count), list[Array]()
        S = np.array(self.model.implicit.map(count)(x, p, h, rate(x, u, p))).reshape(n, count, n).transpose(1, 0, 2)
        for a, c in zip(METHOD.a, METHOD.c, strict=True):
            at = x + sum((float(weight) * stage for weight, stage in zip(a, stages, strict=True)), 0 * x)
            stage = h * np.array(rate(at, u, p))
            stage += sum((float(weight) * before for weight, before in zip(c, stages, strict=True)), 0 * x)
            stage[n : 2 * n] = np.einsum("kij,jk->ik", S, stage[n : 2 * n])
            stages.append(float(METHOD.gamma) * stage)
        return np.asarray(x + sum(float(weight) * stage for weight, stage in zip(METHOD.m, stages, strict=True)))


def _coefficients() -> str:
    """The coefficients of the method in C."""
    rows = {"a": METHOD.a, "c": METHOD.c}
    tables = [
        f"static const double dm_{name}[DM_STAGES][DM_STAGES] = "
        f"{{{', '.join('{' + ', '.join(map(repr, map(float, row or (0,)))) + '}' for row in table)}}};"
        for name, table in rows.items()
    ]
    return "\n".join(
        [
            f"#define DM_STAGES {METHOD.stages}",
            f"#define DM_GAMMA {float(METHOD.gamma)!r}",
            *tables,
            f"static const double dm_m[DM_STAGES] = {{{', '.join(map(repr, map(float, METHOD.m)))}}};",
        ]
    )


def twins_of(model: Model) -> Twins:
    """The simulator of a robot's twins, from the cache of compiled libraries, or compiled."""
    sizes = {"N": model.n, "X": 4 * model.n, "P": model.size}
    sizes |= {name.upper(): model.places[name].start for name in ("delay", "command")}
    source = "\n".join(
        [
            *map(shipped, SIMD.arithmetic),
            *(f"#define DM_{name} {size}" for name, size in sizes.items()),
            '#define DM_EXPORT __attribute__((visibility("default")))',
            written(model.begin, SIMD),
            written(model.rate, SIMD),
            written(model.implicit, SIMD),
            _coefficients(),
            files("dmframe.identification").joinpath("twin.c").read_text(encoding="utf-8"),
        ]
    )
    loaded = load(source, lambda library: called(library, "dm_width", [{"doubles": [0.0]}]) is not None)
    if loaded.library is None:
        return Twins(model, None, 64, loaded.notice)
    width = np.zeros(1)
    loaded.library.dm_width(address(width))
    return Twins(model, loaded.library, int(width[0]), loaded.notice)
