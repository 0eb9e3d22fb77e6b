"""V of a claim over samples, along a run: what its blocks store at each sample."""

from __future__ import annotations

import casadi as ca
import numpy as np

from dmframe.block.model import symbols_in
from dmframe.certificate import SX
from dmframe.certify.along import Along, TermAlong
from dmframe.certify.claim import Claim, NotApplicableError
from dmframe.diagram.closed_loop import stack
from dmframe.errors import ValueFault, listed
from dmframe.simulate import Recording


def sampled_along(claim: Claim, run: Recording) -> Along:
    """V and its terms at every kept sample.

    Raises
    ------
    NotApplicableError
        V holds a constant that no run knows, such as where a servo's integrator started.
    ValueFault
        The run did not keep a state that V holds.
    """
    terms = [(part.block, square) for part in claim.parts for square in part.stored]
    unknown = [
        f"{part.block}.{name}"
        for part in claim.parts
        for name, symbol in part.certificate.unknown.items()
        if symbols_in([symbol]) & symbols_in(square.value for _, square in terms)
    ]
    if unknown:
        raise NotApplicableError(
            f"V of the claim over samples holds {listed(unknown)}, constants of the true loop that no run knows"
        )
    loop = claim.loop
    column = loop.on_path(stack(square.value / 2 for _, square in terms))
    read = [variable for variable in loop.variables if symbols_in([column]) & symbols_in([variable.symbol])]
    missing = [variable.label for variable in read if variable.label not in run.states]
    if missing:
        raise ValueFault(f"V along a run: expected a run that keeps {listed(missing)}, which V holds; found none")
    inputs = [stack(variable.symbol for variable in read), loop.time, loop.period]
    fixed = ca.substitute(column, loop.p, ca.DM(run.diagram.loop.p_values))
    states = np.hstack([np.zeros((run.time.size, 0)), *(run.states[variable.label] for variable in read)]).T
    period = np.full((1, run.time.size), run.clock or 0.0)
    rows = _mapped(inputs, fixed, [np.ascontiguousarray(states), run.time[None, :], period])
    total = ca.sum1(fixed)
    size = ca.fabs(total) + ca.dot(ca.fabs(ca.gradient(total, inputs[0])), ca.fabs(inputs[0]))
    count = ca.Function("V", inputs, [ca.cse(total)]).n_instructions()
    (rounding,) = count * np.finfo(float).eps * _mapped(inputs, size, [states, run.time[None, :], period])
    names = [(block, square.of or f"storage {k}") for k, (block, square) in enumerate(terms, start=1)]
    along = tuple(TermAlong(block, of, row, of) for (block, of), row in zip(names, rows, strict=True))
    return Along(run.time, 1.0, np.sum(rows, axis=0), along, rounding=rounding)


def _mapped(inputs: list[SX], column: SX, given: list[np.ndarray]) -> np.ndarray:
    """A column of expressions at every sample, (rows, N)."""
    function = ca.Function("terms", inputs, [ca.cse(column)])
    found: np.ndarray = function.map(given[1].shape[1])(*given).full()
    return found
