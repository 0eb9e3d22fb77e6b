r"""Reported estimates of a run: mean over the last eighth, and excitation by the motion.

An adapting block updates its estimates :math:`\hat\theta` along :math:`-W^\top s` with the driving error s, and an
estimation error :math:`\tilde\theta` acts on the loop by :math:`W \tilde\theta`. Over the last eighth of a run,

.. math:: F = \overline{W^\top W}, \quad \mathrm{excitation}(y) = (g^\top F^{+} g)^{-1/2}, \quad
    g = \partial y/\partial\hat\theta

is the RMS effect of a unit change of y that the other estimates of the block cannot compensate; zero where the motion
does not excite y. For a sliding variable in rad/s it is a torque in N m per unit of y.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final, final

import casadi as ca
import numpy as np

from dmframe.block import AdaptingBlock
from dmframe.block.model import symbols_in
from dmframe.block.naming import reading
from dmframe.block.numberless import without_numbers
from dmframe.common.units import plain
from dmframe.diagram import Diagram
from dmframe.diagram.closed_loop import Signal
from dmframe.diagram.view import view
from dmframe.results.metrics import EIGHTHS
from dmframe.simulate import Recording

MOST: Final = 400
"""Maximum number of instants at which W is evaluated."""

SMALL: Final = 1e-9
"""Eigenvalue of F, relative to the largest, below which a direction counts as not excited."""


@final
@dataclass(frozen=True)
class ReportedEstimate:
    """Reported output of a block, over the last eighth of a run.

    Parameters
    ----------
    label, words, unit
        ``block.port``, description and unit.
    values
        Mean values.
    excitation
        RMS effect of a unit change of each value [N m for an error in rad/s]; None if the output depends on no
        estimate, or on those of several blocks.
    """

    label: str
    words: str
    unit: str
    values: tuple[float, ...]
    excitation: tuple[float, ...] | None

    def __str__(self) -> str:
        values = ", ".join(plain(value, self.unit) for value in self.values)
        text = f"{self.words} {values if len(self.values) == 1 else f'[{values}]'}"
        if self.excitation is None:
            return text
        effects = ", ".join(f"{value:.3g}" for value in self.excitation)
        return f"{text}, excitation {effects if len(self.excitation) == 1 else f'[{effects}]'} N m/{self.unit or '1'}"

    @property
    def felt(self) -> tuple[float, ...] | None:
        """Former name of `excitation`."""
        warnings.warn("ReportedEstimate: felt is now excitation", DeprecationWarning, stacklevel=2)
        return self.excitation


def reported_estimates(run: Recording) -> list[ReportedEstimate]:
    """Reported outputs in diagram order; empty for a run that did not reach its last eighth."""
    last = np.flatnonzero(run.time >= run.duration * (1 - 1 / EIGHTHS))
    if (
        run.divergence is not None
        or not last.size
        or not set(run.states) >= {v.label for v in run.diagram.loop.variables}
    ):
        return []
    chosen, found = last[sorted({*np.linspace(0, last.size - 1, MOST).astype(int).tolist()})], list[ReportedEstimate]()
    for signal, words in _showing(run.diagram):
        values = _at(run, signal.expression, chosen).mean(axis=0)
        effects = _excitation(run, signal, chosen)
        effect = None if effects is None else tuple(map(float, effects))
        found.append(ReportedEstimate(signal.label, words, signal.unit, tuple(map(float, values.ravel())), effect))
    return found


def _showing(diagram: Diagram) -> Iterator[tuple[Signal, str]]:
    texts = {f"{name}.{port.name}": port.shown for name, block in diagram.blocks.items() for port in block.outputs}
    yield from ((signal, texts[signal.label]) for signal in diagram.loop.outputs if texts.get(signal.label))


def _excitation(run: Recording, signal: Signal, chosen: np.ndarray) -> np.ndarray | None:
    """Excitation of a reported output, see the module docstring."""
    behind = [
        (name, item.name)
        for name, model in run.diagram.models.items()
        for item in model.estimates
        if symbols_in([signal.expression]) & symbols_in([model.states[item.name]])
    ]
    if len({name for name, _ in behind}) != 1:
        return None
    name, block = behind[0][0], run.diagram.blocks[behind[0][0]]
    states = [run.diagram.models[name].states[estimate] for _, estimate in behind]
    if not isinstance(block, AdaptingBlock) or not all(state.is_column() for state in states):
        return None
    found = [_regressor(run.diagram, name, block, estimate) for _, estimate in behind]
    if any(W is None for W in found):
        return None
    W, together = ca.horzcat(*found), ca.vertcat(*states)
    gradient = _at(run, ca.jacobian(ca.vec(signal.expression), together), chosen).mean(axis=0)
    return excitation(np.vstack(list(_at(run, W, chosen))), len(chosen), gradient)


def excitation(rows: np.ndarray, instants: int, gradients: np.ndarray) -> np.ndarray:
    """RMS effect of unit changes along `gradients`, from the stacked W of some instants."""
    sizes = np.linalg.norm(rows, axis=0)
    sizes[sizes == 0] = 1.0
    _, values, axes = np.linalg.svd(rows / sizes, full_matrices=False)
    seen = values**2 > SMALL * values[0] ** 2 if values.size else np.zeros(0, bool)
    along = (gradients / sizes) @ axes.T
    missed = np.linalg.norm(gradients / sizes - along[:, seen] @ axes[seen], axis=1)
    whole = np.linalg.norm(gradients / sizes, axis=1)
    inverse = np.sum((along[:, seen] / values[seen]) ** 2, axis=1)
    known = (whole > 0) & (missed <= np.sqrt(SMALL) * whole)
    return np.where(known, 1 / np.sqrt(instants * np.where(known, inverse, 1.0)), 0.0)


def _regressor(diagram: Diagram, name: str, block: AdaptingBlock, estimate: str) -> Any:
    """W in the independent variables of the closed loop; None without a declared driving error."""
    seen = view(diagram, name)
    ports = {port.name: port for port in (*block.inputs, *block.outputs)}
    if block.driven_by not in ports:
        return None
    error = ca.SX.sym("s", *diagram.sizes.matrix(ports[block.driven_by].shape))
    with reading(None):
        directions = without_numbers(block, name).direction(seen.u, seen.x, seen.p, error)
    return -ca.jacobian(directions[estimate], error).T if estimate in directions else None


def _at(run: Recording, expression: Any, which: np.ndarray) -> np.ndarray:
    """Values of a matrix at some instants of a run: (instants, rows, columns)."""
    loop, shape = run.diagram.loop, expression.shape
    column = loop.on_path(loop.acting([ca.vec(ca.densify(expression))])[0])
    states = np.hstack([run.states[variable.label] for variable in loop.variables])[which].T
    count = states.shape[1]
    function = ca.Function("shown", [loop.state, loop.time, loop.p], [column])
    values = function.map(count)(states, run.time[which][None, :], np.tile(loop.p_values[:, None], count)).full()
    return np.asarray(values.T.reshape((count, shape[1], shape[0])).transpose(0, 2, 1))
