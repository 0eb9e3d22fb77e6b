"""The exported C compared with the interpreter, each sample from equal states.

A replay of a whole trajectory cannot judge a compiler: a law that switches, or a least-squares estimate that is badly
conditioned, turns the last digit of one sample into the leading digits of a later one. Here the interpreter is
evaluated at the states, measurements and times of the C, so that a difference is that of one sample.

Close to a switch one sample may still have two right answers: sines of two libraries differ in the last digit, and a
comparison that this digit decides goes either way. The C's number is then accepted if, and only if, the interpreter
reaches it when its inputs move by some units in the last place; the sample and what the switch decides are reported.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Final

import casadi as ca
import numpy as np

from dmframe.diagram import Diagram
from dmframe.errors import EngineError
from dmframe.export.program import Member, Program
from dmframe.runtime.controller import control_function

if TYPE_CHECKING:
    from dmframe.export.replay import Samples

NEAR: Final = 1e-9
"""Relative to one plus a number: how far the C's may be from an interpreter's, whose sines are another library's."""

TRIALS: Final = 64
"""Times that the inputs of a sample are moved, where its numbers differ."""

UNITS: Final = 4
"""In the last place, by which each input is moved at most."""

CONDITION: Final = 100.0
"""Times what most of these moves change: so much may rounding inside of a sample change, more than at its inputs."""

Numbers = Sequence[np.ndarray]


def compared(
    diagram: Diagram, program: Program, samples: Samples, taken: int, compiler: str
) -> tuple[Samples, tuple[str, ...]]:
    """The samples that the C has taken, and words for each at which rounding decides a switch.

    Parameters
    ----------
    samples
        As the C computed them in a row.
    taken
        How many it took; negative where it refused its start.

    Raises
    ------
    EngineError
        A number of the C is not the interpreter's, begun from the same state.
    """
    control, p = control_function(diagram), diagram.loop.p_values
    names, period = _labels((*program.states, *program.commanded)), program.period

    def step(inputs: Numbers) -> np.ndarray:
        return _flat(control(*inputs, period, p))

    def start(inputs: Numbers) -> np.ndarray:
        return _flat([program.start(*inputs, period, [n for item in program.parameters for n in item.value])])

    def refuse(where: str, what: str) -> EngineError:
        return EngineError(f"{program.name}: {where}: {what}; name another compiler by $CC")

    if taken < 0:
        raise refuse("at the start", f"the program that {compiler} makes refuses it, and the interpreter does not")
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
            text = f"{names[worst]} is {found[worst]!r} in the program that {compiler} makes"
            raise refuse(where, f"{text}, {expected[worst]!r} in the interpreter")
        if differing.size:
            switched.append(f"{where}: {', '.join(dict.fromkeys(_whole(names[place]) for place in differing))}")
    if taken < len(samples.times):
        inputs = [samples.states[taken], samples.measured[taken], samples.times[taken : taken + 1]]
        if taken == 0 or np.isfinite(step(inputs)).all():
            where = f"sample {taken} ({samples.times[taken]:g} s), from the same state"
            raise refuse(where, f"the program that {compiler} makes refuses it, and the interpreter does not")
    return samples.first(taken), tuple(switched)


def judged(
    step: Callable[[Numbers], np.ndarray], inputs: Numbers, found: np.ndarray
) -> tuple[np.ndarray, np.ndarray, bool]:
    """Which of the numbers found differ from those of a step, these, and whether rounding explains it.

    Rounding explains a number that the step gives when its inputs move by a few units in the last place. How far most
    of these moves change a number is the rounding that a step has without any switch.
    """
    expected = step(inputs)
    gap = NEAR * (1 + np.abs(expected))
    with np.errstate(invalid="ignore"):
        differing = np.flatnonzero(~((np.abs(found - expected) <= gap) | (found == expected)))
        if differing.size == 0:
            return differing, expected, True
        rng = np.random.default_rng(0)
        moved = np.array([step([_moved(values, rng) for values in inputs]) for _ in range(TRIALS)])
        # a quarter of the moves at least stay on one side of a switch; a median might be the jump itself
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
