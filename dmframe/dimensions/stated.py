"""Expressions of a block with their required dimensions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, final

import casadi as ca

from dmframe.block.base import Signals
from dmframe.block.certificate import (
    SX,
    Certificate,
    CommonLyapunov,
    Condition,
    Inequality,
    LogDet,
    StableLinear,
)
from dmframe.block.faults import fault_context
from dmframe.block.model import BlockModel, symbol
from dmframe.block.sizes import Sizes
from dmframe.common.errors import DmframeError
from dmframe.dimensions.declared import Declared

STORED = ("the storage S", "the weight of a storage term")
"""Items that have the unit of a block's storage."""


@final
@dataclass(frozen=True, eq=False)
class Item:
    """One expression.

    Parameters
    ----------
    what
        Its name in messages: ``the output tau_c``.
    expression
        A matrix.
    expected
        The dimension of each element, column by column; empty for any dimension, so that only sums are checked.
    numbers
        Literal numbers are in the expected unit, as in a graph file.
    """

    what: str
    expression: SX
    expected: tuple[int, ...] = ()
    numbers: bool = False


def items_of(model: BlockModel, sizes: Sizes, declared: Declared) -> list[Item]:
    """All expressions of a block. A method that raises gives none here; `verify` reports the exception."""
    found = list(_equations(model, declared))
    truth = _truth(model, sizes, declared)
    u, x, p = model.signals()
    block = model.block
    try:
        with fault_context(model.name, "start()"):
            found += _starts(model, declared, block.composed_start(u, p, truth))
        with fault_context(model.name, "certificate()"):
            certificate = block.composed_certificate(u, x, p, truth)
        with fault_context(model.name, "conditions()"):
            conditions = block.composed_conditions(p, truth)
        if isinstance(certificate, Certificate):
            sampled = any(state.sampled for state in block.states)
            found += [*_certificate(certificate, declared, sampled), *_discrete_time(certificate, declared)]
        for condition in conditions:
            found += _condition(condition, declared)
    except DmframeError:
        pass
    return found


def _truth(model: BlockModel, sizes: Sizes, declared: Declared) -> Signals:
    values = dict[str, SX]()
    for port in model.block.truth:
        try:
            values[port.name] = symbol(f"true {port.name}", sizes.of(port.shape))
        except KeyError:
            continue
        declared.add(port, values[port.name])
    return Signals(model.name, "truth", values)


def _equations(model: BlockModel, declared: Declared) -> Iterator[Item]:
    block, equations, algebra = model.block, model.equations, declared.algebra
    second = declared.unit("s")
    for port in block.outputs:
        if port.name in equations.outputs:
            expression = equations.outputs[port.name]
            yield Item(f"the output {port.name}", expression, tuple(declared.of_item(port, *expression.shape)))
    for state in block.states:
        kinds = (
            ("the rate of", equations.rates, -1),
            ("the next value of", equations.next, 0),
            ("the second term of", equations.second, -2),
        )
        for what, stated, power in kinds:
            if state.name in stated:
                expression = stated[state.name]
                own = declared.of_item(state, *expression.shape)
                yield Item(
                    f"{what} {state.name}", expression, tuple(algebra.product(each, second, power) for each in own)
                )


def _starts(model: BlockModel, declared: Declared, starts: Mapping[str, Any]) -> Iterator[Item]:
    for state in model.block.states:
        if state.name in starts:
            expression = ca.SX(starts[state.name])
            own = tuple(declared.of_item(state, *expression.shape))
            yield Item(f"the start of {state.name}", expression, own, numbers=True)


def _certificate(certificate: Certificate, declared: Declared, sampled: bool) -> Iterator[Item]:
    """All terms of S have one unit, and those of dS/dt, or of the increment per sample, have it per second."""
    algebra, second = declared.algebra, declared.unit("s")
    energy = algebra.unknown()
    power = energy if sampled else algebra.product(energy, second, -1)
    for stored in certificate.storage:
        if isinstance(stored, LogDet):  # the logarithm of a determinant ratio is dimensionless
            matrix = ca.densify(ca.SX(stored.matrix - stored.true))
            yield Item("the matrices of a storage term", matrix)
            yield Item("the weight of a storage term", ca.SX(stored.weight), (energy,))
        else:
            yield Item("the storage S", ca.SX(stored.value), (energy,))
    for terms, what in ((certificate.dissipation, "the dissipation"), (certificate.residual, "the residual")):
        for lost in terms:
            yield Item(what, ca.SX(lost.value), (power,))
    yield Item("the supply rate", ca.SX(certificate.supply), (power,))
    if certificate.consumes is not None:
        yield Item("the cross term with the servo level", ca.SX(certificate.consumes.value), (power,))
    for name, value in certificate.truth.items():
        yield Item(f"the true {name}", ca.SX(value))
    for error in certificate.errors:
        yield Item("an error", ca.SX(error.value))
    yield from _consumed(certificate, declared)
    for subsystem in certificate.linear:
        yield from _linear_subsystem(subsystem, declared)
    for barrier in certificate.barriers:
        position = ca.SX(barrier.position - barrier.upper) + ca.SX(barrier.margin)
        own = tuple(algebra.unknown() for _ in range(position.numel()))
        yield Item("the room of a barrier", position, own)
        speeds = tuple(algebra.product(each, second, -1) for each in own)
        yield Item("the reference of a barrier", ca.SX(barrier.reference), speeds)


def _consumed(certificate: Certificate, declared: Declared) -> Iterator[Item]:
    """The weighted sum of dissipated vectors that dominates a cross term."""
    terms = list(zip(certificate.dominates, certificate.dissipation, strict=False))
    if len(terms) < 2:
        return
    vectors = [ca.SX(coefficient) * ca.SX(term.pieces[0]) for coefficient, term in terms]
    yield Item("the terms that dominate a cascade's cross term", sum(vectors[1:], vectors[0]))


def _linear_subsystem(subsystem: StableLinear, declared: Declared) -> Iterator[Item]:
    """The signals of each equation have their own units; a rate A_jk maps that of z_k to that of z_j per second."""
    algebra, second = declared.algebra, declared.unit("s")
    vectors = [ca.SX(vector) for vector in subsystem.vectors]
    units = [[algebra.unknown() for _ in range(vector.numel())] for vector in vectors]
    for own, vector, rates in zip(units, vectors, subsystem.rates, strict=True):
        yield Item("a signal of a stable linear subsystem", vector, tuple(own))
        for rate, other in zip(map(ca.SX, rates), units, strict=True):
            pairs = zip(own, other, strict=False)
            expected = [algebra.product(algebra.product(one, by, -1), second, -1) for one, by in pairs]
            if not rate.is_zero():
                yield Item("the rate of a signal of a stable linear subsystem", rate, tuple(expected[: rate.numel()]))
    for own, given in zip(units, subsystem.inputs, strict=False):
        column = ca.SX(given)
        expected = [algebra.product(one, second, -1) for one in own]
        yield Item("the input of a signal of a stable linear subsystem", column, tuple(expected[: column.numel()]))
    for condition in subsystem.otherwise:
        yield from _condition(condition, declared)


def _condition(condition: Condition, declared: Declared) -> Iterator[Item]:
    if isinstance(condition, Inequality):
        yield Item(f"the condition {condition.name}", ca.SX(condition.expression))
    elif isinstance(condition, CommonLyapunov):
        rate = declared.unit("1/s")
        square = declared.algebra.product(rate, rate)
        for matrix, each in ((ca.SX(condition.a), rate), (ca.SX(condition.b), square)):
            yield Item(f"the condition {condition.name}", matrix, (each,) * matrix.numel())


def _discrete_time(certificate: Certificate, declared: Declared) -> Iterator[Item]:
    """All terms of V of sampled steps have one unit, as do the prediction and the output of each row."""
    algebra, second = declared.algebra, declared.unit("s")
    for steps in certificate.steps:
        error = ca.SX(steps.theta - steps.true)
        weighed = error * error / steps.gain
        yield Item("the storage V", weighed, (algebra.unknown(),) * weighed.numel())
        ends = [sum(steps.parts[: j + 1]) for j in range(len(steps.parts))]
        for h, y in steps.rows[:1]:
            for j, (end, count) in enumerate(zip(ends, steps.parts, strict=True)):
                part = slice(end - count, end)
                yield Item("a row's prediction", ca.dot(h[part], steps.theta[part]) - y[j])
                yield Item("a row's norm", steps.floor + ca.dot(h[part] * h[part], steps.gain[part]))
    for relation in certificate.plant:
        moved = ca.SX(relation.momentum)
        own = tuple(algebra.unknown() for _ in range(moved.numel()))
        yield Item("the momentum of a plant identity", moved, own)
        yield Item(
            "the remainder of a plant identity",
            ca.SX(relation.rest),
            tuple(algebra.product(o, second, -1) for o in own),
        )
