"""Checks of a block's class: types of its constants and parameters, and consistency of its names.

`malformed` runs when a class is created, before it is used; `breaches` runs when a diagram is built with it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields
from typing import Any, Final

from pydantic import PydanticUndefinedAnnotation

from dmframe.block.base import AbstractBlock
from dmframe.block.names import names_of
from dmframe.block.parameter import read, specs
from dmframe.block.port import DISTRIBUTIONS, TIME, Access, Adapted, Input, Output, Side, Signal, State
from dmframe.common.errors import DmframeError, UnitError, nearest
from dmframe.common.names import distinct, look_alikes, unicode_name
from dmframe.common.units import compatible, shorten

_LISTS: Final[Mapping[str, type[Signal | State | Adapted]]] = {
    "inputs": Input,
    "outputs": Output,
    "states": State,
    "truth": Input,
    "estimates": Adapted,
}
_KINDS: Final[Mapping[str, type]] = {"str": str, "bool": bool, "int": int, "Access": Access}
"""Types of the fields of a port, a state and a parameter, by their annotations."""


def malformed(block: type[AbstractBlock]) -> Iterator[str]:
    """Constants and parameters of a class that have the wrong type."""
    for name, kind in _LISTS.items():
        items = getattr(block, name)
        if not isinstance(items, tuple | list):
            hint = "; a comma makes a tuple of one" if isinstance(items, kind) else ""
            yield f"expected {name} to be a tuple of {kind.__name__}s, found {_short(items)}{hint}"
            continue
        for item in items:
            if not isinstance(item, kind):
                yield f"expected each of its {name} to be {_article(kind)}, found {_short(item)}"
            else:
                yield from _misfit(item, f"of the {kind.__name__.lower()} {_short(item.name)} in {name}")
    names = block.renamed
    if not isinstance(names, Mapping) or not all(isinstance(word, str) for pair in names.items() for word in pair):
        yield f"expected renamed to map old names to new ones, found {_short(names)}"
    if not isinstance(block.side, Side):
        yield f"expected its side to be a Side, found {_short(block.side)}"
    if not isinstance(block.uses_robot, bool):
        yield f"expected uses_robot to be True or False, found {_short(block.uses_robot)}"
    if not isinstance(block.unproved, str):
        yield f"expected unproved to be a text, found {_short(block.unproved)}"
    if not isinstance(by := getattr(block, "driven_by", ""), str):
        yield f"expected driven_by to be the name of an input or output, found {_short(by)}"
    yield from _mistyped(block)


def _mistyped(block: type[AbstractBlock]) -> Iterator[str]:
    """Parameters with an unknown annotation, or with a default of the wrong type."""
    if not block.__pydantic_complete__:
        try:
            block.model_rebuild()
        except PydanticUndefinedAnnotation as error:
            yield f"expected annotations that are defined in its module, found {error.name}; import it there"
            return
    for name, spec in specs(block).items():
        wrong = list(_misfit(spec, f"of the parameter {name}"))
        yield from wrong
        default = block.model_fields[name].default
        if wrong or default is None or block.model_fields[name].is_required():
            continue
        try:
            read(default, spec)
        except (DmframeError, ValueError) as error:
            yield f"the default of the parameter {name}: {error}"


def _misfit(item: Any, of: str) -> Iterator[str]:
    """Fields of a declaration whose type differs from their annotation."""
    for each in fields(item):
        value, kind = getattr(item, each.name), _KINDS[str(each.type)]
        if not isinstance(value, kind):
            expected = {str: "a text", int: "a whole number"}.get(kind, f"of type {kind.__name__}")
            yield f"expected the {each.name} {of} to be {expected}, found {_short(value)}"


def _article(kind: type) -> str:
    return f"{'an' if kind.__name__[0] in 'AIO' else 'a'} {kind.__name__}"


def _short(value: object) -> str:
    return shorten(repr(value), 40)


def breaches(block: type[AbstractBlock]) -> Iterator[str]:
    """Faults of a block's class, one text each."""
    kinds: dict[str, Sequence[Signal | State]] = {
        "input": block.inputs,
        "output": block.outputs,
        "state": block.states,
    }
    for kind, items in kinds.items():
        names = [item.name for item in items]
        yield from (f"declares the {kind} {name} twice" for name in sorted({n for n in names if names.count(n) > 1}))
        for item in items:
            try:
                compatible(item.unit, "")
            except UnitError as fault:
                yield f"the unit of the {kind} {item.name}: {fault.text}"
    for kind, ports, known in (
        ("input", block.inputs, [port.name for port in block.inputs]),
        ("output", block.outputs, [port.name for port in (*block.inputs, *block.outputs)]),
    ):
        for port in ports:
            of = port.derivative_of
            if of and of not in known:
                yield f"the {kind} {port.name} is declared the derivative of {of}, unknown; {nearest(of, known)}"
    for port in block.outputs:
        if port.rounded_by and port.rounded_by not in (names := list(specs(block))):
            hint = nearest(port.rounded_by, names)
            yield f"the output {port.name} is rounded by {port.rounded_by}, which is not a parameter; {hint}"
        elif port.rounded_by and not port.instead_of:
            yield f"the output {port.name} is declared rounded, but replaces no input; add instead_of"
    inputs = {port.name for port in block.inputs}
    for kind, own in (("state", {state.name for state in block.states}), ("parameter", set(specs(block)))):
        yield from (f"has an input and a {kind} called {name}; rename one" for name in sorted(inputs & own))
    for estimate in block.estimates:
        if estimate.memory == "G":
            name = estimate.name
            yield f"names the information matrix of {name} G, a reserved symbol; choose another name, such as G_{name}"
    present = set(names_of(block))
    for old, new in block.renamed.items():
        if new not in present:
            yield f"declares {old} renamed to {new}, which is not a parameter, state or port; {nearest(new, present)}"
        if old in present:
            yield f"declares {old} as renamed to {new}, and still has {old}"
    for reader in block.inputs:
        if reader.drawn and reader.drawn not in DISTRIBUTIONS:
            near = nearest(reader.drawn, DISTRIBUTIONS)
            yield f"the input {reader.name} is drawn from {reader.drawn}, unknown; {near}"
    for output in block.outputs:
        for word, declared, side in (("steps", output.steps, Side.SOURCE), ("is shown", output.shown, Side.CONTROLLER)):
            if declared and block.side is not side:
                yield f"declares that {output.name} {word}, but is no {side.value} output; remove the declaration"
    yield from _ahead_breaches(block)
    yield from _replacing_breaches(block)
    yield from _print_breaches(block)
    yield from _source_breaches(block)
    yield from _parameter_breaches(block)
    yield from _estimate_breaches(block)


def _ahead_breaches(block: type[AbstractBlock]) -> Iterator[str]:
    """Invalid declarations of inputs that are another input some samples later."""
    inputs = {port.name: port for port in block.inputs}
    for port in block.inputs:
        of = port.ahead_of
        if not of:
            continue
        if of not in inputs:
            yield f"the input {port.name} is declared {of} some samples later, unknown; {nearest(of, inputs)}"
        elif inputs[of].ahead_of:
            yield f"the input {port.name} is {of} some samples later, itself a future value; use the present one"
        elif block.side is Side.PLANT:
            yield f"the input {port.name} looks ahead, impossible in a plant; read {of}, or make it a controller"
        elif port.ahead < 1:
            yield f"the input {port.name} is {of} {port.ahead} samples later; expected 1 or more"
        elif port.drawn or port.derivative_of:
            yield f"the input {port.name} looks ahead, and is also drawn or a derivative; choose one"
        elif (inputs[of].shape, inputs[of].unit) != (port.shape, port.unit):
            yield f"the input {port.name} is {of} some samples later, and has another shape or unit"


def _replacing_breaches(block: type[AbstractBlock]) -> Iterator[str]:
    """Invalid outputs that replace a signal: such an output belongs to the plant and has the signal's shape."""
    inputs = {port.name: port for port in block.inputs}
    for port in block.outputs:
        if not port.instead_of:
            continue
        if block.side is not Side.PLANT:
            yield f"the output {port.name} replaces {port.instead_of}, but the block is not a plant; declare it as one"
        elif (original := inputs.get(port.instead_of)) is None:
            near = nearest(port.instead_of, inputs)
            yield f"the output {port.name} replaces {port.instead_of}, which is not an input; {near}"
        elif (original.shape.split(), original.unit) != (port.shape.split(), port.unit):
            yield f"the output {port.name} replaces {port.instead_of}, and has another shape or unit"


def _estimate_breaches(block: type[AbstractBlock]) -> Iterator[str]:
    """Invalid declarations of estimates in an adaptive block."""
    if block.estimates and not hasattr(block, "driven_by"):
        yield "declares estimates, but is not an AdaptingBlock"
    inputs, numbers = [port.name for port in block.inputs], specs(block)
    signals = ["", *inputs, *(port.name for port in block.outputs)]
    if (driven_by := getattr(block, "driven_by", "")) not in signals:
        yield f"is driven by {driven_by}, which is neither an input nor an output; {nearest(driven_by, signals[1:])}"
    for item in block.estimates:
        if item.gain not in numbers:
            near = nearest(item.gain, numbers)
            yield f"the gain of the estimate {item.name} is {item.gain or 'none'}, which is not a parameter; {near}"
        if item.nominal and item.nominal not in inputs:
            near = nearest(item.nominal, inputs)
            yield f"the estimate {item.name} starts at {item.nominal}, which is not an input; {near}"


def _print_breaches(block: type[AbstractBlock]) -> Iterator[str]:
    """Names with the same printed form, or with look-alike letters."""
    names = list(dict.fromkeys([*names_of(block), *(port.name for port in block.truth)]))
    for one, other in distinct(names):
        yield f"its names {one} and {other} both print as {unicode_name(one)}; rename one"
    for name in names:
        if not name.isidentifier():
            yield f"expected a name such as K_star, found {name!r}"
        elif strange := look_alikes(name):
            yield f"the name {name!a} contains {strange!a}, not a Latin or known Greek letter, which it may resemble"


def _source_breaches(block: type[AbstractBlock]) -> Iterator[str]:
    """Faults of a source. A proof treats a trajectory and its derivatives as free: it must depend on time alone."""
    if block.side is not Side.SOURCE:
        return
    why = "a source is a function of time alone"
    yield from (f"has the state {state.name}; {why}, so state it as a controller or a plant" for state in block.states)
    yield from (
        f"has the input {port.name}; {why}, and its one input is t, as dmframe.block.port.TIME"
        for port in block.inputs
        if port != TIME
    )
    yield from (f"reads the truth {port.name}; {why}, and has no proof that could use it" for port in block.truth)
    for method in ("certificate", "start"):
        if getattr(block, method) is not getattr(AbstractBlock, method):
            yield f"overrides {method}; {why}: it has no states, so remove {method}()"


def _parameter_breaches(block: type[AbstractBlock]) -> Iterator[str]:
    numbers = specs(block)
    boxes = [name for name, spec in numbers.items() if spec.form == "box"]
    for name in block.model_fields:
        if hasattr(AbstractBlock, name):
            yield f"the parameter {name} hides the attribute {name} of every block; rename it"
    for name, spec in numbers.items():
        try:
            compatible(spec.unit, "")
        except UnitError as fault:
            yield f"the unit of the parameter {name}: {fault.text}"
    balls = [name for name, spec in numbers.items() if spec.form == "ball"]
    for state in block.states:
        if state.box and state.box not in boxes:
            yield f"the box of {state.name} is {state.box}, not an Interval parameter; {nearest(state.box, boxes)}"
        if state.ball and state.ball not in balls:
            near = nearest(state.ball, balls)
            yield f"the ball of {state.name} is {state.ball}, which is not an Around parameter; {near}"
        if state.ball and state.gain not in numbers:
            yield f"the gain of {state.name}, with a ball, is not a parameter; {nearest(state.gain, numbers)}"
        if state.bodies and (state.bodies not in numbers or numbers[state.bodies].sign != "> 0"):
            near = nearest(state.bodies, [name for name, spec in numbers.items() if spec.sign == "> 0"])
            yield f"the fraction of bodies of {state.name} is {state.bodies}, which is not a Positive parameter; {near}"
        inputs = [port.name for port in block.inputs]
        if state.bodies and state.nominal not in inputs:
            near = nearest(state.nominal, inputs)
            yield f"the nominal bodies of {state.name} are {state.nominal}, which is not an input; {near}"
        if state.name in numbers and numbers[state.name].shape.split() != state.shape.split():
            yield f"the parameter {state.name} and the state that it initialises have different shapes"
        start = f"{state.name}_0"
        if state.name in numbers and (start in numbers or start in (other.name for other in block.states)):
            yield f"{start} is the start of the state {state.name}, which the parameter {state.name} sets; rename it"
