"""The flattened diagram: one vector field and one map of a sample; gains and true parameters are symbols in it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import final

import casadi as ca
import numpy as np

from dmframe.certificate import SX
from dmframe.diagram.pieces import Followed, Noise, Parameter, Signal, Variable
from dmframe.diagram.projection import Projection
from dmframe.diagram.resolve import Leaf
from dmframe.port import Side


@final
@dataclass(frozen=True)
class ClosedLoop:
    """x' = F(t, x, p) and the map of one sample, from the one set of block equations.

    Expressions stand in leaves: states, parameters, `trajectories`, the corrections of `projections`, and `crossings`,
    the measured and commanded signals; so the controller can be had alone, and trajectories left free. The methods
    replace leaves by what they stand for.

    It is the one owner of the map of a sample and of the flow: runs, code, exports, analyses and proofs take them from
    its methods, and `dmframe.diagram.fingerprint` hashes all of its fields and what the methods make of them.

    Parameters
    ----------
    time, period
        t, and the sampling period T where a block reads it.
    controller, plant
        The states; of the plant's, the sampled ones first.
    ahead
        What trajectories are whole samples later, as functions of t and T.
    noises
        What each sample draws anew.
    crossings
        The measured and commanded signals in the leaves of their own side, in the order in which they need one another.
    paced
        The sources whose time is a controller's signal, which are no trajectories then.
    led
        Where what follows is wired to a goal that a controller block makes: pairs of labels, the plant's output first.
    """

    time: SX
    period: SX
    controller: tuple[Variable, ...]
    plant: tuple[Variable, ...]
    trajectories: tuple[Leaf, ...]
    ahead: tuple[Leaf, ...]
    noises: tuple[Noise, ...]
    crossings: tuple[Leaf, ...]
    projections: tuple[Projection, ...]
    parameters: tuple[Parameter, ...]
    outputs: tuple[Signal, ...]
    paced: frozenset[str] = frozenset()
    led: tuple[tuple[str, str], ...] = ()

    @property
    def variables(self) -> tuple[Variable, ...]:
        """All states, the controller's first."""
        return (*self.controller, *self.plant)

    @property
    def stepped(self) -> tuple[Variable, ...]:
        """The states that a clock moves from sample to sample: all but the plant's continuous ones. They come first."""
        return (*self.controller, *(variable for variable in self.plant if variable.sampled))

    @property
    def flowing(self) -> tuple[Variable, ...]:
        """The states that move between samples, too."""
        return tuple(variable for variable in self.plant if not variable.sampled)

    @property
    def measured(self) -> tuple[Leaf, ...]:
        """What the plant hands out."""
        return tuple(leaf for leaf in self.crossings if leaf.side is Side.PLANT)

    @property
    def commanded(self) -> tuple[Leaf, ...]:
        """What the plant takes."""
        return tuple(leaf for leaf in self.crossings if leaf.side is Side.CONTROLLER)

    @cached_property
    def state(self) -> SX:
        """All states as one column, the controller's first."""
        return stack(variable.symbol for variable in self.variables)

    def rates_of(self, variables: Iterable[Variable]) -> list[SX]:
        """The rates of states in the leaves of their sides, with the corrections of projections as leaves."""
        return [variable.own_rate for variable in variables]

    @cached_property
    def rate(self) -> SX:
        """The rates of all states, in the leaves of their sides."""
        return stack(self.rates_of(self.variables))

    @cached_property
    def flow(self) -> SX:
        """The rates of what flows between samples, projections acting, in the leaves of the plant."""
        return self.projected([stack(self.rates_of(self.flowing))], joined=False)[0]

    @cached_property
    def p(self) -> SX:
        """All parameters as one column."""
        return stack(parameter.symbol for parameter in self.parameters)

    @property
    def p_values(self) -> np.ndarray:
        """Their values, in the same order (matrices column by column)."""
        parts = [parameter.value.ravel(order="F") for parameter in self.parameters]
        return np.concatenate(parts) if parts else np.zeros(0)

    @property
    def followed(self) -> list[Followed]:
        """Where an output s of the plant is to follow an output s_d of a source."""
        sources = {signal.label for signal in self.outputs}  # a trajectory's derivative is no output
        desired = {
            leaf.name.split(".")[1]: (leaf.name, leaf.symbol) for leaf in self.trajectories if leaf.name in sources
        }
        desired |= {s.label.split(".")[1]: (s.label, s.expression) for s in self.outputs if s.block in self.paced}
        plant = {variable.block for variable in self.plant}
        return [
            Followed(goal[0], signal.label, goal[1], signal.expression)
            for signal in self.outputs
            if (signal.own or signal.block in plant) and (goal := desired.get(f"{signal.name}_d")) is not None
        ]

    @property
    def goals(self) -> list[Followed]:
        """The same with what is really followed: where a block shifts a source's goal, what it makes of it."""
        by_label = {signal.label: signal for signal in self.outputs}
        led = [(by_label[goal], by_label[actual]) for actual, goal in self.led]
        found = [Followed(goal.label, out.label, goal.expression, out.expression) for goal, out in led]
        return [*found, *(pair for pair in self.followed if pair.actual not in dict(self.led))]

    @property
    def goal(self) -> Followed | None:
        """What it is judged by: its task where it has one, else its joints; None without a goal."""
        pairs = {pair.actual.split(".", 1)[1]: pair for pair in reversed(self.goals)}
        return next((pairs[name] for name in ("x", "q", *pairs) if name in pairs), None)

    @property
    def clocked(self) -> str:
        """Why it runs on a clock alone, as a clause; empty for a loop that runs in continuous time too."""
        if self.ahead:
            return f"a block looks ahead at {self.ahead[0].name}, T the sampling period"
        for variable in self.variables:
            if variable.sampled:
                return f"{variable.label} is a sampled state"
        if self.noises:
            return f"{self.noises[0].label} is drawn anew at each sample"
        moves = stack([self.rate, *(signal.expression for signal in self.outputs)])
        return "a block reads the sampling period" if ca.depends_on(moves, self.period) else ""

    @cached_property
    def w(self) -> SX:
        """What moves by itself, as one column: the trajectories and, for blocks that read it, the time."""
        return stack([*(leaf.symbol for leaf in self.trajectories), self.time])

    @cached_property
    def drawn(self) -> SX:
        """What each sample draws anew, as one column."""
        return stack(noise.symbol for noise in self.noises)

    @cached_property
    def _ahead(self) -> tuple[SX, SX]:
        return columns(self.ahead)

    def joined(self, expressions: Sequence[SX]) -> list[SX]:
        """Expressions with measured, commanded and future signals replaced by what they are."""
        return _put(self.crossed(expressions), self._ahead)

    def crossed(self, expressions: Sequence[SX]) -> list[SX]:
        """The same with future signals left as leaves, as trajectories are."""
        return _put(expressions, self._crossed)

    def on_path(self, expression: SX) -> SX:
        """An expression with the trajectories, and what they are later, replaced by functions of time."""
        return _put([expression], self._path)[0]

    def standing(self, t: float) -> ClosedLoop:
        """The same with its trajectories held at what they are at t [s], and their derivatives at zero."""
        outputs = {signal.label for signal in self.outputs}  # a trajectory's derivative is no output
        meanings = [leaf.expression if leaf.name in outputs else 0 * leaf.expression for leaf in self.trajectories]
        at = ca.substitute(meanings, [self.time], [ca.SX(t)]) if meanings else []
        still = {leaf.name: value for leaf, value in zip(self.trajectories, at, strict=True)}
        return replace(
            self,
            trajectories=tuple(map(Leaf.standing_for, self.trajectories, at)),
            ahead=tuple(leaf.standing_for(still[leaf.name.partition("(")[0]]) for leaf in self.ahead),
        )

    def projected(self, expressions: Sequence[SX], *, joined: bool = True) -> list[SX]:
        """Expressions with each projection's correction as its law says: it stops a rate that leads out of the set.

        Not `joined`, a law keeps measured and commanded signals as leaves, as the rates of one side alone need it.
        """
        expressions = list(expressions)
        for projection in reversed(self.projections):  # the nominal rate of a later one may hold an earlier correction
            law = self.joined([projection.law])[0] if joined else projection.law
            expressions = list(ca.substitute(expressions, [projection.correction], [law]))
        return expressions

    def acting(self, expressions: Sequence[SX]) -> list[SX]:
        """Expressions in states, parameters, trajectories and time alone: joined, and with the projections acting."""
        return self.projected(self.joined(expressions))

    def held(self, states: SX) -> SX:
        """A column of states with each put back into its box or ball."""
        for projection in self.projections:
            states = ca.substitute(states, projection.state, projection.set.held(projection.state))
        return states

    @cached_property
    def advanced(self) -> SX:
        """The stepped states one sample later, before they are put back into their sets, in the leaves of their sides.

        A sampled state goes where its block says. One of the controller in continuous time is emulated by an explicit
        Euler step of length T, with the second term that its block may state, here and nowhere else.
        """
        return stack(self._advanced(v) for v in self.stepped)

    def _advanced(self, variable: Variable) -> SX:
        if variable.own_next is not None:
            return variable.own_next
        return variable.symbol + self.period * self._mean_rate(variable)

    def _mean_rate(self, variable: Variable) -> SX:
        """Of a state in continuous time, what its step on a clock moves over T: its rate, and T times what is second.

        What flows between samples takes no step.
        """
        second = variable.own_second
        return variable.own_rate if second is None else variable.own_rate + self.period * second

    def moves_of(self, variable: Variable) -> SX:
        """What is zero where a state rests: what a sampled one moves in a sample, else its rate.

        The rate of a controller's state is that of its step on a clock, `advanced` less the state over T. It is the
        rate of the flow where T is zero.
        """
        gained = variable.gained
        return self._mean_rate(variable) if gained is None else gained

    def becomes(self) -> dict[str, SX]:
        """The sampled states one sample later, by label, each back in its set, in the leaves of their sides."""
        whole, first, found = self.put_back(self.advanced), 0, dict[str, SX]()
        for variable in self.stepped:
            rows, columns = variable.symbol.shape
            if variable.sampled:
                found[variable.label] = ca.reshape(whole[first : first + rows * columns], rows, columns)
            first += rows * columns
        return found

    @property
    def held_over_a_sample(self) -> tuple[SX, SX]:
        """What the plant reads between samples and does not move there: its leaves, and their values at the sample.

        These are the commands, the plant's sampled states, what is drawn, and the period.
        """
        leaves, commands = columns(self.commanded)
        still = [*(v.symbol for v in self.plant if v.sampled), self.drawn, self.period]
        used = [symbol for symbol in still if any(ca.depends_on(v.own_rate, symbol) for v in self.flowing)]
        return ca.vertcat(leaves, *map(ca.vec, used)), ca.vertcat(commands, *map(ca.vec, used))

    def put_back(self, advanced: SX) -> SX:
        """The column of `advanced`, each state back in its set."""
        states = stack(variable.symbol for variable in self.stepped)
        return ca.substitute(self.held(states), states, advanced)

    def mapped(self, change: Callable[[SX], SX]) -> ClosedLoop:
        """The same with each expression that moves something or is shown changed: none is left as it was."""

        def variable(item: Variable) -> Variable:
            after = None if item.own_next is None else change(item.own_next)
            second = None if item.own_second is None else change(item.own_second)
            return replace(item, own_rate=change(item.own_rate), own_next=after, own_second=second)

        def leaf(item: Leaf) -> Leaf:
            return item.standing_for(change(item.expression))

        return replace(
            self,
            controller=tuple(map(variable, self.controller)),
            plant=tuple(map(variable, self.plant)),
            trajectories=tuple(map(leaf, self.trajectories)),
            ahead=tuple(map(leaf, self.ahead)),
            crossings=tuple(map(leaf, self.crossings)),
            projections=tuple(replace(item, nominal=change(item.nominal)) for item in self.projections),
            outputs=tuple(replace(item, expression=change(item.expression)) for item in self.outputs),
        )

    @cached_property
    def _crossed(self) -> tuple[SX, SX]:
        done = list[Leaf]()
        for leaf in self.crossings:
            done.append(leaf.standing_for(_put([leaf.expression], columns(done))[0]))
        return columns(done)

    @cached_property
    def _path(self) -> tuple[SX, SX]:
        return columns((*self.trajectories, *self.ahead))


def _put(expressions: Sequence[SX], pair: tuple[SX, SX]) -> list[SX]:
    leaves, meanings = pair
    return list(ca.substitute(list(expressions), [leaves], [meanings])) if leaves.numel() else list(expressions)


def stack(items: Iterable[SX]) -> SX:
    """Expressions of any size as one dense column."""
    return ca.densify(ca.veccat(ca.SX(0, 1), *items))


def columns(leaves: Sequence[Leaf]) -> tuple[SX, SX]:
    """The leaves' symbols, and their expressions, each as one column."""
    return stack(leaf.symbol for leaf in leaves), stack(leaf.expression for leaf in leaves)


__all__ = ["ClosedLoop", "Followed", "Noise", "Parameter", "Signal", "Variable", "columns", "stack"]
