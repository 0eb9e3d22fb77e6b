"""Resolve wired blocks to one set of expressions: outputs, rates and time derivatives, each on demand.

Expressions depend on *leaves*: the states, the parameters, the measured and commanded signals, and the desired
trajectories with their derivatives. The two sides are joined only in `closed_loop`, so that the controller can be
extracted separately, as code, and the trajectories can be left free, as in a theorem.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import copy
from typing import final

import casadi as ca

from dmframe.block.certificate import SX
from dmframe.block.model import BlockModel, symbol, symbols_in
from dmframe.block.port import TIME, Access, Side, State
from dmframe.block.sizes import Sizes
from dmframe.common.errors import AlgebraicLoopError, DerivativeError, DmframeError, ValueFault
from dmframe.diagram.bodies import TEN, Bodies
from dmframe.diagram.closed_loop import stack
from dmframe.diagram.pieces import Leaf, loop_fault
from dmframe.diagram.projection import Ball, Box, Projection
from dmframe.diagram.wiring import Ahead, Derived, Drawn, End, Period, Source, Time, Wire
from dmframe.exact import zero_test

_Key = tuple[str, ...]
"""A field of a block's `Equations`, and the name of an output or state."""


@final
class Resolver:
    """Resolves each signal of a diagram once; faults are collected, so that all can be reported together."""

    def __init__(self, models: Mapping[str, BlockModel], sources: Mapping[End, Source], sizes: Sizes) -> None:
        self.models, self.sources, self.sizes = models, sources, sizes
        self.time, self.period = ca.SX.sym("t"), ca.SX.sym("T")
        self.drawn = dict[End, SX]()
        self.ahead = dict[tuple[str, str, int], Leaf]()
        self.trajectories = dict[tuple[str, str, int], Leaf]()
        self.sampled_signals = dict[End, Leaf]()
        self.projections = dict[End, Projection]()
        self.faults = list[DmframeError]()
        self._outputs, self._rates = dict[End, SX](), dict[End, SX]()
        self._equations = dict[str, tuple[dict[_Key, SX], dict[_Key, tuple[str, ...]]]]()
        self._held = set[End]()
        self._open = list[str]()

    def with_outputs(self, outputs: Mapping[End, SX]) -> Resolver:
        """The same diagram with these outputs replaced by other expressions, wherever another block reads them."""
        other = copy(self)
        other._outputs, other._rates, other._equations, other.faults = dict(outputs), {}, {}, []
        other.sampled_signals, other.projections = dict(self.sampled_signals), dict(self.projections)
        return other

    def output(self, block: str, port: str) -> SX:
        """An output in the leaves of its own side."""
        end = (block, port)
        if end not in self._outputs:
            self._outputs[end] = self._opened(f"{block}.{port}", block, "outputs", port)
        return self._outputs[end]

    def rate(self, block: str, state: str) -> SX:
        """The rate of a state between samples, with the correction of a projected one; zero for a sampled state."""
        end = (block, state)
        if end not in self._rates:
            model = self.models[block]
            if state in model.equations.next:
                self._rates[end] = rest = ca.SX.zeros(*model.states[state].shape)
                self._projected(model, state, rest)
                return rest
            rate = self._opened(f"d{block}.{state}/dt", block, "rates", state)
            self._rates[end] = self._projected(model, state, rate)
        return self._rates[end]

    def next(self, block: str, state: str) -> SX | None:
        """The value of a sampled state one sample later, before projection; None for a continuous state."""
        return self._own(block, "next", state) if state in self.models[block].equations.next else None

    def second(self, block: str, state: str) -> SX | None:
        """Second-order term of a state's step on a clock, divided by T^2; None for most states."""
        return self._own(block, "second", state) if state in self.models[block].equations.second else None

    def input(self, block: str, port: str) -> SX:
        """An input, in the leaves of the block's side."""
        source, model = self.sources[block, port], self.models[block]
        match source:
            case Time():
                return self.time
            case Period():
                return self.period
            case Drawn():
                return self.drawn.setdefault((block, port), symbol(f"{block}.{port}", model.inputs[port].shape))
            case Wire():
                return self._across(source, self.side(block))
            case Ahead(of, samples):
                return self._later(self.sources[block, of], samples)
            case Derived():
                with self._entered(f"{block}.{port}") as free:
                    held = self.input(block, source.of)
                    return self.derivative(held, f"{block}.{port}") if free else symbol(f"{block}.{port}", held.shape)
            case _:
                return ca.SX.zeros(*model.inputs[port].shape)

    def _later(self, source: Source, samples: int) -> SX:
        """A source's output whole samples later, as a leaf; an expression if the time of the source is a signal."""
        if not isinstance(source, Wire):  # `wire_blocks` rejects it
            raise TypeError(source)
        if self.paced(source.block):
            return self._on_own_time(source, samples)
        key = (source.block, source.port, samples)
        if key not in self.ahead:
            now = self.output(source.block, source.port)
            (later,) = ca.substitute([now], [self.time], [self.time + samples * self.period])
            name = f"{source.block}.{source.port}(t + {'' if samples == 1 else samples}T)"
            self.ahead[key] = Leaf(name, Side.SOURCE, symbol(name, now.shape), later)
        return self.ahead[key].symbol

    def _on_own_time(self, source: Wire, samples: int) -> SX:
        """A source's output at a future time of its clock, which has the outputs t_path_1, ... for an output t_path."""
        clock = self.sources[source.block, TIME.name]
        if not isinstance(clock, Wire):
            raise TypeError(clock)
        then = self.output(clock.block, f"{clock.port}_{samples}")
        model = self.models[source.block]
        return ca.substitute([model.equations.outputs[source.port]], [model.inputs[TIME.name]], [then])[0]

    def expand(self, block: str, expression: SX) -> SX:
        """An expression in a block's own symbols, with its inputs replaced by the signals that drive them."""
        needed = self.models[block].needs(expression)
        return self._replaced(block, [expression], {name: self.input(block, name) for name in needed})[0]

    def _opened(self, node: str, block: str, *key: str) -> SX:
        """One of a block's equations; a new symbol if the node is already being resolved."""
        with self._entered(node) as free:
            return self._own(block, *key) if free else symbol(node, self.models[block].equations.named[key].shape)

    def _own(self, block: str, *key: str) -> SX:
        """One of a block's equations, with its inputs replaced.

        Each input is replaced once, in all equations, so that their common subexpressions stay common.
        """
        if block not in self._equations:
            model = self.models[block]
            stated = model.equations.named
            self._equations[block] = dict(stated), {other: model.needs(x) for other, x in stated.items()}
        known, left = self._equations[block]
        signals = {name: self.input(block, name) for name in left[key]}
        signals = {name: signals[name] for name in left[key]}  # these calls may have replaced some of them
        reading = [other for other, names in left.items() if not signals.keys().isdisjoint(names)]
        known.update(zip(reading, self._replaced(block, [known[other] for other in reading], signals), strict=True))
        left.update((other, tuple(name for name in left[other] if name not in signals)) for other in reading)
        return known[key]

    def _replaced(self, block: str, expressions: Sequence[SX], signals: Mapping[str, SX]) -> Sequence[SX]:
        """Expressions in a block's own symbols, with some of its inputs replaced."""
        if not signals:
            return expressions
        own = stack(self.models[block].inputs[name] for name in signals)
        return list(ca.substitute(expressions, [own], [stack(signals.values())]))

    def derivative(self, expression: SX, wanted_by: str) -> SX:
        """Total time derivative along the equations of the expression's own side; `wanted_by` is its reader."""
        used = symbols_in([expression])
        self._reject_steps(used, wanted_by)
        moving = list(self._moving(used, wanted_by))
        if not moving:
            return ca.SX.zeros(*expression.shape)
        leaves = ca.vertcat(*(ca.vec(leaf) for leaf, _ in moving))
        rates = ca.vertcat(*(ca.vec(ca.densify(rate)) for _, rate in moving))
        return ca.jtimes(expression, leaves, rates)

    def _reject_steps(self, used: set[int], wanted_by: str) -> None:
        """Report a time derivative of a discontinuous signal."""
        drawn = (".".join(end) for end, leaf in self.drawn.items() if used & symbols_in([leaf]))
        for leaf in self.ahead.values():
            if used & leaf.identities:
                text = f"{wanted_by} is a time derivative of a signal that depends on {leaf.name}; use differences"
                self._report_once(DerivativeError(text, path=("blocks", wanted_by.partition(".")[0])))
        steps = [
            f"{name}.{state}"
            for name, model in self.models.items()
            for state in model.equations.next
            if used & model.identities[state]
        ]
        for name in (*steps, *drawn):
            text = (
                f"{wanted_by} is a time derivative of a signal that depends on {name}, which is piecewise constant; "
                "filter it in continuous time, or use differences"
            )
            self._report_once(DerivativeError(text, path=("blocks", wanted_by.partition(".")[0])))

    def _report_once(self, fault: DmframeError) -> None:
        if not any(str(known) == str(fault) for known in self.faults):
            self.faults.append(fault)

    def _moving(self, used: set[int], wanted_by: str) -> Iterator[tuple[SX, SX]]:
        if self.time.element_hash() in used:
            yield self.time, ca.SX(1)
        for name, model in self.models.items():
            for state, leaf in model.states.items():
                if used & model.identities[state]:
                    yield leaf, self.rate(name, state)
        for key, trajectory in list(self.trajectories.items()):
            if used & trajectory.identities:
                yield trajectory.symbol, self.trajectory_rate(*key)
        for end, leaf_signal in list(self.sampled_signals.items()):
            if used & leaf_signal.identities:
                yield leaf_signal.symbol, self._rate_across(end, wanted_by)

    def _rate_across(self, end: End, wanted_by: str) -> SX:
        """The rate of a signal of the other side: a measured signal, or an output declared as its derivative."""
        block, port = end
        for other in self.models[block].block.outputs:
            if other.derivative_of == port and other.access is Access.MEASURED:
                return self._crossing((block, other.name)).symbol
        for name, model in self.models.items():
            for known in model.block.outputs:
                if known.derivative_of and self.sources.get((name, known.derivative_of)) == Wire(block, port):
                    return self.output(name, known.name)
        fault = DerivativeError(
            f"{wanted_by} is a time derivative and needs the rate of {block}.{port}, which is neither measured nor "
            "computed by any block; a controller may use only measured signals",
            path=("blocks", wanted_by.partition(".")[0]),
        )
        self._report_once(fault)
        return ca.SX.zeros(*self._crossing(end).symbol.shape)

    def side(self, block: str) -> Side:
        """The side on which a block computes: a source whose time is a controller's signal computes with it."""
        return Side.CONTROLLER if self.paced(block) else self.models[block].block.side

    def paced(self, block: str) -> bool:
        """True if a source's time is the signal of a block instead of t."""
        own = self.models[block].block.side is Side.SOURCE
        return own and isinstance(self.sources.get((block, TIME.name)), Wire)

    def _across(self, wire: Wire, side: Side) -> SX:
        origin = self.side(wire.block)
        if origin is Side.SOURCE:
            return self.trajectory(wire.block, wire.port, 0).symbol
        if origin is side:
            return self.output(wire.block, wire.port)
        return self._crossing((wire.block, wire.port)).symbol

    def _crossing(self, end: End) -> Leaf:
        if end not in self.sampled_signals:
            name, model = ".".join(end), self.models[end[0]]
            leaf = symbol(name, model.equations.outputs[end[1]].shape)
            self.sampled_signals[end] = Leaf(name, self.side(end[0]), leaf, leaf)
        return self.sampled_signals[end]

    def trajectory_rate(self, block: str, port: str, order: int) -> SX:
        """The next derivative of a source's output: a leaf, or zero if the source does not read the time.

        A piecewise constant output also has the derivative zero, although it is not constant.
        """
        held = self.trajectory(block, port, order)
        if self.steps(block, port):
            return ca.SX.zeros(*held.symbol.shape)
        if not symbols_in([held.expression]) & symbols_in([self.time]):
            return ca.SX.zeros(*held.symbol.shape)
        return self.trajectory(block, port, order + 1).symbol

    def steps(self, block: str, port: str) -> bool:
        """True if a source declares that its output is piecewise constant."""
        return any(known.name == port and known.steps for known in self.models[block].block.outputs)

    def _check_piecewise_constant(self, held: Leaf, block: str) -> None:
        """Check the declaration of a source that an output is piecewise constant."""
        if not _is_zero(ca.densify(ca.jtimes(held.expression, self.time, ca.SX(1)))):
            text = (
                f"{held.name}: expected a signal that is constant between steps, as it declares, found one that varies"
            )
            self._report_once(DerivativeError(text, path=("blocks", block)))

    def trajectory(self, block: str, port: str, order: int) -> Leaf:
        """A source's output or its time derivative, as a leaf; an output declared as derivative is the same leaf."""
        key = block, port, order = self._as_derivative(block, port, order)
        if key not in self.trajectories:
            if order == 0:
                expression = self.output(block, port)
            else:
                expression = ca.jtimes(self.trajectory(block, port, order - 1).expression, self.time, ca.SX(1))
            name = self._leaf_name(block, port, order)
            self.trajectories[key] = Leaf(name, Side.SOURCE, symbol(name, expression.shape), expression)
            if order == 0 and self.steps(block, port):
                self._check_piecewise_constant(self.trajectories[key], block)
        return self.trajectories[key]

    def _as_derivative(self, block: str, port: str, order: int) -> tuple[str, str, int]:
        """The output and order of which an output is declared to be the derivative."""
        stated = {known.name: known.derivative_of for known in self.models[block].block.outputs}
        outputs = self.models[block].equations.outputs
        seen = {port}
        while stated.get(port) in outputs and stated[port] not in seen:
            self._check_declared_derivative(block, stated[port], port)
            port, order = stated[port], order + 1
            seen.add(port)
        return block, port, order

    def _check_declared_derivative(self, block: str, port: str, stated: str) -> None:
        """Compare an output declared as a derivative with the derivative; a fault is reported once."""
        if (block, stated) in self._held:
            return
        self._held.add((block, stated))
        derived = ca.jtimes(self.output(block, port), self.time, ca.SX(1))
        if not _is_zero(ca.densify(derived - self.output(block, stated))):
            text = f"{block}.{stated}: expected the time derivative of {block}.{port}, as declared, found another"
            self.faults.append(DerivativeError(text, path=("blocks", block)))

    def _leaf_name(self, block: str, port: str, order: int) -> str:
        """``path.dr``, or the output that is this derivative; ``path.d(r)/dt`` if another output has that name."""
        name = f"{'d' * order}{port}"
        for known in self.models[block].block.outputs if order else ():
            if self._as_derivative(block, known.name, 0) == (block, port, order):
                return f"{block}.{known.name}"
            if known.name == name:
                name = f"d{order if order > 1 else ''}({port})/dt"
        return f"{block}.{name}"

    def _projected(self, model: BlockModel, state: str, rate: SX) -> SX:
        declared = next(item for item in model.block.states if item.name == state)
        chosen = [key for key in (declared.box, declared.ball, declared.bodies) if key in model.parameters]
        if not chosen:
            return rate
        if chosen == [declared.bodies]:
            return self._with_projection(model, state, rate, declared.bodies, self._bodies(model, declared))
        if len(chosen) > 1:
            text = (
                f"{model.name}: expected one of {declared.box} and {declared.ball}, found both; "
                f"{declared.box}: null removes the box"
            )
            self.faults.append(ValueFault(text, path=("blocks", model.name, declared.ball)))
        gain = model.parameters.get(declared.gain)
        if chosen[0] == declared.box and gain is not None and not gain.is_column():
            text = (
                f"{model.name}: {declared.box} cannot be combined with a full matrix {declared.gain}: the projection "
                f"onto a box is valid for a diagonal metric only; choose {declared.ball}; "
                f"{declared.box}: null removes the box"
            )
            self.faults.append(ValueFault(text, path=("blocks", model.name, declared.box)))
        first, second = ca.horzsplit(model.parameters[chosen[0]])
        kept = Box(first, second) if chosen[0] == declared.box else Ball(first, second, model.parameters[declared.gain])
        return self._with_projection(model, state, rate, chosen[0], kept)

    def _with_projection(
        self, model: BlockModel, state: str, rate: SX, parameter: str, kept: Box | Ball | Bodies
    ) -> SX:
        """The rate with the correction of the projection onto a set."""
        name, leaf = f"{model.name}.{state}", model.states[state]
        correction = symbol(f"{name}.correction", leaf.shape)
        self.projections[model.name, state] = Projection(
            name, f"{model.name}.{parameter}", leaf, rate, correction, kept
        )
        return rate + correction

    def _bodies(self, model: BlockModel, state: State) -> Bodies:
        """The set of physically consistent parameters, relative to the nominal ones."""
        (links,) = self.sizes.of("n")
        nominal = ca.densify(self.input(model.name, state.nominal))[: TEN * links]
        parameters = symbols_in(item for other in self.models.values() for item in other.parameters.values())
        robots = [other.robot.inertia for other in self.models.values() if other.robot is not None]
        if symbols_in([nominal]) - parameters - symbols_in(robots):
            text = (
                f"{model.name}: {state.bodies} requires constant nominal bodies, but {state.nominal} is not constant; "
                "use that of a regressor"
            )
            self.faults.append(ValueFault(text, path=("blocks", model.name, state.bodies)))
        return Bodies(nominal, model.parameters[state.bodies])

    @contextmanager
    def _entered(self, node: str) -> Iterator[bool]:
        """False if the node is already being resolved: an algebraic loop, which is recorded once."""
        if node in self._open:
            loop = self._open[self._open.index(node) :]
            if not any(
                isinstance(fault, AlgebraicLoopError) and set(fault.ports) >= set(loop) for fault in self.faults
            ):
                self.faults.append(loop_fault([*loop, node]))
            yield False
            return
        self._open.append(node)
        try:
            yield True
        finally:
            self._open.pop()


def _is_zero(difference: SX) -> bool:
    """True if it vanishes identically."""
    if difference.is_zero():
        return True
    symbols = ca.veccat(ca.SX(0, 1), *ca.symvar(difference))
    try:
        return zero_test(ca.Function("difference", [symbols], [difference])).zero
    except ValueFault:
        return False
