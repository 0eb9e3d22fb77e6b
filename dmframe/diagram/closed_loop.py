"""The flattened diagram: one vector field and one map of a sample, with gains and true parameters as symbols."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, final

import casadi as ca
import numpy as np

from dmframe.block.certificate import SX
from dmframe.block.model import symbols_in
from dmframe.block.port import Side
from dmframe.diagram.pieces import Followed, Leaf, Noise, Parameter, Signal, Variable, rows_of
from dmframe.diagram.projection import Projection


@final
@dataclass(frozen=True)
class ClosedLoop:
    """x' = F(t, x, p) and the map of one sample, from the one set of block equations.

    Expressions depend on independent variables ("leaves"): states, parameters, `trajectories`, the corrections of
    `projections`, and `sampled_signals`, the measured and commanded signals. The controller can therefore be extracted
    separately, and trajectories can be left free. The methods replace leaves by their expressions.

    The map of a sample and the flow are defined here only: runs, code, exports, analyses and proofs take them from the
    methods, and `dmframe.diagram.fingerprint` hashes all fields and the results of the methods.

    Parameters
    ----------
    time, period
        t, and the sampling period T if a block reads it.
    controller, plant
        The states; those of the plant begin with the sampled ones.
    ahead
        Trajectories at whole samples later, as functions of t and T.
    noises
        Random inputs, drawn at each sample.
    sampled_signals
        The measured and commanded signals in the leaves of their own side, in the order of evaluation.
    paced
        The sources whose time is a controller's signal; these are not trajectories.
    led
        Pairs of labels, an output of the plant and its reference, where a controller block computes the reference.
    """

    time: SX
    period: SX
    controller: tuple[Variable, ...]
    plant: tuple[Variable, ...]
    trajectories: tuple[Leaf, ...]
    ahead: tuple[Leaf, ...]
    noises: tuple[Noise, ...]
    sampled_signals: tuple[Leaf, ...]
    projections: tuple[Projection, ...]
    parameters: tuple[Parameter, ...]
    outputs: tuple[Signal, ...]
    paced: frozenset[str] = frozenset()
    led: tuple[tuple[str, str], ...] = ()

    @cached_property
    def constants(self) -> frozenset[int]:
        """Identities of the parameters' scalar symbols."""
        return frozenset(symbols_in(parameter.symbol for parameter in self.parameters))

    @cached_property
    def derived(self) -> dict[Any, Any]:
        """Functions that were derived from this loop, by a key of the module that made them."""
        return {}

    @property
    def variables(self) -> tuple[Variable, ...]:
        """All states, the controller's first."""
        return (*self.controller, *self.plant)

    @property
    def stepped(self) -> tuple[Variable, ...]:
        """The states that move from sample to sample on a clock, which come first: all but continuous plant states."""
        return (*self.controller, *(variable for variable in self.plant if variable.sampled))

    @property
    def flowing(self) -> tuple[Variable, ...]:
        """The states that also move between samples."""
        return tuple(variable for variable in self.plant if not variable.sampled)

    @property
    def measured(self) -> tuple[Leaf, ...]:
        """The measured signals."""
        return tuple(leaf for leaf in self.sampled_signals if leaf.side is Side.PLANT)

    @property
    def commanded(self) -> tuple[Leaf, ...]:
        """The commanded signals."""
        return tuple(leaf for leaf in self.sampled_signals if leaf.side is Side.CONTROLLER)

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
        """The rates of the states that move between samples, with active projections, in the leaves of the plant."""
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
        """Pairs of a plant output s and a source output s_d that it should track."""
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
        """The same pairs with the reference that is tracked in fact: that of the block which modifies the source's."""
        by_label = {signal.label: signal for signal in self.outputs}
        led = [(by_label[goal], by_label[actual]) for actual, goal in self.led]
        found = [Followed(goal.label, out.label, goal.expression, out.expression) for goal, out in led]
        return [*found, *(pair for pair in self.followed if pair.actual not in dict(self.led))]

    @property
    def goal(self) -> Followed | None:
        """The pair that defines the tracking error: that of the task, else that of the joints; None without one."""
        pairs = {pair.actual.split(".", 1)[1]: pair for pair in reversed(self.goals)}
        return next((pairs[name] for name in ("x", "q", *pairs) if name in pairs), None)

    @property
    def discrete_time(self) -> str:
        """The reason why it runs on a clock only, as a clause; empty if it also runs in continuous time."""
        if self.ahead:
            return f"a block looks ahead at {self.ahead[0].name}, T the sampling period"
        for variable in self.variables:
            if variable.sampled:
                return f"{variable.label} is a sampled state"
        if self.noises:
            return f"{self.noises[0].label} is drawn again at each sample"
        moves = stack([self.rate, *(signal.expression for signal in self.outputs)])
        return "a block reads the sampling period" if ca.depends_on(moves, self.period) else ""

    @property
    def second_order(self) -> tuple[str, ...]:
        """Labels of the controller's continuous states whose step on a clock has a term of second order."""
        return tuple(v.label for v in self.controller if v.own_second is not None)

    @cached_property
    def w(self) -> SX:
        """Exogenous signals as one column: the trajectories and, for blocks that read it, the time."""
        return stack([*(leaf.symbol for leaf in self.trajectories), self.time])

    @cached_property
    def drawn(self) -> SX:
        """Random inputs, drawn at each sample, as one column."""
        return stack(noise.symbol for noise in self.noises)

    @cached_property
    def _ahead(self) -> tuple[SX, SX]:
        return columns(self.ahead)

    def joined(self, expressions: Sequence[SX]) -> list[SX]:
        """Expressions with measured, commanded and future signals replaced by their expressions."""
        return _put(self.crossed(expressions), self._ahead)

    def crossed(self, expressions: Sequence[SX]) -> list[SX]:
        """The same with future signals left as leaves, like trajectories."""
        return _put(expressions, self._crossed)

    def on_path(self, expression: SX) -> SX:
        """An expression with the trajectories and their future values replaced by functions of time."""
        return _put([expression], self._path)[0]

    def standing(self, t: float) -> ClosedLoop:
        """The same loop with constant trajectories, with their values at t [s], and zero derivatives."""
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
        """Expressions with the correction of each projection, which stops a rate that leaves the set.

        If not `joined`, measured and commanded signals remain leaves, as the rates of one side require.
        """
        expressions = list(expressions)
        for projection in reversed(self.projections):  # a nominal rate may contain an earlier correction
            law = self.joined([projection.law])[0] if joined else projection.law
            expressions = list(ca.substitute(expressions, [projection.correction], [law]))
        return expressions

    def acting(self, expressions: Sequence[SX]) -> list[SX]:
        """Expressions in states, parameters, trajectories and time only: joined, with active projections."""
        return self.projected(self.joined(expressions))

    def held(self, states: SX) -> SX:
        """A column of states, each projected onto its set."""
        for projection in self.projections:
            states = ca.substitute(states, projection.state, projection.set.held(projection.state))
        return states

    @cached_property
    def advanced(self) -> SX:
        """The stepped states one sample later, before projection onto their sets, in the leaves of their sides.

        A sampled state takes the value of its block. A continuous state of the controller is emulated by an explicit
        Euler step of length T, with the second-order term of its block, if any. This is the only place that does so.
        """
        return stack(self._advanced(v) for v in self.stepped)

    def _advanced(self, variable: Variable) -> SX:
        if variable.own_next is not None:
            return variable.own_next
        return variable.symbol + self.period * self._mean_rate(variable)

    def _mean_rate(self, variable: Variable) -> SX:
        """Mean rate of a continuous state over its step on a clock: its rate plus T times the second-order term.

        States that move between samples take no step.
        """
        second = variable.own_second
        return variable.own_rate if second is None else variable.own_rate + self.period * second

    def moves_of(self, variable: Variable) -> SX:
        """Expression that is zero at equilibrium: the change of a sampled state over a sample, else the rate.

        For a continuous state of the controller it is the mean rate of its step on a clock, (`advanced` - state) / T.
        For T = 0 it is the rate of the flow.
        """
        gained = variable.gained
        return self._mean_rate(variable) if gained is None else gained

    def becomes(self) -> dict[str, SX]:
        """The sampled states one sample later, by label, projected onto their sets, in the leaves of their sides."""
        whole, sampled = self.put_back(self.advanced), [(v, rows) for v, rows in rows_of(self.stepped) if v.sampled]
        return {v.label: ca.reshape(whole[rows], *v.symbol.shape) for v, rows in sampled}

    @property
    def held_over_a_sample(self) -> tuple[SX, SX]:
        """Signals that the plant reads and that are constant between samples: leaves, and their values at the sample.

        These are the commands, the plant's sampled states, the random inputs, and the period.
        """
        leaves, commands = columns(self.commanded)
        still = [*(v.symbol for v in self.plant if v.sampled), self.drawn, self.period]
        used = [symbol for symbol in still if any(ca.depends_on(v.own_rate, symbol) for v in self.flowing)]
        return ca.vertcat(leaves, *map(ca.vec, used)), ca.vertcat(commands, *map(ca.vec, used))

    def put_back(self, advanced: SX) -> SX:
        """The column of `advanced`, each state projected onto its set."""
        states = stack(variable.symbol for variable in self.stepped)
        return ca.substitute(self.held(states), states, advanced)

    def mapped(self, change: Callable[[SX], SX]) -> ClosedLoop:
        """The same loop with `change` applied to each expression of its motion and outputs."""

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
            sampled_signals=tuple(map(leaf, self.sampled_signals)),
            projections=tuple(replace(item, nominal=change(item.nominal)) for item in self.projections),
            outputs=tuple(replace(item, expression=change(item.expression)) for item in self.outputs),
        )

    @cached_property
    def _crossed(self) -> tuple[SX, SX]:
        done, waiting = list[Leaf](), list(self.sampled_signals)
        while waiting:
            later = symbols_in(leaf.symbol for leaf in waiting)
            count = next((k for k, leaf in enumerate(waiting) if symbols_in([leaf.expression]) & later), len(waiting))
            ready, waiting = waiting[:count], waiting[count:]  # one substitution keeps common subexpressions common
            meanings = _put([leaf.expression for leaf in ready], columns(done))
            done += map(Leaf.standing_for, ready, meanings)
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
