"""The flattened diagram: one vector field and one map of a sample; gains and true parameters are symbols in it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, final

import casadi as ca
import numpy as np

from dmframe.certificate import SX
from dmframe.diagram.projection import Projection
from dmframe.diagram.resolve import Leaf
from dmframe.port import Side


@final
@dataclass(frozen=True)
class Variable:
    """A state of the closed loop; `shape` in letters, as declared.

    `rate` is its time derivative, zero of a sampled state between samples; `next` a sampled state's value one sample
    later, before it is projected, and None in continuous time. Results hold it where it is `recorded` or asked for.
    `second`, if a block says it, is what its step on a clock has beside T times the rate, over T^2.
    """

    block: str
    name: str
    shape: str
    unit: str
    symbol: SX
    rate: SX
    next: SX | None = None
    recorded: bool = True
    second: SX | None = None

    @property
    def label(self) -> str:
        """``block.state``."""
        return f"{self.block}.{self.name}"


@final
@dataclass(frozen=True)
class Signal:
    """An output of a block; `own`, of a plant's, that it stands in for no other signal."""

    block: str
    name: str
    shape: str
    unit: str
    expression: SX
    own: bool = False

    @property
    def label(self) -> str:
        """``block.port``."""
        return f"{self.block}.{self.name}"


@final
@dataclass(frozen=True)
class Noise:
    """An input that each sample draws anew, of a distribution of `dmframe.port.DISTRIBUTIONS`."""

    label: str
    symbol: SX
    distribution: str


@final
@dataclass(frozen=True)
class Parameter:
    """A gain, a true parameter or a number of the robot: `symbol` in expressions, `value` in a run."""

    label: str
    symbol: SX
    value: np.ndarray
    unit: str


@final
class Followed(NamedTuple):
    """A goal s_d and the plant's output s that should follow it: their labels and expressions."""

    desired: str
    actual: str
    wanted: SX
    found: SX


@final
@dataclass(frozen=True)
class ClosedLoop:
    """x' = F(t, x, p) and the map of one sample, from the one set of block equations.

    Expressions stand in leaves: states, parameters, `trajectories`, the corrections of `projections`, and `crossings`,
    the measured and commanded signals; so the controller can be had alone, and trajectories left free. The methods
    replace leaves by what they stand for.

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
        return (*self.controller, *(variable for variable in self.plant if variable.next is not None))

    @property
    def flowing(self) -> tuple[Variable, ...]:
        """The states that move between samples, too."""
        return tuple(variable for variable in self.plant if variable.next is None)

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

    @cached_property
    def rate(self) -> SX:
        """Their rates, in the leaves of their sides."""
        return stack(variable.rate for variable in self.variables)

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
    def clocked(self) -> str:
        """Why it runs on a clock alone, as a clause; empty for a loop that runs in continuous time too."""
        if self.ahead:
            return f"a block looks ahead at {self.ahead[0].name}, T the sampling period"
        for variable in self.variables:
            if variable.next is not None:
                return f"{variable.label} is a sampled state"
        if self.noises:
            return f"{self.noises[0].label} is drawn anew at each sample"
        moves = stack([*(v.rate for v in self.variables), *(signal.expression for signal in self.outputs)])
        return "a block reads the sampling period" if ca.depends_on(moves, self.period) else ""

    @cached_property
    def w(self) -> SX:
        """What moves by itself, as one column: the trajectories and, for blocks that read it, the time."""
        return stack([*(leaf.symbol for leaf in self.trajectories), self.time])

    @cached_property
    def drawn(self) -> SX:
        """What each sample draws anew, as one column."""
        return stack(noise.symbol for noise in self.noises)

    def joined(self, expressions: Sequence[SX]) -> list[SX]:
        """Expressions with measured, commanded and future signals replaced by what they are."""
        return _put(self.crossed(expressions), columns(self.ahead))

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
        return stack(self._moved(v) if v.next is None else v.next for v in self.stepped)

    def _moved(self, variable: Variable) -> SX:
        rate = variable.rate if variable.second is None else variable.rate + self.period * variable.second
        return variable.symbol + self.period * rate

    @property
    def held_over_a_sample(self) -> tuple[SX, SX]:
        """What the plant reads between samples and does not move there: its leaves, and their values at the sample.

        These are the commands, the plant's sampled states, what is drawn, and the period.
        """
        leaves, commands = columns(self.commanded)
        still = [*(v.symbol for v in self.plant if v.next is not None), self.drawn, self.period]
        used = [symbol for symbol in still if any(ca.depends_on(v.rate, symbol) for v in self.flowing)]
        return ca.vertcat(leaves, *map(ca.vec, used)), ca.vertcat(commands, *map(ca.vec, used))

    def put_back(self, advanced: SX) -> SX:
        """The column of `advanced`, each state back in its set."""
        states = stack(variable.symbol for variable in self.stepped)
        return ca.substitute(self.held(states), states, advanced)

    @cached_property
    def _crossed(self) -> tuple[SX, SX]:
        return columns(self.crossings)

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
