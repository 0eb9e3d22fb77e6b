r"""Bounded signals: those in V, and those whose boundedness follows from the equations of the closed loop.

A *direction* is a combination of states. Directions that no bounded signal determines are *open*. A signal that depends
on open directions only through sines, cosines and other bounded functions is bounded. With the open directions u:

1. A vector v of V with a positive constant weight is bounded. If :math:`\partial v/\partial u` (with bounded functions
   frozen) is constant, that combination of states is bounded, and u is no longer open.
2. A combination of states whose rate is zero is constant.
3. The states of a stable linear subsystem (`StableLinear`) are bounded if its input depends on no open direction.
4. These steps are repeated until no further direction is closed. Then the states driven by an unknown input
   (`StableLinear.inputs`) are bounded, by its block's assumption on that input, if the remaining input is bounded; so
   is the input. The same applies to a linear equation whose stability is not decided and assumed. A signal that does
   not depend on open directions is bounded; `needs` returns the assumptions used.

Each independence is decided exactly, in a random prime field: `dmframe.exact.shift`. Parameters have the graph's own
values there; with other values, a direction may be closed that this graph leaves open. Trajectories and the derivatives
that appear are assumed to be bounded, and denominators are assumed to stay away from zero.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations, product
from typing import final

import casadi as ca

from dmframe.block.certificate import SX, Assumption, Condition, StableLinear
from dmframe.block.model import symbols_in
from dmframe.certify.checked import Numbers
from dmframe.certify.claim import Claim
from dmframe.certify.linear import is_stable
from dmframe.certify.movement import Movement
from dmframe.certify.symbols import Group
from dmframe.common.text import Label, Text, joined, listed_text, text_of
from dmframe.diagram.closed_loop import Variable
from dmframe.diagram.pieces import rows_of
from dmframe.exact import Tape
from dmframe.exact.linear import Echelon

SIGNED = (1, -1)


@final
@dataclass(frozen=True)
class Bases:
    """Initially bounded columns, and linear subsystems that may follow, each with the block that states it."""

    vectors: tuple[SX, ...]
    linear: tuple[tuple[str, StableLinear], ...] = ()


@final
class Closure:
    """The bounded directions of a claim's state space.

    Parameters
    ----------
    bases
        Columns that V or a projection bounds.
    anywhere
        If true, parameters have random values, so that the results are valid at almost all numbers; otherwise the
        graph's
        own values, except for those in intervals.
    zeros
        Labels of parameters that are zero.
    """

    def __init__(
        self,
        claim: Claim,
        numbers: Numbers,
        bases: Bases,
        *,
        seed: int,
        anywhere: bool = False,
        zeros: frozenset[str] = frozenset(),
    ) -> None:
        self._claim, self._numbers, self.seed = claim, numbers, seed
        self._variables = claim.loop.variables
        self._columns = sum(variable.symbol.numel() for variable in self._variables) + 1  # the last one is the time
        self._movement = Movement(claim, numbers, seed, anywhere=anywhere, zeros=zeros)
        self._trial = self._movement.trial
        self._known = Echelon(self._trial.prime, self._columns)
        self.driving: list[tuple[str, StableLinear]] = []
        self.given: list[tuple[str, StableLinear]] = []
        self._sure: Echelon | None = None  # bounded directions without assumptions on driven states
        self.assumed: list[tuple[str, StableLinear]] = []
        self.missed: list[tuple[str, StableLinear]] = []
        self._follow(bases)

    @property
    def uncertain(self) -> frozenset[str]:
        """Labels of the parameters known only up to intervals."""
        return self._numbers.uncertain

    @property
    def prime(self) -> int:
        """Prime of the field in which dependencies are decided."""
        return self._trial.prime

    @property
    def tapes(self) -> Sequence[tuple[Sequence[Group], Tape]]:
        """Evaluated expressions as programs, with the symbols that they contain."""
        return self._movement.tapes

    @property
    def read(self) -> Sequence[SX]:
        """Expressions of these programs."""
        return self._movement.read

    @property
    def variables(self) -> tuple[Variable, ...]:
        """All states."""
        return self._variables

    @property
    def linear(self) -> list[StableLinear]:
        """Linear subsystems whose boundedness follows."""
        return [item for _, item in self.driving]

    def open_states(self) -> list[Variable]:
        """States that belong to an open direction."""
        free = self._open()
        return [variable for variable, rows in rows_of(self._variables) if any(any(u[rows]) for u in free)]

    def conditions(self) -> list[tuple[str, Condition]]:
        """Assumptions that were used, and conditions that replace what did not follow; by block."""
        stated = [(block, Assumption(_stays_stable(item), "not decided")) for block, item in self.assumed]
        stated += [(block, Assumption(self._stays_bounded(item), "not decided")) for block, item in self.given]
        return [
            *stated,
            *(
                (block, condition)
                for block, item in (*self.assumed, *self.given, *self.missed)
                for condition in item.otherwise
            ),
        ]

    def bounds(self, expressions: Sequence[SX]) -> list[bool]:
        """Whether each expression is bounded: it does not depend on an open direction."""
        if not expressions:
            return []
        differences = self._moves([ca.vec(ca.densify(expression)) for expression in expressions])
        return [
            not any(rows) and self._corrected(expression)
            for rows, expression in zip(differences, expressions, strict=True)
        ]

    def needs(self, expressions: Sequence[SX]) -> tuple[Text, ...]:
        """Assumptions on driven states, if these bounded expressions require them."""
        if self._sure is None:
            return ()
        known, self._known = self._known, self._sure
        sure = all(self.bounds(expressions))
        self._known = known
        stated = (condition for _, item in (*self.assumed, *self.given) for condition in item.otherwise)
        return () if sure else tuple(dict.fromkeys(text_of(c.text) for c in stated if isinstance(c, Assumption)))

    def _corrected(self, expression: SX, seen: frozenset[str] = frozenset()) -> bool:
        """True if the correction of each projection in it is bounded, as it is for a bounded nominal rate."""
        projections = self._claim.loop.projections
        used = symbols_in([expression]) if projections else set[int]()
        for projection in projections:
            if not used & symbols_in([projection.correction]):
                continue
            if projection.name in seen:
                return False  # corrections that depend on one another have no bound
            nominal = self._nominal[projection.name]
            (moves,) = self._moves([ca.vec(ca.densify(nominal))])
            if any(moves) or not self._corrected(nominal, seen | {projection.name}):
                return False
        return True

    @cached_property
    def _nominal(self) -> Mapping[str, SX]:
        """The nominal rates of projections, by name."""
        loop = self._claim.loop
        rates = loop.joined([item.nominal for item in loop.projections])
        return {item.name: rate for item, rate in zip(loop.projections, rates, strict=True)}

    def isolated(self) -> bool:
        """True if no rate depends on open directions, such as a joint angle that increases without bound."""
        return all(self.bounds([self._rate(variable) for variable in self._variables]))

    def affected(self) -> list[Variable]:
        """States whose rates depend on open directions."""
        rates = [self._rate(variable) for variable in self._variables]
        return [v for v, bounded in zip(self._variables, self.bounds(rates), strict=True) if not bounded]

    @cached_property
    def _rates(self) -> Mapping[str, SX]:
        joined = self._claim.loop.joined(self._claim.loop.rates_of(self._variables))
        return {variable.label: rate for variable, rate in zip(self._variables, joined, strict=True)}

    def _rate(self, variable: Variable) -> SX:
        return self._rates[variable.label]

    def _open(self) -> list[list[int]]:
        return self._known.null_space()

    def _random_direction(self) -> list[int]:
        """A random combination of all open directions."""
        found = [0] * self._columns
        for u in self._open():
            factor = self._trial.random()
            found = [(a + factor * b) % self._trial.prime for a, b in zip(found, u, strict=True)]
        return found

    def _moves(self, expressions: Sequence[SX]) -> list[list[int]]:
        """Change of each element along a random open direction."""
        return self._movement.along(expressions, self._random_direction())

    def _follow(self, bases: Bases) -> None:
        """Close directions until no further one follows."""
        vectors, waiting = list(bases.vectors), list(bases.linear)
        self._keep_constants()
        while True:
            if self._grow(vectors):
                continue
            found = next((item for item in waiting if self._follows(*item)), None)
            if found is None:
                self._sure = self._sure or self._copy()
                found = next((item for item in waiting if self._follows_if(*item)), None)
            if found is None:
                break
            waiting = [item for item in waiting if item is not found]
            self.driving.append(found)
            vectors += (*found[1].vectors, *(found[1].inputs if found in self.given else ()))
        self.missed = waiting

    def _grow(self, vectors: Sequence[SX]) -> bool:
        """Close directions with bounded vectors; return whether one was closed."""
        directions = self._open()
        if not vectors or not directions:
            return False
        columns = [ca.vec(ca.densify(vector)) for vector in vectors]
        along = self._random_direction()
        here, there = (self._movement.differences(columns, place, [along])[0] for place in (0, 1))
        steady = [row for row, (a, b) in enumerate(zip(here, there, strict=True)) if a == b and a]
        if not steady:
            return False
        moved = self._movement.differences(columns, 0, directions)
        free = [next(k for k in range(self._columns) if u[k] == 1 and _only_in(k, u, directions)) for u in directions]
        grown = False
        for row in steady:
            functional = [0] * self._columns
            for column, difference in zip(free, moved, strict=True):
                functional[column] = difference[row]
            grown |= self._known.add(functional)
        return grown

    def _keep_constants(self) -> None:
        """Close sums and differences of up to three states whose rates cancel, which are constant."""
        columns = [ca.vec(ca.densify(self._rate(variable))) for variable in self._variables]
        flat = [self._movement.values(columns, place) for place in (0, 1)]
        starts = [rows.start for _, rows in rows_of(self._variables)]
        for count in (1, 2, 3):
            for places in combinations(range(len(self._variables)), count):
                sizes = {self._variables[k].symbol.numel() for k in places}
                if len(sizes) == 1:
                    self._keep([starts[k] for k in places], sizes.pop(), flat)

    def _keep(self, starts: Sequence[int], size: int, rates: Sequence[Sequence[int]]) -> None:
        p = self._trial.prime
        for signs in product(SIGNED, repeat=len(starts) - 1):
            factors = (1, *signs)
            for element in range(size):
                if all(
                    not sum(f * row[s + element] for f, s in zip(factors, starts, strict=True)) % p for row in rates
                ):
                    functional = [0] * self._columns
                    for factor, start in zip(factors, starts, strict=True):
                        functional[start + element] = factor % p
                    self._known.add(functional)

    def _copy(self) -> Echelon:
        """A copy of the bounded directions, to which others can be added."""
        found = Echelon(self._trial.prime, self._columns)
        for row in self._known.rows:
            found.add(row)
        return found

    def _follows(self, block: str, item: StableLinear) -> bool:
        """True if the input is bounded and the linear part stable."""
        return all(self.bounds(list(self.remainders(block, item)))) and bool(is_stable(item, self._numbers))

    def _stays_bounded(self, item: StableLinear) -> Text:
        """Text of the assumption on inputs, independent of the block's own text."""
        used = symbols_in(item.inputs)
        of = [v.label for v in self._variables if used & v.identities]
        of += [leaf.name for leaf in self._claim.diagram.resolver.trajectories.values() if used & leaf.identities]
        made = Text(", which is made of ", listed_text(list(map(Label, of))), ",") if of else ""
        return Text("the input of the linear equation that drives ", listed_text(item.of), made, " stays bounded")

    def _follows_if(self, block: str, item: StableLinear) -> bool:
        """True if only the block's assumption is missing: stability, or bounded inputs.

        An input that depends on the driven states is excluded, since the argument would be circular.
        """
        only = bool(item.otherwise) and all(isinstance(condition, Assumption) for condition in item.otherwise)
        if only and is_stable(item, self._numbers) is None and all(self.bounds(list(self.remainders(block, item)))):
            self.assumed.append((block, item))
            return True
        if not item.inputs or self._contained(item):
            return False
        rests = [rest - own for rest, own in zip(self.remainders(block, item), item.inputs, strict=True)]
        if not (all(self.bounds(rests)) and is_stable(item, self._numbers)):
            return False
        self.given.append((block, item))
        return True

    def _contained(self, item: StableLinear) -> bool:
        """True if the input depends on driven states; tested if both have symbols in common."""
        read = symbols_in(item.inputs)
        if not read & symbols_in(item.vectors):
            return False
        known = self._known
        self._known = self._copy()
        for variable, rows in rows_of(self._variables):
            for column in range(rows.start, rows.stop) if read & variable.identities else ():
                self._known.add([int(column == k) for k in range(self._columns)])
        moves = self._moves([ca.vec(ca.densify(vector)) for vector in item.vectors])
        self._known = known
        return not all(map(all, moves))

    def remainders(self, block: str, subsystem: StableLinear) -> Iterator[SX]:
        """Input of each equation of a block: its rate without the stable linear part."""
        field, of = self._claim.flow, Text(f"{block}: what drives ", joined(subsystem.of))
        for vector in subsystem.bounded:
            field.record.add(of, vector)
        for vector, row in zip(subsystem.vectors, subsystem.rates, strict=True):
            linear = sum((rate * other for rate, other in zip(row, subsystem.vectors, strict=True)), ca.SX(0))
            yield field.D(vector, of) - linear


def _only_in(column: int, own: Sequence[int], directions: Sequence[Sequence[int]]) -> bool:
    """True for a column in which this direction is 1 and all others are 0."""
    return all(u is own or not u[column] for u in directions)


def _stays_stable(subsystem: StableLinear) -> Text:
    return Text("the linear equation that drives ", joined(subsystem.of), " is exponentially stable")
