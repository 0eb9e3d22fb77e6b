"""Values of the names in a docstring at one point, given to the block or computed by it."""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, final

import casadi as ca
import numpy as np

from dmframe.block.certificate import Certificate
from dmframe.block.symmetric import full_gains
from dmframe.common.names import Symbol, latex_name, symbol
from dmframe.formula.latex import tokens
from dmframe.formula.laws import ReadBlock
from dmframe.formula.matrices import Numbers
from dmframe.formula.robot import PAPER, SIGNS
from dmframe.formula.stated import Stated
from dmframe.robot.parameters import DynamicParameters

_PAPER: Final = tuple((method, sign) for sign, method in PAPER.items())


@final
@dataclass(frozen=True)
class Point:
    """Values of the names in a docstring at one random point, with some options of the block.

    Parameters
    ----------
    names
        Values of all names.
    computed
        Values computed by the code, with which equations are compared: outputs, S, named sub-expressions.
    rates
        Rates of states and of S.
    after
        Sampled states one sample later.
    """

    names: Mapping[Symbol, Numbers]
    computed: Mapping[Symbol, Numbers]
    rates: Mapping[Symbol, Numbers]
    after: Mapping[Symbol, Numbers]
    read: ReadBlock

    def look(self, name: Symbol) -> Numbers | None:
        """The value of a name, or the rate for a dotted name."""
        for known in (self.computed, self.names):
            if name in known:
                return known[name]
        return self.moved(name)

    def moved(self, name: Symbol) -> Numbers | None:
        """Value of a dotted name, or of one with a superscript plus; None for names that are not those of states."""
        bare, before = undotted(name), _before(name)
        found = None if before is None else self.after.get(before)
        return self.rates.get(bare) if found is None and bare is not None else found

    def call(self, name: Symbol, arguments: Sequence[Numbers]) -> Numbers | None:
        """A function of the robot, J(q)."""
        robot, functions = self.read.signs.robot, self.read.reading.functions
        methods = [method for method, sign in (*SIGNS.items(), *_PAPER) if symbol(sign) == name]
        if robot is None or functions is None or not methods:
            return None
        parameters = list(inspect.signature(getattr(robot, methods[0])).parameters)[: len(arguments)]
        try:
            function = functions.of_method(methods[0], tuple(parameters))
            given = {name: ca.DM(value) for name, value in zip(parameters, arguments, strict=True)}
            if "inertia" in given:  # a_d, whose inertial parameters the quantities of the robot use
                given["inertia"] = given["inertia"][DynamicParameters(robot.chain).inertial, :]
            return np.array(function(*given.values(), functions.values).full())
        except (RuntimeError, KeyError, TypeError):  # arguments of other sizes: it is a product
            return None


def _is_inverted(name: str, equations: Sequence[Stated]) -> bool:
    """True if an equation contains ``name^{-1}``."""
    inverse = " ".join(_bare([*tokens(latex_name(name)), "^", "-", "1"]))
    return any(f" {inverse} " in f" {' '.join(_bare(item.right))} " for item in equations)


def _bare(words: Sequence[str]) -> list[str]:
    return [word for word in words if word not in "{}"]


def undotted(name: Symbol) -> Symbol | None:
    """The name without its dot; None if it has none."""
    last = name.accents[-1:]
    if last == ("dot",):
        return replace(name, accents=name.accents[:-1])
    return replace(name, accents=(*name.accents[:-1], "dot")) if last == ("ddot",) else None


def _before(name: Symbol) -> Symbol | None:
    """The name without its plus, which means one sample later; None if it has none.

    A plus also means a pseudo-inverse, so only the plus of a sampled state is read as the next value.
    """
    return replace(name, index=name.index[:-1]) if name.index[-1:] == ("^+",) else None


def values_at(read: ReadBlock, seed: int, equations: Sequence[Stated]) -> dict[str, Any]:
    """One random point; full gains and matrices that the docstring inverts are symmetric and positive definite."""
    values, gains = read.reading.values(read.signs, seed), full_gains(read.model.block, read.model.parameters)
    values |= {name: number.full() for name, number in read.reading.constants.items()}
    for name, value in values.items():
        if (
            name not in gains
            and np.ndim(value) == 2
            and value.shape[0] == value.shape[1] > 1
            and _is_inverted(name, equations)
        ):
            most = max(1.0, float(np.max(np.abs(value))) ** 2)
            values[name] = np.asarray(value) @ np.asarray(value).T + most * np.eye(value.shape[0])
    return values


def point_of(read: ReadBlock, values: Mapping[str, Any]) -> Point:
    """The values of all names that a docstring of this block may use."""
    names = {symbol(name): np.array(ca.DM(value)) for name, value in values.items()}
    names |= {symbol(name): np.zeros(read.model.inputs[name].shape) for name in read.reading.zero}
    definitions = read.signs.naming.definitions
    defined = read.reading.of_signs(read.signs, [expression for _, expression in definitions.values()]).at(values)
    equations = read.model.equations
    outputs, rates = equations.outputs, equations.rates
    run = read.reading.of_running().at(values)
    computed = dict(zip(map(symbol, definitions), defined, strict=True))
    computed |= {symbol(name): value for name, value in zip(outputs, run, strict=False)}
    truths = read.certificate.truth
    true = read.reading.of_signs(read.signs, list(truths.values())).at(values)
    computed |= {symbol(name): value for name, value in zip(truths, true, strict=True)}
    moves = run[len(outputs) :]
    moving = {symbol(name): value for name, value in zip(rates, moves, strict=False)}
    after = {symbol(name): value for name, value in zip(equations.next, moves[len(rates) :], strict=True)}
    stated = read.scalars
    if stated.storage or stated.dissipation:
        S, dS = read.reading.of_signs(read.scalar_signs, energies(stated)).at(values)
        computed, moving = {Symbol("S"): S, **computed}, {Symbol("S"): dS, **moving}
    return Point(names, {key: value for key, value in computed.items() if key not in names}, moving, after, read)


def energies(stated: Certificate) -> list[Any]:
    """S, and its rate according to the certificate."""

    def total(terms: Sequence[Any]) -> Any:
        return sum((ca.SX(term.value) for term in terms), ca.SX(0))

    claimed = total(stated.residual) - total(stated.dissipation) + ca.SX(stated.supply)
    if stated.consumes is not None:
        claimed += stated.consumes.value
    return [total(stated.storage) / 2, claimed]
