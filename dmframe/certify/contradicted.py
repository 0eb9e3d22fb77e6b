"""Check for contradictions: a quantity assumed to stay positive that must vanish by the proof or by the equations.

Three tests, each of which can only reject; none of them shows that an assumption is true.

1. Limit: is a weight zero where the vectors that converge to zero are zero?
2. Rate: does it decrease at a constant rate, or at a rate proportional to itself?
3. Motion: if it depends on few states, trajectories and the time only, they are integrated from the graph's start.

The cost is about 0.1 s for a weight with few states; one with more than `FEW` numbers is checked by runs only.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import casadi as ca
import numpy as np

from dmframe.block.certificate import SX
from dmframe.block.model import symbols_in
from dmframe.certify.assumed import SIGNS, assumed_positive
from dmframe.certify.checked import Checked, Numbers
from dmframe.certify.claim import Claim
from dmframe.certify.limits import Vanishing
from dmframe.certify.smoothness import slope
from dmframe.certify.starts import has_start, start_expression
from dmframe.common.text import Text
from dmframe.diagram.closed_loop import Variable, stack

FEW: Final = 12
"""Largest number of elements of the states for which a motion is integrated."""

POINTS: Final = 5
SAME: Final = 1e-9
SOON: Final = 100.0
"""Duration of the integration [s]."""
LATE: Final = 1e4
"""Duration of the integration of a quantity that still decreases [s]."""
VANISHED: Final = 1e-3
"""Fraction of its initial value below which a decreasing quantity counts as converging to zero."""
CALLS: Final = 20000
"""Number of evaluations of the rates after which an integration is abandoned."""
INSTANTS: Final = 2001
DENSE: Final = 200001
"""Number of instants for a quantity that depends on no state: half a millisecond apart until `SOON`."""
STEADY: Final = 0.9
"""Factor per decade of time below which a quantity, decreasing no more slowly over the next decade, counts as
converging to zero like a power of time."""


def contradicted(
    claim: Claim, numbers: Numbers, vanishing: Sequence[Vanishing], start: Mapping[str, Any]
) -> Iterator[Checked]:
    """A failing condition for each assumed quantity that does not stay above a positive constant."""
    for item in assumed_positive(claim, numbers):
        for row in ca.vertsplit(item.column):
            if symbols_in([row]) <= numbers.known:
                continue
            why = _in_the_limit(claim, row, vanishing) or _by_rate(claim, row)
            if why := why or _by_motion(claim, row, numbers, start):
                name = Text(item.text, " is assumed to stay above a positive constant, and ", why)
                yield Checked(name, "no contradiction", None, False, SIGNS, "sampled", reads=claim.loop.p)
                break


def kept_above(claim: Claim, numbers: Numbers) -> Iterator[tuple[Text, SX]]:
    """Each assumed quantity that `contradicted` may reject: name, and the parameters and initial values that decide.

    If neither the motion of few states nor the limit can decide a quantity, it is not rejected at any numbers, except
    at isolated ones at which its rate is proportional to it.
    """
    loop = claim.loop
    # vanishing signals are combinations of the vectors of V and of its derivative
    terms = [term for part in claim.parts for term in (*part.certificate.storage, *part.certificate.dissipation)]
    values = stack(loop.joined([ca.vec(ca.densify(ca.SX(term.value)))])[0] for term in terms)
    for item in assumed_positive(claim, numbers):
        seen, starts = list[SX](), list[SX]()
        for row in (row for row in ca.vertsplit(item.column) if not symbols_in([row]) <= numbers.known):
            states = _needed(claim, row)
            if states is None and not _may_vanish(claim, row):
                continue
            rate = slope(claim, row)
            seen += [row, values, *([] if rate is None else [rate])]
            seen += [stack(loop.rates_of(states))] if states else []
            starts += [ca.vec(claim.starts[variable.label]) for variable in states or ()]
        if seen:
            symbols = ca.symvar(loop.on_path(loop.acting([stack(seen)])[0]))
            known = [symbol for symbol in symbols if symbol.element_hash() in numbers.known]
            yield Text(item.text, " stays above a positive constant"), ca.vertcat(ca.SX(0, 1), *known, *starts)


def _may_vanish(claim: Claim, row: SX) -> bool:
    """Whether the zeros of the vectors of V and its derivative may determine a quantity by parameters alone.

    This is so if each of its states appears, times a constant, in an element whose other states are determined too.
    """
    terms = [term for part in claim.parts for term in (*part.certificate.storage, *part.certificate.dissipation)]
    parts = [getattr(term, each.name) for term in terms for each in dataclasses.fields(term)]
    vectors = claim.loop.joined([stack(part for part in parts if isinstance(part, ca.SX))])[0]
    known = symbols_in([claim.loop.p])
    elements = [
        [symbol for symbol in ca.symvar(element) if symbol.element_hash() not in known]
        for element in ca.vertsplit(vectors)
    ]
    found, before = set[int](), -1
    while before != len(found):
        before = len(found)
        for element, symbols in zip(ca.vertsplit(vectors), elements, strict=True):
            left = [symbol for symbol in symbols if symbol.element_hash() not in found]
            if len(left) == 1 and ca.jacobian(element, left[0]).is_constant():
                found.add(left[0].element_hash())
    return all(symbol.element_hash() in found | known for symbol in ca.symvar(row))


def _in_the_limit(claim: Claim, row: SX, vanishing: Sequence[Vanishing]) -> str:
    """Text if it is not positive where all vanishing signals are zero."""
    left, vanished = row, list[str]()
    states = [x for variable in claim.loop.variables for x in ca.vertsplit(ca.vec(variable.symbol))]
    for item in vanishing:
        for element in ca.vertsplit(ca.vec(item.vector)):
            used = symbols_in([element]) & symbols_in([left])
            for state in (x for x in states if x.element_hash() in used):
                factor = ca.jacobian(element, state)
                if factor.is_constant() and float(factor):
                    before, rest = left, state - element / factor
                    (left,) = ca.substitute([left], [state], [ca.simplify(rest) if factor.is_one() else rest])
                    if not ca.is_equal(before, left):
                        vanished.append(item.of)
                    break
    if not vanished:
        return ""
    known = symbols_in(p.symbol for p in claim.loop.parameters)
    at_rest = ca.Function("left", [claim.loop.p], [left], {"allow_free": True})
    names = " and ".join(dict.fromkeys(vanished))
    if symbols_in([left]) <= known and float(at_rest(claim.loop.p_values)) <= 0:
        return (
            f"it is not above zero where {names} {'is' if len(set(vanished)) == 1 else 'are'} zero, which V concludes"
        )
    return ""


def _by_rate(claim: Claim, row: SX) -> str:
    """Text if, at random points, it decreases at a constant rate, or at a rate proportional to itself."""
    rate = slope(claim, row)
    if rate is None or rate.is_zero():
        return ""
    known = symbols_in([claim.loop.p])
    leaves = [leaf for leaf in ca.symvar(ca.vertcat(row, rate)) if leaf.element_hash() not in known]
    function, rng = ca.Function("rate", [stack(leaves), claim.loop.p], [row, rate]), np.random.default_rng(0)
    pairs = np.array([
        [float(x) for x in function(rng.uniform(0.2, 2, len(leaves)), claim.loop.p_values)] for _ in range(POINTS)
    ])  # fmt: skip
    if not np.all(np.isfinite(pairs)):
        return ""
    for form, values in (("{:.4g} times itself", pairs[:, 1] / pairs[:, 0]), ("{:.4g}", pairs[:, 1])):
        if values[0] < 0 and np.ptp(values) <= SAME * abs(values[0]):
            return f"its rate is {form.format(values[0])} a second"
    return ""


def _by_motion(claim: Claim, row: SX, numbers: Numbers, start: Mapping[str, Any]) -> str:
    """Text if it reaches zero, or converges to it, along the motion of the few states that determine it."""
    states = _needed(claim, row)
    if states is None:
        return ""
    begin = _begin(claim, states, numbers, start)
    if begin is None:
        return ""
    loop = claim.loop
    x = stack(variable.symbol for variable in states)
    rates, value = loop.acting([stack(loop.rates_of(states))])[0], loop.acting([row])[0]
    function = ca.Function("own", [x, loop.time, loop.p], [loop.on_path(rates), loop.on_path(value)])
    found = _course(function, loop.p_values, begin)
    if found is None:
        return ""
    time, g = found
    if np.any(g <= 0):
        first = int(np.argmax(g <= 0))
        return f"it is {g[first]:.4g} at t = {time[first]:.6g} s"
    falls = (g[-1] < VANISHED * g[0] and g[-1] < 0.7 * np.interp(time[-1] / 2, time, g)) or _as_a_power(time, g)
    return f"it is down to {g[-1]:.4g} from {g[0]:.4g} at t = {time[-1]:.6g} s, and falls" if falls else ""


def _needed(claim: Claim, row: SX) -> list[Variable] | None:
    """States that determine a quantity, if they are few; None for one with an active projection."""
    loop, used, found = claim.loop, symbols_in([row]), list[Variable]()
    while True:
        more = [v for v in loop.variables if v not in found and used & v.identities]
        found += more
        if sum(v.symbol.numel() for v in found) > FEW:
            return None
        if not more:
            return found
        used |= symbols_in(loop.acting([stack(loop.rates_of(more))]))


def _begin(claim: Claim, states: Sequence[Variable], numbers: Numbers, start: Mapping[str, Any]) -> np.ndarray | None:
    """Initial values of the states; None if graph and blocks do not state them."""
    columns = list[np.ndarray]()
    for variable in states:
        label = variable.label
        starts = start_expression(label, numbers, start) if has_start(label, numbers, start) else None
        if starts is None or not symbols_in([starts]) <= numbers.known:
            return None
        value = ca.Function("start", [claim.loop.p], [ca.densify(starts)])(claim.loop.p_values)
        columns.append(np.broadcast_to(value.full().ravel(), (variable.symbol.numel(),)))
    return np.concatenate(columns) if columns else np.zeros(0)


def _as_a_power(time: np.ndarray, g: np.ndarray) -> bool:
    """True if it decreases over the last two decades by equal factors, as 1/sqrt(t) does: no positive lower bound."""
    if time[-1] < LATE or not np.all(np.diff(g[time > SOON]) < 0):
        return False
    first, middle, last = np.log(np.interp([SOON, np.sqrt(SOON * LATE), LATE], time, g))
    return bool(middle - first < np.log(STEADY) and last - middle <= STEADY * (middle - first))


def _course(own: ca.Function, p: np.ndarray, begin: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """The quantity over time: until `SOON`, and until `LATE` unless it has vanished; None if the integration fails."""
    time, g, at = np.zeros(0), np.zeros(0), begin
    for first, last in ((0.0, SOON), (SOON, LATE)):
        times = np.linspace(first, last, INSTANTS if begin.size else DENSE)
        states = _states(own, p, at, times)
        if states is None:
            break
        found = own.map(times.size)(states, times[None, :], np.tile(p[:, None], times.size))[1].full().ravel()
        time, g, at = np.concatenate([time, times]), np.concatenate([g, found]), states[:, -1]
        if not (np.all(g > 0) and g[-1] > VANISHED * g[0]):
            break
    return (time, g) if time.size and np.all(np.isfinite(g)) else None


def _states(own: ca.Function, p: np.ndarray, begin: np.ndarray, times: np.ndarray) -> np.ndarray | None:
    """(states, times); None if the integration takes too long or fails."""
    if not begin.size:
        return np.zeros((0, times.size))
    from scipy.integrate import solve_ivp

    calls = 0

    def rate(t: float, at: np.ndarray) -> np.ndarray:
        nonlocal calls
        calls += 1
        if calls > CALLS:
            raise ArithmeticError
        return np.asarray(own(at, t, p)[0].full().ravel())

    try:
        run = solve_ivp(rate, (times[0], times[-1]), begin, method="LSODA", t_eval=times, rtol=1e-8, atol=1e-12)
    except ArithmeticError:
        return None
    return np.asarray(run.y) if run.success else None
