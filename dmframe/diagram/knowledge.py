"""True parameters of the robot that the equations of the controller contain, block by block.

A block that uses the robot gets its symbolic model with the true numbers. A proof holds for all values of those
numbers if controller and plant have the same values. That the controller knows them exactly is an assumption, which
has to be listed. The equations are therefore searched in three ways:

- for the symbols of the robot, which blocks should read;
- for numbers read from the chain itself, which leave no symbol: the equations are evaluated again with a robot of
  other numbers, and an expression that changes contains such a number;
- for joint axes and rotations that are 0 or 1, which leave no symbol either: the equations are evaluated again with
  all of them as symbols.

Only expressions that act are searched: rates of the controller, and commands. The initial value of an estimate, such as
``a_d_nominal``, is not assumed to be exact, so it does not count unless a rate reads it, as a leak does.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial
from typing import Any, Final, final

import casadi as ca
import numpy as np

from dmframe.block.certificate import SX
from dmframe.block.model import BlockModel, signals_of, stated_by, symbols_in
from dmframe.block.port import Side
from dmframe.block.steady import same_expression
from dmframe.common.errors import DmframeError, listed
from dmframe.diagram.diagram import Diagram
from dmframe.diagram.wiring import Derived, End, Wire
from dmframe.robot.chain import SerialChain

WORDS: Final[Mapping[str, str]] = {
    "lengths": "the link lengths",
    "axes": "the joint axes",
    "tool": "the tool offset",
    "tool_rotation": "the tool's orientation on the last link",
    "gravity": "gravity",
    "friction_velocity": "the friction velocity v_0",
    "inertia": "the masses and inertias",
}
"""Groups of the robot's true numbers, in the order in which a sentence lists them."""


@final
@dataclass(frozen=True)
class Known:
    """True parameters that one controller block contains.

    Parameters
    ----------
    block, kind
        Its name and type.
    groups
        Keys of `WORDS`, in their order; and labels ``block.port`` of measured outputs that are numbers of the plant.
    held_by
        For each group, the outputs and states of the block whose equations contain it.
    """

    block: str
    kind: str
    groups: tuple[str, ...]
    held_by: Mapping[str, tuple[str, ...]]

    @property
    def words(self) -> str:
        """``the link lengths, the joint axes and gravity``."""
        return listed([WORDS.get(group, group) for group in self.groups])


def known_truths(diagram: Diagram) -> tuple[Known, ...]:
    """Each controller block whose equations contain true numbers of the robot or the plant."""
    live = _live(diagram)
    found = []
    for name, model in diagram.models.items():
        if model.block.side is not Side.CONTROLLER:
            continue
        holding = dict[str, list[str]]()
        for group, signal in (*_of_robot(diagram, model), *_measured_constants(diagram, model)):
            if (name, signal) in live and signal not in holding.setdefault(group, []):
                holding[group].append(signal)
        order = [*(group for group in WORDS if holding.get(group)), *sorted(g for g in holding if g not in WORDS)]
        if order := [group for group in order if holding[group]]:
            held_by = {group: tuple(holding[group]) for group in order}
            found.append(Known(name, diagram.type_of(name), tuple(order), held_by))
    return tuple(found)


def _live(diagram: Diagram) -> set[End]:
    """Outputs and states of controllers that affect a rate of any block, directly or through other outputs."""
    live, waiting = set[End](), list[End]()
    for name, model in diagram.models.items():
        for state, move in model.equations.moves.items():
            live.add((name, state))
            waiting += [(name, port) for port in model.needs(move)]
    seen = set[End]()
    while waiting:
        block, port = waiting.pop()
        if (block, port) in seen:
            continue
        seen.add((block, port))
        source = diagram.sources[block, port]
        if isinstance(source, Derived):
            waiting.append((block, source.of))
            waiting += _rates_that_are_known(diagram)
        if isinstance(source, Wire) and (end := (source.block, source.port)) not in live:
            live.add(end)
            model = diagram.models[source.block]
            waiting += [(source.block, need) for need in model.needs(model.equations.outputs[source.port])]
    return live


def _rates_that_are_known(diagram: Diagram) -> list[End]:
    """Dependencies of outputs that are time derivatives: the derivative of a signal may use them."""
    return [
        (name, need)
        for name, model in diagram.models.items()
        for port in model.block.outputs
        if port.derivative_of and port.name in model.equations.outputs
        for need in model.needs(model.equations.outputs[port.name])
    ]


def _of_robot(diagram: Diagram, model: BlockModel) -> Iterator[tuple[str, str]]:
    """Groups of the robot's numbers with the signals of the block that contain them."""
    if model.robot is None:
        return
    stated = _signals(model)
    for group, symbols in _groups(model.robot).items():
        yield from ((group, signal) for signal, expression in stated.items() if symbols_in([expression]) & symbols)
    pointed, axes, tool = model.robot.with_free_axes()
    restated = _restated(diagram, model, pointed)
    for group, turned in (("axes", symbols_in([axes])), ("tool_rotation", symbols_in([tool]))):
        for signal in stated:
            if (signal not in restated and group == "axes") or symbols_in([restated.get(signal, ca.SX())]) & turned:
                yield group, signal
    others = _others(model.robot)
    if not list(_changed(diagram, model, others.pop("all"))):
        return
    for group, other in others.items():
        yield from ((group, signal) for signal in _changed(diagram, model, other))


def _changed(diagram: Diagram, model: BlockModel, robot: Any) -> Iterator[str]:
    """Outputs and rates that change with the numbers of the robot although the symbols are the same."""
    restated = _restated(diagram, model, robot)
    for signal, expression in _signals(model).items():
        if signal not in restated or not same_expression(restated[signal], expression):
            yield signal


def _signals(model: BlockModel) -> dict[str, SX]:
    return {**model.equations.outputs, **model.equations.moves}


def _groups(robot: Any) -> dict[str, set[int]]:
    """Identities of the symbols of each group."""
    columns = {constant.name.rpartition(".")[2]: constant.symbol for constant in robot.constants}
    links = robot.k - 3
    lengths = columns.pop("a_k")
    found = {"lengths": symbols_in([lengths[:links]]), "tool": symbols_in([lengths[links:]])}
    if "rotations" in columns:  # those of the tool come last
        turns = columns.pop("rotations")
        own = turns.numel() - sum(x not in (0, 1, -1) for row in robot.chain.tool_rotation for x in row)
        found |= {"axes": symbols_in([turns[:own]]), "tool_rotation": symbols_in([turns[own:]])}
    return found | {key: symbols_in([symbol]) for key, symbol in columns.items()}


def _restated(diagram: Diagram, model: BlockModel, robot: Any) -> dict[str, SX]:
    """The block's outputs and rates with another robot; empty if the block cannot be evaluated with it."""
    parameters = {**model.parameters, **model.starts}
    # as in the model: a repeated call gives the same expression
    signals = signals_of(model.name, model.inputs, model.states, parameters, robot)
    try:
        stated = stated_by(model.name, model.block, signals, diagram.sizes)
    except DmframeError:
        return {}
    return {**stated.outputs, **stated.moves}


def _others(robot: Any) -> dict[str, Any]:
    """Robots with the same symbols and other numbers, for each group and for all; in Pinocchio's model too."""
    chain = robot.chain
    moves = {"translation": lambda joint: _other(joint.translation)}
    turns = {"axis": lambda joint: _other(joint.axis), "rotation": lambda joint: tuple(map(_other, joint.rotation))}

    def joints(new: Mapping[str, Callable[[Any], Any]]) -> tuple[Any, ...]:
        return tuple(replace(joint, **{key: made(joint) for key, made in new.items()}) for joint in chain.joints)

    changes: dict[str, dict[str, Any]] = {
        "lengths": {"joints": joints(moves)},
        "axes": {"joints": joints(turns)},
        "tool": {"tool": _other(chain.tool)},
        "tool_rotation": {"tool_rotation": tuple(map(_other, chain.tool_rotation))},
        "gravity": {"gravity": _other(chain.gravity)},
        "friction_velocity": {"friction_velocity": chain.friction_velocity * math.pi},
        "inertia": {"inertia": tuple(map(_other, chain.inertia))},
    }
    everything = {key: value for change in changes.values() for key, value in change.items()}
    changes["all"] = everything | {"joints": joints(moves | turns)}
    return {
        group: robot.with_numbers(chain.with_other_numbers(change, partial(_other_model, chain, group)))
        for group, change in changes.items()
    }


def _other_model(chain: SerialChain, group: str) -> Any:
    """The chain's model in Pinocchio with other numbers of one group, or of all."""
    import pinocchio as pin

    model, turn = chain.model.copy(), pin.exp3(np.array([0.1, 0.2, 0.3]))

    def moved(place: Any, lengths: str, rotation: str) -> Any:
        far = place.translation * 1.5 + 0.1 if group in (lengths, "all") else place.translation
        return pin.SE3(place.rotation @ turn if group in (rotation, "all") else place.rotation, far)

    for i in range(1, model.njoints):
        model.jointPlacements[i] = moved(model.jointPlacements[i], "lengths", "axes")
        if group in ("inertia", "all"):
            body = model.inertias[i]
            model.inertias[i] = pin.Inertia(body.mass * 1.5 + 0.1, body.lever + 0.1, body.inertia * 1.5)
    tool = model.frames[chain.model_tool]
    tool.placement = moved(tool.placement, "tool", "tool_rotation")
    if group in ("gravity", "all"):
        model.gravity.linear = model.gravity.linear * 1.5 + 0.1
    return model


def _other(values: Sequence[Fraction]) -> tuple[Fraction, ...]:
    """Other numbers, all of them changed; a block may test for a zero or a one."""
    return tuple(value * Fraction(12345, 10007) + Fraction(1, 997) for value in values)


def _measured_constants(diagram: Diagram, model: BlockModel) -> Iterator[tuple[str, str]]:
    """Measured signals that are constant numbers of the plant, with the signals of the block that read them."""
    for port, symbol in model.inputs.items():
        source = diagram.sources[model.name, port]
        if not isinstance(source, Wire) or diagram.blocks[source.block].side is not Side.PLANT:
            continue
        (expression,) = diagram.loop.joined([diagram.resolver.output(source.block, source.port)])
        used = symbols_in([expression])
        moving = [diagram.loop.time, diagram.loop.state, *(leaf.symbol for leaf in diagram.loop.trajectories)]
        if used and not any(used & symbols_in([item]) for item in moving):
            for signal, stated in _signals(model).items():
                if symbols_in([stated]) & symbols_in([symbol]):
                    yield f"{source.block}.{source.port}", signal
