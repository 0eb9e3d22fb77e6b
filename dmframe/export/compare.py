"""Comparison of the exported C with the interpreter, each sample from equal states.

A comparison of whole trajectories cannot check a compiler: a law that switches, or an ill-conditioned least-squares
estimate, amplifies the last digit of one sample to the leading digits of a later one. The interpreter is therefore
evaluated at the states, measurements and times of the C, so that a difference is due to one sample.

Near a switch both results of a sample may be right: sines of two libraries differ in the last digit, which may decide a
comparison. The C's number is then accepted if the interpreter yields it after a perturbation of its inputs by some
units in the last place; the sample and the affected signals are reported.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Final

import casadi as ca
import numpy as np

from dmframe.common.errors import EngineError
from dmframe.diagram import Diagram
from dmframe.export.program import Member, Program
from dmframe.runtime.controller import control_function

if TYPE_CHECKING:
    from dmframe.export.replay import Samples

NEAR: Final = 1e-9
"""Tolerance relative to 1 + |number|, since the sines of two libraries differ."""

TRIALS: Final = 64
"""Number of perturbations of the inputs of a sample whose numbers differ."""

UNITS: Final = 4
"""Largest perturbation of an input [units in the last place]."""

CONDITION: Final = 100.0
"""Allowed effect of rounding within a sample, as a multiple of that of most perturbations."""

Numbers = Sequence[np.ndarray]


def compared(
    diagram: Diagram, program: Program, samples: Samples, taken: int, compiler: str
) -> tuple[Samples, tuple[str, ...]]:
    """Accepted samples of the C, and a description of each sample at which rounding decides a switch.

    Parameters
    ----------
    samples
        Samples that the C computed.
    taken
        Number of accepted samples; negative if the C refused its start.

    Raises
    ------
    EngineError
        A number of the C differs from the interpreter's from the same state.
    """
    control, p = control_function(diagram), diagram.loop.p_values
    names, period = _labels((*program.states, *program.commanded)), program.period

    def step(inputs: Numbers) -> np.ndarray:
        return _flat(control(*inputs, period, p))

    def start(inputs: Numbers) -> np.ndarray:
        return _flat([program.start(*inputs, period, [n for item in program.parameters for n in item.value])])

    def refuse(where: str, what: str) -> EngineError:
        return EngineError(f"{program.name}: {where}: {what}; set another compiler by $CC")

    if taken < 0:
        raise refuse("at the start", f"the code compiled by {compiler} refuses it, but the interpreter does not")
    switched = list[str]()
    for k in range(-1, taken):
        at = max(k, 0)
        inputs = [samples.measured[at], samples.times[at : at + 1]]
        found = samples.states[0]
        if k >= 0:
            inputs, found = [samples.states[k], *inputs], np.concatenate([samples.states[k + 1], samples.commanded[k]])
        where = f"sample {k} ({samples.times[at]:g} s), from the same state" if k >= 0 else "at the start"
        differing, expected, agrees = judged(step if k >= 0 else start, inputs, found)
        if not agrees:
            worst = int(differing[0])
            text = f"{names[worst]} is {found[worst]!r} in the code compiled by {compiler}"
            raise refuse(where, f"{text}, {expected[worst]!r} in the interpreter")
        if differing.size:
            switched.append(f"{where}: {', '.join(dict.fromkeys(_whole(names[place]) for place in differing))}")
    if taken < len(samples.times):
        inputs = [samples.states[taken], samples.measured[taken], samples.times[taken : taken + 1]]
        if taken == 0 or np.isfinite(step(inputs)).all():
            where = f"sample {taken} ({samples.times[taken]:g} s), from the same state"
            raise refuse(where, f"the code compiled by {compiler} refuses it, but the interpreter does not")
    return samples.first(taken), tuple(switched)


def judged(
    step: Callable[[Numbers], np.ndarray], inputs: Numbers, found: np.ndarray
) -> tuple[np.ndarray, np.ndarray, bool]:
    """Indices of numbers that differ from those of a step, the expected numbers, and True if rounding explains it.

    Rounding explains a number that the step yields for inputs perturbed by a few units in the last place. The effect of
    most of these perturbations is the rounding error of a step without a switch.
    """
    expected = step(inputs)
    gap = NEAR * (1 + np.abs(expected))
    with np.errstate(invalid="ignore"):
        differing = np.flatnonzero(~((np.abs(found - expected) <= gap) | (found == expected)))
        if differing.size == 0:
            return differing, expected, True
        rng = np.random.default_rng(0)
        moved = np.array([step([_moved(values, rng) for values in inputs]) for _ in range(TRIALS)])
        # at least a quarter of the perturbations stay on one side of a switch; a median might be the jump itself
        gap = gap + CONDITION * np.quantile(np.abs(moved - expected), 0.25, axis=0)
        reached = np.min(np.abs(moved - found), axis=0) <= gap
    return differing, expected, bool(np.all(reached[differing]))


def _moved(values: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    units = rng.integers(-UNITS, UNITS + 1, values.shape)
    moved: np.ndarray = values * (1 + np.finfo(float).eps * units)
    return moved


def _flat(parts: Sequence[ca.DM]) -> np.ndarray:
    return np.concatenate([part.full().ravel(order="F") for part in parts])


def _labels(members: Sequence[Member]) -> list[str]:
    return [f"{item.label}[{k}]" if item.size > 1 else item.label for item in members for k in range(item.size)]


def _whole(name: str) -> str:
    return name.partition("[")[0]
