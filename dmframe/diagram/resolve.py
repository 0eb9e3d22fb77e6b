"""From wired blocks to one set of expressions: outputs, rates and derived time derivatives, each resolved on demand.

Expressions stand in *leaves*: the states, the parameters, what is measured and commanded, and the
desired trajectories with their derivatives. The two sides meet only in `closed_loop`, so that the controller can be
had alone, as code, and the trajectories can be left free, as a theorem does.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import copy
from dataclasses import dataclass, replace
from typing import final

import casadi as ca

from dmframe.block.model import BlockModel, symbol, symbols_in
from dmframe.block.sizes import Sizes
from dmframe.certificate import SX
from dmframe.diagram.bodies import TEN, Bodies
from dmframe.diagram.projection import Ball, Box, Projection
from dmframe.diagram.wiring import Ahead, Derived, Drawn, End, Period, Source, Time, Wire
from dmframe.errors import AlgebraicLoopError, DerivativeError, DmframeError, ValueFault
from dmframe.exact import zero_test
from dmframe.port import TIME, Access, Side, State


@final
@dataclass(frozen=True)
class Leaf:
    """A signal cut out of the expressions: `name` is ``block.port``, `expression` what it stands for."""

    name: str
    side: Side
    symbol: SX
    expression: SX

    def standing_for(self, expression: SX) -> Leaf:
        """The same leaf with another meaning."""
        return replace(self, expression=expression)


@final
class Resolver:
    """Resolves each signal of a diagram once; faults are collected, so that all can be told together."""

    def __init__(self, models: Mapping[str, BlockModel], sources: Mapping[End, Source], sizes: Sizes) -> None:
        self.models, self.sources, self.sizes = models, sources, sizes
        self.time, self.period = ca.SX.sym("t"), ca.SX.sym("T")
        self.drawn = dict[End, SX]()
        self.ahead = dict[tuple[str, str, int], Leaf]()
        self.trajectories = dict[tuple[str, str, int], Leaf]()
        self.crossings = dict[End, Leaf]()
        self.projections = dict[End, Projection]()
        self.faults = list[DmframeError]()
        self._outputs, self._rates = dict[End, SX](), dict[End, SX]()
        self._held = set[End]()
        self._open = list[str]()

    def with_outputs(self, outputs: Mapping[End, SX]) -> Resolver:
        """The same diagram with these outputs replaced by other expressions, wherever another block reads them."""
        other = copy(self)
        other._outputs, other._rates, other.faults = dict(outputs), {}, []
        other.crossings, other.projections = dict(self.crossings), dict(self.projections)
        return other

    def output(self, block: str, port: str) -> SX:
        """An output in the leaves of its own side."""
        end = (block, port)
        if end not in self._outputs:
            expression = self.models[block].equations.outputs[port]
            with self._entered(f"{block}.{port}") as free:
                self._outputs[end] = self.expand(block, expression) if free else _unknown(end, expression)
        return self._outputs[end]

    def rate(self, block: str, state: str) -> SX:
        """The rate of a state between samples; a projected one carries its correction. A sampled state stands still."""
        end = (block, state)
        if end not in self._rates:
            model = self.models[block]
            if state in model.equations.next:
                rest = ca.SX.zeros(*model.states[state].shape)
                self._projected(model, state, rest)
                self._rates[end] = rest
                return rest
            stated = model.equations.rates[state]
            with self._entered(f"d{block}.{state}/dt") as free:
                rate = self.expand(block, stated) if free else _unknown(end, stated)
            self._rates[end] = self._projected(model, state, rate)
        return self._rates[end]

    def next(self, block: str, state: str) -> SX | None:
        """The value of a sampled state one sample later, before it is projected; None for one in continuous time."""
        stated = self.models[block].equations.next.get(state)
        return None if stated is None else self.expand(block, stated)

    def second(self, block: str, state: str) -> SX | None:
        """What a state's step on a clock has over T^2 beside its rate; None for most."""
        stated = self.models[block].equations.second.get(state)
        return None if stated is None else self.expand(block, stated)

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
                    return self.derivative(held, f"{block}.{port}") if free else _unknown((block, port), held)
            case _:
                return ca.SX.zeros(*model.inputs[port].shape)

    def _later(self, source: Source, samples: int) -> SX:
        """A source's output whole samples later, as a leaf; of one whose time is a signal, what that is then."""
        if not isinstance(source, Wire):  # `wire_blocks` refuses it
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
        """A source's output at the time that its clock will show: an output t_path, as t_path_1, ... say."""
        clock = self.sources[source.block, TIME.name]
        if not isinstance(clock, Wire):
            raise TypeError(clock)
        then = self.output(clock.block, f"{clock.port}_{samples}")
        model = self.models[source.block]
        return ca.substitute([model.equations.outputs[source.port]], [model.inputs[TIME.name]], [then])[0]

    def expand(self, block: str, expression: SX) -> SX:
        """An expression in a block's own symbols, its inputs replaced by what drives them."""
        model = self.models[block]
        needed = model.needs(expression)
        if not needed:
            return expression
        own = [ca.vec(model.inputs[name]) for name in needed]
        driven = [ca.vec(ca.densify(self.input(block, name))) for name in needed]
        return ca.substitute([expression], [ca.vertcat(*own)], [ca.vertcat(*driven)])[0]

    def derivative(self, expression: SX, wanted_by: str) -> SX:
        """The total time derivative along the equations of the expression's own side."""
        used = symbols_in([expression])
        self._refuse_steps(used, wanted_by)
        moving = list(self._moving(used, wanted_by))
        if not moving:
            return ca.SX.zeros(*expression.shape)
        leaves = ca.vertcat(*(ca.vec(leaf) for leaf, _ in moving))
        rates = ca.vertcat(*(ca.vec(ca.densify(rate)) for _, rate in moving))
        return ca.jtimes(expression, leaves, rates)

    def _refuse_steps(self, used: set[int], wanted_by: str) -> None:
        """What moves in steps has no time derivative."""
        drawn = (".".join(end) for end, leaf in self.drawn.items() if used & symbols_in([leaf]))
        for leaf in self.ahead.values():
            if used & symbols_in([leaf.symbol]):
                text = f"{wanted_by} is a time derivative of what looks ahead at {leaf.name}; take differences"
                self._tell_once(DerivativeError(text, path=("blocks", wanted_by.partition(".")[0])))
        steps = [
            f"{name}.{state}"
            for name, model in self.models.items()
            for state in model.equations.next
            if used & symbols_in([model.states[state]])
        ]
        for name in (*steps, *drawn):
            text = (
                f"{wanted_by} is a time derivative of what moves with {name}, which jumps from sample to sample; "
                "filter it in continuous time, or take differences"
            )
            self._tell_once(DerivativeError(text, path=("blocks", wanted_by.partition(".")[0])))

    def _tell_once(self, fault: DmframeError) -> None:
        if not any(str(known) == str(fault) for known in self.faults):
            self.faults.append(fault)

    def _moving(self, used: set[int], wanted_by: str) -> Iterator[tuple[SX, SX]]:
        if self.time.element_hash() in used:
            yield self.time, ca.SX(1)
        for name, model in self.models.items():
            for state, leaf in model.states.items():
                if used & symbols_in([leaf]):
                    yield leaf, self.rate(name, state)
        for key, trajectory in list(self.trajectories.items()):
            if used & symbols_in([trajectory.symbol]):
                yield trajectory.symbol, self.trajectory_rate(*key)
        for end, crossing in list(self.crossings.items()):
            if used & symbols_in([crossing.symbol]):
                yield crossing.symbol, self._rate_across(end, wanted_by)

    def _rate_across(self, end: End, wanted_by: str) -> SX:
        """The rate of a signal of the other side: measured itself, or computed by a block that declares it."""
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
            "computed by any block; a controller may use only what the robot hands out",
            path=("blocks", wanted_by.partition(".")[0]),
        )
        self._tell_once(fault)
        return ca.SX.zeros(*self._crossing(end).symbol.shape)

    def side(self, block: str) -> Side:
        """The side on which a block computes: a source whose time is a controller's signal computes with it."""
        return Side.CONTROLLER if self.paced(block) else self.models[block].block.side

    def paced(self, block: str) -> bool:
        """Whether a source's time is the signal of a block, and not t."""
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
        if end not in self.crossings:
            name, model = ".".join(end), self.models[end[0]]
            leaf = symbol(name, model.equations.outputs[end[1]].shape)
            self.crossings[end] = Leaf(name, self.side(end[0]), leaf, leaf)
        return self.crossings[end]

    def trajectory_rate(self, block: str, port: str, order: int) -> SX:
        """The next derivative of a source's output: a leaf, or zero where the source does not read the time.

        One that jumps between constants has the derivative zero too, but is not still.
        """
        held = self.trajectory(block, port, order)
        if self.steps(block, port):
            return ca.SX.zeros(*held.symbol.shape)
        if not symbols_in([held.expression]) & symbols_in([self.time]):
            return ca.SX.zeros(*held.symbol.shape)
        return self.trajectory(block, port, order + 1).symbol

    def steps(self, block: str, port: str) -> bool:
        """Whether a source declares that its output is constant between steps."""
        return any(known.name == port and known.steps for known in self.models[block].block.outputs)

    def _hold_still(self, held: Leaf, block: str) -> None:
        """Hold a source to its word that an output is constant between steps."""
        if not _is_zero(ca.densify(ca.jtimes(held.expression, self.time, ca.SX(1)))):
            text = (
                f"{held.name}: expected a signal that is constant between steps, as it declares, found one that moves"
            )
            self._tell_once(DerivativeError(text, path=("blocks", block)))

    def trajectory(self, block: str, port: str, order: int) -> Leaf:
        """A source's output, or a time derivative of it, as a leaf; of one that is stated too, one leaf for both."""
        key = block, port, order = self._as_derivative(block, port, order)
        if key not in self.trajectories:
            if order == 0:
                expression = self.output(block, port)
            else:
                expression = ca.jtimes(self.trajectory(block, port, order - 1).expression, self.time, ca.SX(1))
            name = self._leaf_name(block, port, order)
            self.trajectories[key] = Leaf(name, Side.SOURCE, symbol(name, expression.shape), expression)
            if order == 0 and self.steps(block, port):
                self._hold_still(self.trajectories[key], block)
        return self.trajectories[key]

    def _as_derivative(self, block: str, port: str, order: int) -> tuple[str, str, int]:
        """An output that the source declares to be a derivative of another, as the derivative of that one."""
        stated = {known.name: known.derivative_of for known in self.models[block].block.outputs}
        outputs = self.models[block].equations.outputs
        seen = {port}
        while stated.get(port) in outputs and stated[port] not in seen:
            self._hold_stated(block, stated[port], port)
            port, order = stated[port], order + 1
            seen.add(port)
        return block, port, order

    def _hold_stated(self, block: str, port: str, stated: str) -> None:
        """Hold an output that a source declares to be a derivative to the derivative. The fault is told once."""
        if (block, stated) in self._held:
            return
        self._held.add((block, stated))
        derived = ca.jtimes(self.output(block, port), self.time, ca.SX(1))
        if not _is_zero(ca.densify(derived - self.output(block, stated))):
            text = f"{block}.{stated}: expected the time derivative of {block}.{port}, as it declares, found another"
            self.faults.append(DerivativeError(text, path=("blocks", block)))

    def _leaf_name(self, block: str, port: str, order: int) -> str:
        """``path.dr``, or the output that is this derivative; where another output has that name, ``path.d(r)/dt``."""
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
            return self._among(model, state, rate, declared.bodies, self._bodies(model, declared))
        if len(chosen) > 1:
            text = (
                f"{model.name}: expected one of {declared.box} and {declared.ball}, found both; "
                f"{declared.box}: null takes the box away"
            )
            self.faults.append(ValueFault(text, path=("blocks", model.name, declared.ball)))
        gain = model.parameters.get(declared.gain)
        if chosen[0] == declared.box and gain is not None and not gain.is_column():
            text = (
                f"{model.name}: expected no {declared.box} beside a {declared.gain} that is a full matrix: a box is "
                f"normal to its coordinates in the metric of a diagonal alone; choose {declared.ball}; "
                f"{declared.box}: null takes the box away"
            )
            self.faults.append(ValueFault(text, path=("blocks", model.name, declared.box)))
        first, second = ca.horzsplit(model.parameters[chosen[0]])
        kept = Box(first, second) if chosen[0] == declared.box else Ball(first, second, model.parameters[declared.gain])
        return self._among(model, state, rate, chosen[0], kept)

    def _among(self, model: BlockModel, state: str, rate: SX, parameter: str, kept: Box | Ball | Bodies) -> SX:
        """The rate with a correction that keeps the state in a set."""
        name, leaf = f"{model.name}.{state}", model.states[state]
        correction = symbol(f"{name}.correction", leaf.shape)
        self.projections[model.name, state] = Projection(
            name, f"{model.name}.{parameter}", leaf, rate, correction, kept
        )
        return rate + correction

    def _bodies(self, model: BlockModel, state: State) -> Bodies:
        """The set of bodies around the nominal ones, which the parameters give."""
        (links,) = self.sizes.of("n")
        nominal = ca.densify(self.input(model.name, state.nominal))[: TEN * links]
        parameters = symbols_in(item for other in self.models.values() for item in other.parameters.values())
        robots = [other.robot.inertia for other in self.models.values() if other.robot is not None]
        if symbols_in([nominal]) - parameters - symbols_in(robots):
            text = (
                f"{model.name}: expected nominal bodies that stand still beside {state.bodies}, found {state.nominal} "
                "that moves; take that of a regressor"
            )
            self.faults.append(ValueFault(text, path=("blocks", model.name, state.bodies)))
        return Bodies(nominal, model.parameters[state.bodies])

    @contextmanager
    def _entered(self, node: str) -> Iterator[bool]:
        """False where the node is already being resolved: an algebraic loop, recorded once."""
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


def loop_fault(ports: Sequence[str]) -> AlgebraicLoopError:
    """A loop through these ports, which ends where it begins."""
    remedy = "break it with a block whose output depends on its states alone, such as a filter or an integrator"
    fault = AlgebraicLoopError(ports, remedy)
    fault.path = ("blocks", ports[0].partition(".")[0])
    return fault


def _is_zero(difference: SX) -> bool:
    """True where it vanishes identically."""
    if difference.is_zero():
        return True
    symbols = ca.veccat(ca.SX(0, 1), *ca.symvar(difference))
    try:
        return zero_test(ca.Function("difference", [symbols], [difference])).zero
    except ValueFault:
        return False


def _unknown(end: End, like: SX) -> SX:
    return symbol(".".join(end), like.shape)
