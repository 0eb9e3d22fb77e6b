"""Conclusions from V and dV/dt: bounded, square-integrable and convergent signals, each with its proof step."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar, final

import casadi as ca

from dmframe.block import names_of
from dmframe.block.certificate import SX, Clipped, InformationSquare, Lemma, LogDet, NormSquare, Square, StableLinear
from dmframe.block.model import symbols_in
from dmframe.certify.claim import Claim, Part
from dmframe.certify.closure import Bases, Closure
from dmframe.certify.limits import Combinations, Vanishing, assumed, combined, goals
from dmframe.certify.positive import Positive, Signs
from dmframe.certify.smoothness import slope
from dmframe.certify.symbols import Symbols
from dmframe.common.names import symbol
from dmframe.common.text import Label, Text, Written, around, name_of, sentence, square_of
from dmframe.diagram.closed_loop import Variable
from dmframe.diagram.projection import Bodies

T = TypeVar("T", bound=Positive)


@final
@dataclass(frozen=True)
class Statement:
    """A conclusion about one signal, with its proof step and the assumptions of that step.

    `concludes`: it concerns a control objective, an error that converges to zero. `estimate`: label of the estimate of
    whose steps it is a property.
    """

    signal: Text
    says: str
    step: Text
    assumes: tuple[Text, ...] = ()
    concludes: bool = False
    estimate: str = ""


@final
@dataclass(frozen=True)
class States:
    """Boundedness of the states, by label.

    Parameters
    ----------
    bounded
        States that are bounded.
    unfelt
        States in an unbounded combination on which no rate depends, such as a joint angle that increases without bound.
    open
        States that are not known to be bounded, and on which rates depend.
    """

    bounded: tuple[str, ...] = ()
    unfelt: tuple[str, ...] = ()
    open: tuple[str, ...] = ()


def states_of(claim: Claim, closure: Closure) -> States:
    """Sort the states."""
    left = [variable.label for variable in closure.open_states()]
    bounded = tuple(v.label for v in closure.variables if v.label not in left)
    return States(bounded, tuple(left), ()) if closure.isolated() else States(bounded, (), tuple(left))


def bases_of(claim: Claim, symbols: Symbols, signs: Signs) -> Bases:
    """Initially bounded vectors: those in V, and projected estimates; and linear subsystems that may follow."""
    vectors = [item.state for item in claim.loop.projections if item.set.bounds]
    rising = any(part.certificate.residual for part in claim.parts)
    if not rising or ultimate(claim, symbols, signs):
        vectors += [term.vector for _, term in _stored(claim) if signs.positive(term)]
    return Bases(tuple(vectors), tuple(linear_subsystems(claim)))


def linear_subsystems(claim: Claim) -> Iterator[tuple[str, StableLinear]]:
    """Linear subsystems that certificates state, and information matrices, each with its block."""
    yield from ((part.block, item) for part in claim.parts for item in part.certificate.linear)
    for part in claim.parts:
        for term in part.certificate.storage:
            if isinstance(term, InformationSquare):
                yield part.block, _memory(term)


def _memory(term: InformationSquare) -> StableLinear:
    """An information matrix with forgetting satisfies a stable linear equation."""
    memory = ca.vec(ca.densify(term.memory))
    return StableLinear(
        (memory,), ((-term.forgetting,),), (memory,), of=(Text(name_of("G"), " of ", square_of(term.of, "G")),)
    )


IN_V = sentence("{V} contains it with a positive weight and does not grow")
INSIDE = sentence("{V} contains its divergence, which is unbounded at the boundary of the positive definite matrices")
SPENT = sentence("{dV/dt} dissipates it, and the total dissipation is at most {V(0)}")
DRIVEN = Text("a stable linear equation with the servo's true gains drives it, and its input is bounded")
CLOSED = Text("it is a function of bounded signals, sines and cosines")
BARBALAT = Text("a square-integrable signal with a bounded derivative goes to zero [Barbalat's lemma]")
BEYOND = sentence("{dV/dt} dissipates at least the square of its part beyond the dead zone [Barbalat's lemma]")
AGAIN = Text("a signal that converges, with a bounded second derivative, comes to rest [Barbalat's lemma]")
ULTIMATELY = sentence(
    "{dV/dt} dissipates each square of {V}, or a projection bounds it: {dV/dt} <= {bound}, {lambda} > 0",
    bound=Written("-lambda V + constant", "−λ V + constant", r"-\lambda V + \text{constant}"),
)
IN_THE_MEAN = Text("over a long time, the mean dissipation is at most the bounded residual")
PROJECTED = Text("a projection keeps the estimate in its set")


def statements_of(claim: Claim, symbols: Symbols, signs: Signs, closure: Closure) -> list[Statement]:
    """Conclusions from V and its dissipation, term by term; they are valid if the claim is proved."""
    if any(part.certificate.residual for part in claim.parts):
        return list(_up_to_a_residual(claim, symbols, signs))
    stored = [term for _, term in _stored(claim) if signs.positive(term)]
    dissipated = _distinct([square for square in _dissipated_squares(claim) if signs.positive(square)])
    found = [
        Statement(term.of, "stays in a compact set of positive definite matrices", INSIDE)
        if isinstance(term, LogDet)
        else Statement(term.of, "is bounded", IN_V)
        for term in _distinct(stored)
    ]
    found += _bodies(claim)
    held = {term.of for term in stored}
    found += [
        Statement(name, "is bounded", DRIVEN, closure.needs([vector]))
        for item in closure.linear
        for name, vector, shown in zip(item.of, item.bounded, closure.bounds(item.bounded), strict=True)
        if shown and name not in held
    ]
    found += _states(claim, closure, {statement.signal for statement in found})
    found += [Statement(square.of, "is square-integrable", SPENT) for square in dissipated]
    vanishing = _vanishing(claim, closure, dissipated)
    wanted = _wanted(claim, closure)
    for item in vanishing:
        assumes = item.assumes if item.proved else (_smooth(item.of),)
        found.append(Statement(item.of, "goes to zero", BARBALAT, assumes, item.proved and item.of in wanted))
    return [*found, *_conclusions(claim, closure, vanishing), *_into_dead_zones(claim, signs)]


def _smooth(of: Text) -> Text:
    return Text("the derivative of ", of, " is bounded")


def _stored(claim: Claim) -> Iterator[tuple[Part, Positive]]:
    for part in claim.parts:
        yield from ((part, term) for term in part.certificate.storage if not isinstance(term, InformationSquare))


def _stored_squares(claim: Claim) -> list[Square]:
    return [term for _, term in _stored(claim) if isinstance(term, Square)]


def _dissipated_squares(claim: Claim) -> list[Square]:
    return [term for part in claim.parts for term in part.certificate.dissipation if isinstance(term, Square)]


def _distinct(terms: Sequence[T]) -> list[T]:
    """Each vector once."""
    return list({term.of: term for term in terms}.values())


def _vectors(claim: Claim) -> dict[Text, SX]:
    """Each name of a vector in a certificate; `dmframe.certify.labels` gives one name to one vector."""
    found = dict[Text, SX]()
    for part in claim.parts:
        certificate = part.certificate
        for term in (*certificate.storage, *certificate.dissipation, *certificate.residual, *certificate.errors):
            if isinstance(term, Lemma):
                found[term.of] = term.first - term.second
            else:
                found[term.of] = term.other if isinstance(term, Clipped) else term.vector
            if isinstance(term, NormSquare):
                found[term.by_of] = term.by
        for item in certificate.linear:
            found |= dict(zip(item.of, item.bounded, strict=True))
    return found


def signals_of(claim: Claim) -> dict[Text, SX]:
    """The signals that conclusions name, by name: vectors of the certificates, states of the plant, and rates."""
    known = _vectors(claim)
    found = known | {_state_name(claim, variable, known): variable.symbol for variable in claim.loop.plant}
    for name, vector in list(found.items()):
        rate = slope(claim, vector)
        if rate is not None:
            found.setdefault(_rate_of(name), rate)
            found.setdefault(_rate_name(claim, name, rate), rate)
    return found


def _states(claim: Claim, closure: Closure, stated: set[str]) -> list[Statement]:
    """Bounded states of the plant, each by its name in the equations."""
    known = _vectors(claim)
    before = [vector for name, vector in known.items() if name in stated]
    left = {variable.label for variable in closure.open_states()}
    return [
        Statement(_state_name(claim, variable, known), "is bounded", CLOSED, closure.needs([variable.symbol]))
        for variable in claim.loop.plant
        if variable.label not in left and not any(_equal(variable.symbol, vector) for vector in before)
    ]


def _state_name(claim: Claim, variable: Variable, known: Mapping[Text, SX]) -> Text:
    """A state's name, with its block if another state, or another vector, has the same name."""
    states = (*claim.loop.plant, *claim.loop.controller)
    single = all(other.name != variable.name or other.label == variable.label for other in states)
    name = name_of(variable.name)
    names = [Text(name)] * single + [Text(name, f" ({variable.block})")]
    free = (name for name in names if name not in known or _equal(variable.symbol, known[name]))
    return next(free, Text(Label(variable.label)))


def _equal(one: SX, other: SX) -> bool:
    return one.shape == other.shape and bool(ca.is_equal(one, other, 1))


def _vanishing(claim: Claim, closure: Closure, dissipated: Sequence[Square]) -> list[Vanishing]:
    """The dissipated squares, and whether their derivatives are bounded."""
    rates = [slope(claim, square.vector) for square in dissipated]
    shown = iter(closure.bounds([rate for rate in rates if rate is not None]))
    found = list[Vanishing]()
    for square, rate in zip(dissipated, rates, strict=True):
        proved = rate is not None and next(shown)
        assumes = closure.needs([rate]) if rate is not None and proved else ()
        found.append(Vanishing(square.of, square.vector, proved, assumes))
    return found


def vanishing_of(claim: Claim, closure: Closure, signs: Signs) -> list[Vanishing]:
    """Signals that converge to zero since they are dissipated; none for a claim with a residual."""
    if any(part.certificate.residual for part in claim.parts):
        return []
    dissipated = _distinct([square for square in _dissipated_squares(claim) if signs.positive(square)])
    return [item for item in _vanishing(claim, closure, dissipated) if item.proved]


def _conclusions(claim: Claim, closure: Closure, vanishing: Sequence[Vanishing]) -> Iterator[Statement]:
    """Errors that converge to zero as combinations of vanishing signals, and their rates."""
    rests = _at_rest(claim, closure, vanishing)
    yield from (Statement(item.of, "goes to zero", AGAIN, item.assumes) for item in rests)
    sure = [item for item in (*vanishing, *rests) if item.proved]
    names, wanted = {item.of for item in sure}, _wanted(claim, closure)
    field = Combinations(claim, closure.prime, closure.seed, closure.uncertain)
    for goal in goals(claim, closure):
        made = None if goal.of in names else combined(field, closure, goal, sure)
        if made is not None:
            yield Statement(goal.of, "goes to zero", made.step, made.assumes, goal.of in wanted)
        if goal.of in wanted and (made is not None or goal.of in names):
            speed = _second(claim, goal.vector)
            if speed is not None and all(closure.bounds([speed])):
                own = made.assumes if made is not None else assumed([goal.of], sure)
                assumes = tuple(dict.fromkeys((*own, *closure.needs([speed]))))
                yield Statement(_rate_of(goal.of), "goes to zero", AGAIN, assumes, concludes=True)


def _wanted(claim: Claim, closure: Closure) -> set[Text]:
    """Control objectives: errors of the task level or driven by it that contain states of the robot."""
    task = {term.of: term.vector for part, term in _stored(claim) if part.cascade}
    task |= {term.of: term.vector for part in claim.parts for term in part.certificate.errors}
    pairs = [pair for item in closure.linear for pair in zip(item.of, item.bounded, strict=True)]
    plant = symbols_in(variable.symbol for variable in claim.loop.plant)
    desired = symbols_in(leaf.symbol for leaf in claim.loop.trajectories)
    driven = {of for of, vector in pairs if symbols_in([vector]) & desired}
    return {of for of, vector in task.items() if symbols_in([vector]) & plant} | driven


def _at_rest(claim: Claim, closure: Closure, vanishing: Sequence[Vanishing]) -> list[Vanishing]:
    """Rates of vanishing states: with a bounded second derivative they vanish too."""
    found = list[Vanishing]()
    for item in vanishing:
        if not (item.proved and _is_state(claim, item.vector)):
            continue
        rate, second = slope(claim, item.vector), _second(claim, item.vector)
        if rate is not None and second is not None and all(closure.bounds([second])):
            assumes = tuple(dict.fromkeys((*item.assumes, *closure.needs([second]))))
            found.append(Vanishing(_rate_name(claim, item.of, rate), rate, True, assumes))
    return found


def _rate_name(claim: Claim, of: Text, rate: SX) -> Text:
    """``dx``, unless another signal prints like that; else ``d(x)/dt``."""
    short, full = Text(name_of(f"d{of}")), _rate_of(of)
    known = _vectors(claim)
    if not of.isidentifier() or (short in known and not _equal(rate, known[short])):
        return full
    blocks = claim.diagram.blocks.values()
    taken = {name for block in blocks for name in (*names_of(type(block)), *(port.name for port in block.truth))}
    taken |= {line.name for law in claim.laws.values() for line in law.definitions}
    return short if short in known or symbol(short) not in {*map(symbol, taken)} else full


def _rate_of(of: Text) -> Text:
    """``d(x - x_d)/dt``."""
    return around(of, "d({})/dt", r"\tfrac{d}{dt} ({})")


def _second(claim: Claim, vector: SX) -> SX | None:
    """Second derivative; None if the vector or its first derivative is discontinuous."""
    first = slope(claim, vector)
    return None if first is None else slope(claim, first)


def _is_state(claim: Claim, vector: SX) -> bool:
    states = [variable.symbol for variable in claim.loop.controller]
    return any(_equal(state, vector) for state in states)


def _into_dead_zones(claim: Claim, signs: Signs) -> Iterator[Statement]:
    """Only an error compared with zero converges to its dead zone; the difference of two signals need not."""
    for part in claim.parts:
        for term in part.certificate.dissipation:
            dead = isinstance(term, Lemma) and term.phi == "beyond"
            if dead and isinstance(term, Lemma) and term.second.is_zero() and signs.dissipates(term):
                yield Statement(term.of, "goes into its dead zone", BEYOND, (_smooth(term.of),))


def _up_to_a_residual(claim: Claim, symbols: Symbols, signs: Signs) -> Iterator[Statement]:
    """Conclusions of a claim with a bounded residual: V may increase, so that a signal in V need not be bounded."""
    projected, left = residual_bases(claim)
    assumes = tuple(dict.fromkeys(_assumed(claim)))
    if ultimate(claim, symbols, signs):
        yield from _bodies(claim)
        yield from (Statement(square.of, "is ultimately bounded", ULTIMATELY) for square in [*projected, *left])
        return
    yield from (Statement(square.of, "is bounded", PROJECTED) for square in projected)
    yield from _bodies(claim)
    for square in _distinct([square for square in _dissipated_squares(claim) if signs.positive(square)]):
        yield Statement(square.of, "is bounded in the mean square, by the residual", IN_THE_MEAN, assumes)


def _bodies(claim: Claim) -> Iterator[Statement]:
    for projection in claim.loop.projections:
        if isinstance(projection.set, Bodies):
            yield Statement(
                Text(name_of(projection.of)),
                "consists of bodies, each not less than its fraction of the nominal one",
                PROJECTED,
            )


def residual_bases(claim: Claim) -> tuple[list[Square], list[Square]]:
    """For a claim with a bounded residual: the squares that a projection bounds, and the others."""
    stored = _stored_squares(claim)
    projected = [square for square in stored if _is_projected(claim, square)]
    return projected, [square for square in stored if square not in projected]


def ultimate(claim: Claim, symbols: Symbols, signs: Signs) -> bool:
    """True if every term of V is dissipated or projected, so that V decreases wherever it is large."""
    stored = [term for part in claim.parts for term in part.certificate.storage]
    if not all(isinstance(term, Square) and not signs.may_grow(term) for term in stored):
        return False  # its dissipation need not be proportional to it
    _, left = residual_bases(claim)
    return not tuple(_assumed(claim)) and all(_is_dissipated(claim, square, symbols, signs) for square in left)


def _assumed(claim: Claim) -> Iterator[Text]:
    for part in claim.parts:
        for term in part.certificate.residual:
            if isinstance(term, NormSquare):
                yield sentence(
                    "the dissipation of {a} grows faster than {size}", a=term.by_of, size=around(term.by_of, "|{}|")
                )
            elif isinstance(term, Clipped):
                yield Text(term.of, " is bounded")


def _is_projected(claim: Claim, square: Square) -> bool:
    """True if it contains a projected estimate, and no other state."""
    used = symbols_in([square.vector])
    variables = claim.loop.variables
    moving = {variable.label for variable in variables if used & variable.identities}
    bounding = {p.name for p in claim.loop.projections if p.set.bounds and used & symbols_in([p.state])}
    return moving == bounding and len(moving) == 1


def _is_dissipated(claim: Claim, square: Square, symbols: Symbols, signs: Signs) -> bool:
    """True for a square whose own vector is dissipated, identically, with a positive weight."""
    return any(
        signs.positive(term) and _same(square, term, symbols)
        for term in _dissipated_squares(claim)
        if term.vector.shape == square.vector.shape
    )


def _same(square: Square, term: Square, symbols: Symbols) -> bool:
    if square.vector.shape == term.vector.shape and ca.is_equal(square.vector, term.vector):
        return True
    return symbols.vanishes("difference", square.vector - term.vector, trials=1)
