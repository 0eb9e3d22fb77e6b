"""Equilibrium of the loop with frozen trajectories."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

import casadi as ca
import numpy as np

from dmframe.block.certificate import SX
from dmframe.block.model import symbols_in
from dmframe.certify.true_values import true_values
from dmframe.common.errors import EngineError, ValueFault
from dmframe.diagram import ClosedLoop, Diagram, Variable
from dmframe.diagram.closed_loop import stack
from dmframe.program import EDGES, JUMPS, KINKS, codes
from dmframe.simulate import start_state

AT_REST: Final = 1e-8
"""Largest rate at an equilibrium, relative to 1 + |state|."""

MOST: Final = 1e150
"""Limit of Jacobian entries; products of larger ones overflow."""

FAR: Final = 30
"""Distance of a parameter from 1 in powers of ten that counts as unphysical."""

LARGE: Final = 300
"""Number of states above which a faster, slightly less accurate method is used."""

LATE: Final = 1e6
"""Value of sample counters at a set-point: long after the start."""

_STEPS: Final = 60

_FLAT: Final = 1e-12
"""Size of a Jacobian row below which it counts as zero."""

_DELTA: Final = 1e-13
"""Regularisation of scaled Jacobians (squared threshold of zero)."""


def frozen(diagram: Diagram, t: float = 0.0) -> Diagram:
    """Diagram with trajectories frozen at t [s] and zero derivatives.

    For runs and linearisations; certificates treat trajectories as free.
    """
    return replace(diagram, loop=diagram.loop.standing(t))


def equilibrium(
    diagram: Diagram,
    estimates: Mapping[str, Any] | None = None,
    start: Mapping[str, Any] | None = None,
    clock: float | None = None,
) -> np.ndarray:
    """Equilibrium of the loop with frozen trajectories and zero random signals.

    Newton's method from the start of a run, with minimum-norm steps for non-isolated equilibria; estimates are fixed.

    Parameters
    ----------
    diagram
        A diagram of `frozen`.
    estimates
        Fixed values of estimates by state label, ``{"inverse.w": 0.001}``; the others are at their true
        values.
    start
        As for `dmframe.simulate.start_state`.
    clock
        Period [s] of a discrete-time loop.

    Raises
    ------
    EngineError
        If no equilibrium is found, or the loop needs a clock.
    """
    from scipy.linalg import lstsq

    loop, T = diagram.loop, period_of(diagram.loop, clock)
    fixed = true_values(diagram, resting=True) | _given(loop, estimates or {})
    x = start_state(diagram, start or {})
    labels = [variable.label for variable in loop.variables for _ in range(variable.symbol.numel())]
    free = np.array([label not in fixed for label in labels], dtype=bool)
    for variable in filter(counts, loop.variables):
        x[[other == variable.label for other in labels]] = LATE
    for label, value in fixed.items():
        x[[other == label for other in labels]] = value
    field = rates(loop)
    slope = field.jacobian()
    p = loop.p_values
    computable(loop, "set-point", field(x, p, T).full())
    computable(loop, "set-point", slope(x, p, T, 0)[0].full())
    for _ in range(_STEPS):
        rate, now = field(x, p, T).full().ravel(), slope(x, p, T, 0)[0].full()
        if not (_moderate(rate) and _moderate(now)):
            break
        if at_rest(rate, x, 1e-3):
            return x
        if len(x) > LARGE:
            step = _shortest(now[:, free], -rate)
        else:
            step = lstsq(now[:, free], -rate, cond=1e-12, lapack_driver="gelsd")[0]
        x[free] += step * min(1.0, 1.0 / max(float(np.max(np.abs(step), initial=0.0)), 1e-300))
    worst = int(np.argmax(np.abs(np.nan_to_num(rate, nan=np.inf))))
    if at_rest(rate[worst], x):
        return x
    moves = f"{labels[worst]} still changes by {rate[worst]:.3g} per {_unit(loop, worst)}"
    if not (_moderate(rate) and _moderate(now)):
        moves = f"in the search, the rate of {labels[worst]} or its slope overflows"
    raise EngineError(
        f"set-point: expected an equilibrium of the loop with its trajectories frozen, found none; {moves}; "
        "use estimates for which the loop has an equilibrium, or another start"
    )


def _shortest(slope: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Minimum-norm Newton step of a large loop with a sparse Jacobian.

    A' (A A' + delta)^-1 b with scaled rows of A; delta regularises zero directions.
    """
    from scipy.sparse import block_array, csc_array, eye_array
    from scipy.sparse.linalg import splu

    sizes = np.maximum(np.max(np.abs(slope), axis=1), 1e-300)
    sizes[sizes < _FLAT] = 1.0
    A = csc_array(slope / sizes[:, None])
    rows, columns = A.shape
    joined = block_array([[eye_array(columns), A.T], [A, -_DELTA * eye_array(rows)]], format="csc")
    right = np.concatenate([np.zeros(columns), target / sizes])
    factors = splu(joined)
    found = factors.solve(right)
    found = found + factors.solve(right - joined @ found)
    return np.asarray(found[:columns])


def at_rest(rate: Any, state: np.ndarray, factor: float = 1.0) -> bool:
    """True for rates below `factor` times the tolerance at a state."""
    largest = float(np.max(np.abs(np.asarray(rate)), initial=0.0))
    sizes = np.abs(np.asarray(state))
    return largest <= AT_REST * factor * (
        1 + float(np.max(sizes[sizes < LATE], initial=0.0))
    )  # without sample counters


def computable(loop: ClosedLoop, where: str, numbers: np.ndarray) -> np.ndarray:
    """Check that numbers do not overflow; `where` names their purpose.

    Raises `EngineError` with the parameters that are far from 1.
    """
    if _moderate(numbers):
        return numbers
    far = [
        f"{parameter.label} = {value:g}"
        for parameter in loop.parameters
        for value in np.ravel(parameter.value)[np.argsort(-_distance(np.ravel(parameter.value)))][:1]
        if _distance(np.array([value]))[0] > FAR
    ]
    cause = f", with {', '.join(far)}" if far else ""
    raise EngineError(f"{where}: the rates of the loop overflow{cause}; take numbers nearer to 1")


def _moderate(numbers: np.ndarray) -> bool:
    return bool(np.max(np.abs(numbers), initial=0.0) < MOST)  # False for NaN


def _distance(values: np.ndarray) -> np.ndarray:
    """Distance from 1 in powers of ten; 0 for zero."""
    return np.abs(np.log10(np.where(values == 0, 1.0, np.abs(values))))


def _given(loop: ClosedLoop, estimates: Mapping[str, Any]) -> dict[str, np.ndarray]:
    sizes = {variable.label: variable.symbol.numel() for variable in loop.controller}
    values = dict[str, np.ndarray]()
    for label, value in estimates.items():
        numbers = np.asarray(value, dtype=float)
        if label not in sizes or numbers.shape not in ((), (sizes[label],)):
            raise ValueFault(
                f"estimates.{label}: expected one number, or one per element, for a state of the controller, found "
                f"{numbers.tolist()}; its states are {', '.join(sizes)}"
            )
        values[label] = np.broadcast_to(numbers, (sizes[label],))
    return values


def moves(loop: ClosedLoop) -> SX:
    """Residual of the equilibrium (`ClosedLoop.moves_of`), zero for sample counters."""
    return stack(0 * v.symbol if counts(v) else loop.moves_of(v) for v in loop.variables)


def counts(variable: Variable) -> bool:
    """True for a sample counter: a sampled state with a constant increment."""
    gained = variable.gained
    if gained is None or symbols_in([gained]) - variable.identities:
        return False
    step = ca.Function("step", [variable.symbol], [ca.vec(ca.densify(gained))])
    if codes(step) & (JUMPS | KINKS | EDGES) or not ca.jacobian(step(variable.symbol), variable.symbol).is_zero():
        return False
    return bool(np.all(step(np.zeros(variable.symbol.shape)).full() > 0))


def rates(loop: ClosedLoop) -> Any:
    """`moves` as a function of (state, p, T), with frozen trajectories."""
    return at_set_point(loop, "rates", moves(loop))


def period_of(loop: ClosedLoop, clock: float | None) -> float:
    """Period T [s] in the equations of a loop; zero in continuous time.

    Raises `EngineError` for a discrete-time loop without a clock.
    """
    if clock is None and loop.discrete_time:
        raise EngineError(f"set-point: expected a clock, found none; {loop.discrete_time}")
    return clock if clock is not None and loop.discrete_time else 0.0


def _unit(loop: ClosedLoop, row: int) -> str:
    sampled = [v.sampled for v in loop.variables for _ in range(v.symbol.numel())]
    return "sample" if sampled[row] else "second"


def at_set_point(loop: ClosedLoop, name: str, expression: SX) -> Any:
    """Expression of the loop in (state, p, T): frozen trajectories, active projections, no random signals.

    Raises `EngineError` for a loop whose equations depend on time: it has no equilibrium.
    """
    autonomous = undrawn(loop, loop.on_path(loop.acting([expression])[0]))
    if symbols_in([autonomous]) & symbols_in([loop.time]):
        timed = [v for v in loop.variables if symbols_in(loop.joined([loop.moves_of(v)])) & symbols_in([loop.time])]
        where = ", ".join(f"{v.label}+" if v.sampled else f"d {v.label}/dt" for v in timed) or name
        raise EngineError(
            f"set-point: expected a loop that is time-invariant for frozen trajectories, found t in {where}"
        )
    return ca.Function(name, [loop.state, loop.p, loop.period], [ca.cse(autonomous)])


def undrawn(loop: ClosedLoop, expression: SX) -> SX:
    """Expression with random signals replaced by zero, their mean."""
    drawn = loop.drawn
    return ca.substitute(expression, drawn, ca.SX.zeros(drawn.numel())) if drawn.numel() else expression
