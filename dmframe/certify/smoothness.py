"""Conditions for differentiation along the closed loop: symbols with known rates, and continuous expressions.

The chain rule needs the rate of every symbol, and ignores jumps: the derivative of sign, floor and comparisons is zero.
Therefore no differentiated expression, such as a storage function or the position of a barrier, may contain a jump, and
each differentiated function of time is followed through its switching instants.
"""

from __future__ import annotations

import random
from collections.abc import Iterator
from collections.abc import Set as AbstractSet
from dataclasses import dataclass
from fractions import Fraction
from typing import Final, final

import casadi as ca
import numpy as np

from dmframe.block.certificate import SX, Assumption
from dmframe.block.model import symbols_in
from dmframe.certify.claim import Claim
from dmframe.certify.differentiated import Differentiated
from dmframe.certify.sampler import HORIZON, SAMPLES, Sampler
from dmframe.certify.sign import Sign, sign_after
from dmframe.certify.symbols import exact_values
from dmframe.common.text import Label, Text, sentence
from dmframe.diagram import Diagram
from dmframe.diagram.closed_loop import stack
from dmframe.diagram.pieces import Leaf
from dmframe.diagram.wiring import Derived
from dmframe.exact import Tape
from dmframe.exact.balls import UndecidedError
from dmframe.exact.pieces import Course, NotFollowed, follow, moving_operations
from dmframe.program import CONST, DIVISIONS, EDGES, JUMPS, KINKS, TO_READ, codes, sign_of

SMOOTH_ABOVE: Final = frozenset((ca.OP_SQRT, ca.OP_LOG, ca.OP_LOG1P, ca.OP_POW, ca.OP_CONSTPOW, ca.OP_HYPOT))
"""Functions that are smooth for positive operands; others, such as asin, have boundaries of their domain there."""

SUSPECTS: Final = 200
"""Number of largest steps between sampling instants that are examined for jumps."""

BISECTIONS: Final = 60

SCALES: Final = (Fraction(1, 1000), Fraction(1, 1000), Fraction(1), Fraction(-9, 10), Fraction(5))
"""Distances from the graph's numbers at which a path is followed, to decide continuity by construction."""

SOURCE = sentence("{dV/dt} by the chain rule")
NEEDED = sentence("{V} or a derivative that the loop takes needs it continuous")


@final
@dataclass(frozen=True)
class Smoothness:
    """Faults, assumptions, and facts that were verified."""

    faults: tuple[str, ...]
    assumptions: tuple[Assumption, ...]
    notes: tuple[str, ...]


def smoothness(diagram: Diagram, claim: Claim) -> Smoothness:
    """Examine all expressions differentiated for a claim so far, and follow its trajectories."""
    return Examiner(diagram, claim).found()


@final
class Examiner:
    """Examines the expressions that a claim differentiates; a second call examines only later entries."""

    def __init__(self, diagram: Diagram, claim: Claim) -> None:
        self._diagram, self._claim = diagram, claim
        self._texts: dict[str, dict[Text, None]] = {"fault": {}, "assumed": {}, "note": {}}
        self._count, self._used, self._seen = 0, set[int](), set[str]()
        self._enter(_field(claim))

    def found(self) -> Smoothness:
        """Results for all expressions differentiated so far."""
        entries = self._claim.operator.record.since(self._count)
        self._count += len(entries)
        for entry in entries:
            self._enter(_symbols(self._claim, entry))
            self._enter(_operations(self._claim, entry))
            self._used |= symbols_in([entry.expression])
        for leaf in _differentiated(self._diagram, self._used):
            if leaf.name not in self._seen:
                self._seen.add(leaf.name)
                self._enter(_followed(self._diagram, leaf))
        assumptions = tuple(Assumption(text, SOURCE) for text in self._texts["assumed"])
        return Smoothness(tuple(self._texts["fault"]), assumptions, tuple(self._texts["note"]))

    def _enter(self, findings: Findings) -> None:
        for kind, text in findings:
            self._texts[kind][text] = None


def slope(claim: Claim, expression: SX) -> SX | None:
    """Rate of a signal; None if it jumps or contains a symbol without a rate, so that the chain rule does not apply.

    A kink is allowed: the rate is bounded next to it, as Barbalat's lemma requires.
    """
    still = claim.loop.constants
    if jumps(expression, still) or any(_without_rate(claim, expression)):
        return None
    return claim.flow.unrecorded(expression)


Findings = Iterator[tuple[str, Text]]
"""Pairs of ``fault``, ``assumed`` or ``note`` with a text."""


def _without_rate(claim: Claim, expression: SX) -> Iterator[SX]:
    """Symbols of an expression without a rate: all except states, trajectories, the time and parameters."""
    loop = claim.loop
    known = loop.constants.union([loop.time.element_hash()], *(variable.identities for variable in loop.variables))
    known = known.union(*(leaf.identities for leaf in claim.diagram.resolver.trajectories.values()))
    return (symbol for symbol in ca.symvar(expression) if symbol.element_hash() not in known)


def _symbols(claim: Claim, entry: Differentiated) -> Findings:
    for symbol in _without_rate(claim, entry.expression):
        what = _description(claim.diagram, claim, symbol)
        yield "fault", Text(entry.of, f" holds {what}; it has no rate to differentiate along")


def _description(diagram: Diagram, claim: Claim, symbol: SX) -> str:
    own = symbols_in([symbol])
    for projection in claim.loop.projections:
        if own & symbols_in([projection.correction]):
            return f"the correction of the projection of {projection.name}"
    for name, model in diagram.models.items():
        for state, leaf in model.states.items():
            if own & symbols_in([leaf]):
                return f"{name}.{state}, a state of a {model.block.side.value}"
    return f"{symbol}, which is no state, trajectory or parameter of this diagram"


def _operations(claim: Claim, entry: Differentiated) -> Findings:
    """Operations with a jump along the motion, or with a kink that the expression does not smooth."""
    moving = symbols_in([claim.loop.time, claim.loop.state, *(leaf.symbol for leaf in claim.loop.trajectories)])
    moving |= symbols_in(leaf.symbol for leaf in claim.diagram.resolver.trajectories.values())
    symbols, where = ca.symvar(entry.expression), entry.of
    (value,) = ca.cse([entry.expression])
    tape = Tape.from_function(ca.Function("differentiated", [stack(symbols)], [value], TO_READ))
    for k, code in moving_operations(tape, [[symbol.element_hash() in moving for symbol in symbols]]):
        if code in JUMPS:
            yield "fault", Text(where, f" holds {sign_of(code)}, which jumps; the derivative of a jump is not zero")
        elif code in KINKS and not is_smooth_over(tape, k):
            yield "fault", Text(where, f" holds {sign_of(code)}, which has no derivative where it switches")
        elif code in EDGES and not (code in SMOOTH_ABOVE and is_above(tape, k)):
            text = f": the argument of {sign_of(code)} stays inside the region where it has a derivative"
            yield "assumed", Text(where, text)


def is_above(tape: Tape, place: int) -> bool:
    """True for an instruction whose operands are all positive by construction."""
    signs = dict[int, Sign]()
    for k, node in enumerate(tape.nodes[:place]):
        positive = node.code == CONST and tape.numbers[node.constant] > 0
        signs[k] = sign_after(node.code, [signs[operand] for operand in node.operands], positive=positive)
    return all(signs[operand] is Sign.ABOVE for operand in tape.nodes[place].operands)


def jumps(expression: SX, still: AbstractSet[int]) -> set[int]:
    """Discontinuous operations of an expression that depend on other symbols than the constant ones."""
    symbols = ca.symvar(expression)
    function = ca.Function("jumps", [stack(symbols)], [ca.vec(ca.densify(expression))])
    if not JUMPS & codes(function):
        return set()
    moving = [symbol.element_hash() not in still for symbol in symbols]
    return {code for _, code in moving_operations(Tape.from_function(function), [moving])} & JUMPS


def _field(claim: Claim) -> Findings:
    """Discontinuous rates: solutions may slide along the switching set, and their definition has to be stated."""
    loop, still = claim.loop, claim.loop.constants
    for variable in loop.variables:
        if found := jumps(loop.joined(loop.rates_of([variable]))[0], still):
            names = ", ".join(sorted(sign_of(code) for code in found))
            text = f" holds {names}: where it jumps, the motion is Filippov's solution"
            yield "assumed", Text(Label(f"d {variable.label}/dt"), text)


def is_smooth_over(tape: Tape, kink: int) -> bool:
    r"""True where the outputs are differentiable although h, a node with a kink, is not: x|x|, max(x, 0)^2.

    With F the outputs as functions of h and of the other nodes, their slope jumps by :math:`\partial F / \partial h`
    times a jump, on the set where h switches. Each node is marked if it vanishes there, and if its derivative by h
    does; a rule for each operation propagates the marks. A missing mark means nothing, so False means that it was not
    shown.
    """
    zero, flat = list[bool](), list[bool]()
    meeting = _meeting(tape, kink)
    for k, node in enumerate(tape.nodes):
        code, a, b, _, _ = node
        if k == kink:
            zero.append(bool(meeting))
            flat.append(False)
        elif code in (ca.OP_MUL, ca.OP_SQ):
            zero.append(zero[a] or zero[b])
            flat.append((flat[a] or zero[b]) and (flat[b] or zero[a]))
        elif code == ca.OP_DIV:
            zero.append(zero[a] and not zero[b])  # 0/0 is undefined
            flat.append(flat[a] and (flat[b] or zero[a]) and not zero[b])
        elif code == ca.OP_INV or tape.exponent(k) is not None:
            zero.append(False)
            flat.append(flat[a] and not zero[a])
        else:
            linear = code in (ca.OP_ADD, ca.OP_SUB, ca.OP_NEG, ca.OP_TWICE)
            zero.append(linear and all(zero[operand] for operand in node.operands))
            flat.append(all(flat[operand] for operand in node.operands))
        zero[k] = zero[k] or k in meeting
    return all(map(all, tape.program.stored(flat)))


def _meeting(tape: Tape, kink: int) -> set[int]:
    """Nodes that vanish where a kink switches: x of |x|; x of max(x, 0); the zero itself."""
    places = tape.nodes[kink].operands
    if len(places) == 1:
        return set(places)
    zeros = {k for k in places if tape.nodes[k].code == CONST and not tape.nodes[k].constant}
    return set(places) if zeros else set()


def _differentiated(diagram: Diagram, used: set[int]) -> Iterator[Leaf]:
    """Trajectories and their derivatives that are `used`, or whose next derivative is taken."""
    resolver, used = diagram.resolver, set(used)
    for (block, _), source in diagram.sources.items():
        if isinstance(source, Derived):
            used |= symbols_in([resolver.input(block, source.of)])
    for (block, port, order), leaf in list(resolver.trajectories.items()):
        if resolver.steps(block, port):
            continue  # the proof is valid between its steps
        if used & leaf.identities or (block, port, order + 1) in resolver.trajectories:
            yield leaf


def followed_by_numbers(diagram: Diagram, claim: Claim) -> Iterator[tuple[str, SX]]:
    """Trajectories whose continuity is checked at the graph's numbers only, with the parameters that they depend on.

    A trajectory that is continuous at random numbers near and far from these, and in which parameters alone do not
    switch anything, is continuous by construction and left out.
    """
    for leaf in _differentiated(diagram, symbols_in([entry.expression for entry in claim.operator.record.since(0)])):
        joined, function = _path(diagram, leaf)
        if not function.has_free() and _switches(function) and not _continuous_anywhere(diagram, function):
            moves = symbols_in([diagram.loop.time])
            read = [symbol for symbol in ca.symvar(joined) if symbol.element_hash() not in moves]
            yield leaf.name, ca.vertcat(ca.SX(0, 1), *read)


def _continuous_anywhere(diagram: Diagram, function: ca.Function) -> bool:
    exact, rng, tape = exact_values(diagram), random.Random(0), Tape.from_function(function)
    timed = {k for k, _ in moving_operations(tape, [[True], [False] * tape.inputs[1][1]])}
    of_all = moving_operations(tape, [[True], [True] * tape.inputs[1][1]])
    if any(k not in timed and code in JUMPS | KINKS | {ca.OP_ATAN2} for k, code in of_all):
        return False  # other numbers may select another branch
    own = [value for parameter in diagram.loop.parameters for value in exact[parameter.label]]
    for scale in SCALES:
        try:
            course = follow(tape, [_near(value, scale, rng) for value in own])
        except (NotFollowed, UndecidedError, ZeroDivisionError):
            return False
        if course.jump is not None or course.edged:
            return False
    return True


def _near(value: Fraction, scale: Fraction, rng: random.Random) -> Fraction:
    """Another number of the same sign; for zero a nonzero one, since a factor would not change it."""
    part = Fraction(rng.randrange(1, 10**6), 10**6)
    return value * (1 + scale * part) if value else scale * part * rng.choice((1, -1))


def _path(diagram: Diagram, leaf: Leaf) -> tuple[SX, ca.Function]:
    """A trajectory, and the same as a function of time and of all parameters."""
    joined = ca.vec(ca.densify(diagram.loop.joined([leaf.expression])[0]))
    parameters = stack(parameter.symbol for parameter in diagram.loop.parameters)
    return joined, ca.Function("path", [diagram.loop.time, parameters], [joined], {"allow_free": True})


def _switches(function: ca.Function) -> bool:
    """True for a function of time that may jump or be non-differentiable somewhere."""
    tape = Tape.from_function(function)
    found = {code for _, code in moving_operations(tape, [[True], [False] * tape.inputs[1][1]])}
    return bool(found & (JUMPS | KINKS | EDGES | DIVISIONS))


def _followed(diagram: Diagram, leaf: Leaf) -> Findings:
    """Faults of a trajectory that depends on other signals than time, or is discontinuous."""
    parameters = diagram.loop.parameters
    _, function = _path(diagram, leaf)
    if function.has_free():
        free = ", ".join(str(symbol) for symbol in function.get_free())
        text = f" moves with {free}; a desired trajectory is a function of time and parameters alone"
        yield "fault", Text(Label(leaf.name), text)
        return
    if not _switches(function):
        return
    tape = Tape.from_function(function)
    exact = exact_values(diagram)
    values = [value for parameter in parameters for value in exact[parameter.label]]
    try:
        course = follow(tape, values)
    except (NotFollowed, UndecidedError, ZeroDivisionError):
        yield from _sampled(leaf, function, diagram.loop.p_values)
        return
    yield from _course(leaf, course)
    if course.jump is None and course.edged:
        yield from _sampled(leaf, function, diagram.loop.p_values)


def _course(leaf: Leaf, course: Course) -> Findings:
    count = len(course.instants)
    if course.jump is not None:
        jump = course.jump
        change = f"from {jump.before:.6g} to {jump.after:.6g} at t = {float(jump.time):.6g} s"
        yield "fault", Text(Label(f"{leaf.name}[{jump.element}]"), f" jumps {change}; ", NEEDED)
    elif course.until is not None:
        seen = f" is continuous; it is at its first {count} switching instants, up to t = {float(course.until):.6g} s"
        yield "assumed", Text(Label(leaf.name), seen)
    elif count:
        yield "note", Text(Label(leaf.name), f" is continuous at its {count} switching instants, and smooth between")


def _sampled(leaf: Leaf, function: ca.Function, p: np.ndarray) -> Findings:
    """Numerical search for jumps of a trajectory that cannot be followed exactly."""
    found = _step(function, p)
    if found is not None:
        element, time, before, after = found
        change = f"jumps from {before:.6g} to {after:.6g}" if np.isfinite(after - before) else "has no real value"
        yield "fault", Text(Label(f"{leaf.name}[{element}]"), f" {change} at t = {time:.6g} s; ", NEEDED)
    else:
        text = f" is continuous; no jump was seen at {SAMPLES} instants up to t = {HORIZON:g} s"
        yield "assumed", Text(Label(leaf.name), text)


def _step(function: ca.Function, p: np.ndarray) -> tuple[int, float, float, float] | None:
    """(element, time, before, after) of a step that does not shrink when its time interval is repeatedly halved."""
    at = Sampler(function, p)
    time = np.linspace(0.0, HORIZON, SAMPLES)
    values = at.over(time)
    for element, row in enumerate(values):
        steps = np.abs(np.diff(row))
        odd = np.abs(steps - (np.roll(steps, 1) + np.roll(steps, -1)) / 2)
        scale = float(np.max(np.abs(row[np.isfinite(row)]), initial=0.0))
        suspects = np.argsort(np.where(np.isfinite(odd), odd, np.inf))[-SUSPECTS:]
        steps_found = [_narrowed(at, element, float(time[k]), float(time[k + 1])) for k in suspects]
        jumps = [found for found in steps_found if not abs(found[3] - found[2]) <= 1e-6 * max(scale, 1e-6)]
        if jumps:  # the first one; finite jumps before infinite ones
            return min(jumps, key=lambda found: (not np.isfinite(found[3] - found[2]), found[1]))
    return None


def _narrowed(at: Sampler, element: int, low: float, high: float) -> tuple[int, float, float, float]:
    before, after = float(at(low)[element]), float(at(high)[element])
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        if middle in (low, high):
            break
        value = float(at(middle)[element])
        if abs(value - before) >= abs(after - value):
            high, after = middle, value
        else:
            low, before = middle, value
    return element, low, before, after
