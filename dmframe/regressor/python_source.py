"""Regressors as a Python module that requires only NumPy."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from dmframe.common.errors import ValueFault
from dmframe.common.files import write_text
from dmframe.common.version import version
from dmframe.program import CONST, Node, by_code, read, run
from dmframe.regressor.base_parameters import base_parameters
from dmframe.regressor.export import (
    kinematic_function,
    kinematic_names,
    kinematic_values,
    polarised_regressor,
    regressor_function,
    tool_velocity,
    travel_of_prismatic_joints,
)
from dmframe.robot.chain import SerialChain
from dmframe.robot.parameters import DynamicParameters

RULES: Final = by_code(
    {
        "add": "{} + {}".format,
        "sub": "{} - {}".format,
        "mul": "{} * {}".format,
        "div": "{} / {}".format,
        "neg": "-{}".format,
        "sq": "{0} * {0}".format,
        "twice": "{0} + {0}".format,
        "inv": "1.0 / {}".format,
        "sin": "np.sin({})".format,
        "cos": "np.cos({})".format,
        "tanh": "np.tanh({})".format,
    }
)

_TEMPLATE: Final = '''"""{title}

{law}

Written by dmframe {version}. Requires only NumPy.
"""

import numpy as np

PARAMETERS = (
{parameters}
)
"""The columns of {name}."""

VALUES = np.array([
{values}
])
"""Their values in the robot's model, in SI units; {friction}."""


def {name}({arguments}):
    """{name}, shape (..., {rows}, {columns}), of {arguments}, each of shape (..., {joints}).

    Joints from the base to the tool; rad, rad/s and rad/s^2 (m for a prismatic joint).
    """
    {arguments} = np.broadcast_arrays({arguments})
{statements}
    {name} = np.zeros((*q.shape[:-1], {rows}, {columns}))
{results}
    return {name}
'''


def python_source(
    chain: SerialChain, friction: Collection[str] = (), base: bool = False, kinematic: bool = False
) -> str:
    """A module with a function ``Y_d(q, dq, dq_ref, ddq_ref)``, or ``Y_k(q, psi)``, and its parameters.

    It is the instruction tape of the CasADi function, one line per operation, and works on whole arrays of motions.
    With `base`, the columns and values are those of the base parameters.

    Raises `UnknownNameError` for another kind of friction.
    """
    names: Sequence[str]
    numbers: Sequence[float]
    if kinematic:
        function, names, numbers = kinematic_function(chain), kinematic_names(chain), kinematic_values(chain)
        title, law = f"Kinematic regressor of {_plain(chain.name)}.", "J(q) psi = Y_k(q, psi) a_k."
        if any(joint.kind == "prismatic" for joint in chain.joints):
            law = "J(q) psi = Y_k(q, psi) a_k, and the travel of the prismatic joints, which no parameter scales."
    else:
        function = regressor_function(chain, friction, base)
        names, numbers = _dynamic(chain, friction, base)
        title = f"Dynamic regressor of {_plain(chain.name)}{', in base parameters' if base else ''}."
        law = "M(q) ddq_ref + C(q, dq) dq_ref + g(q) [+ friction] = Y_d(q, dq, dq_ref, ddq_ref) a_d, C Christoffel's."
    statements, results = _statements(function)
    rows, columns = function.size_out(0)
    return _TEMPLATE.format(
        title=title,
        law=law,
        version=version(),
        name=function.name_out(0),
        arguments=", ".join(function.name_in()),
        joints=chain.n,
        rows=rows,
        columns=columns,
        parameters=_lines([f'"{name}"' for name in names]),
        values=_lines(["np.nan" if math.isnan(number) else repr(number) for number in numbers]),
        friction="friction, which the model does not state, is nan" if friction else "rounded to doubles",
        statements="\n".join(statements),
        results="\n".join(results),
    )


def write_python(
    chain: SerialChain, path: Path, friction: Collection[str] = (), base: bool = False, kinematic: bool = False
) -> float:
    """Write `python_source` to a file, atomically; returns its difference from Pinocchio (see `python_difference`).

    Raises `OutputError` if it cannot be written.
    """
    source = python_source(chain, friction, base, kinematic)
    write_text(path, source)
    return python_difference(chain, source, friction, base)


def python_difference(
    chain: SerialChain, source: str, friction: Collection[str] = (), base: bool = False, points: int = 10, seed: int = 0
) -> float:
    """Largest difference of a module's Y_d, or of its Y_k a_k, from Pinocchio, relative to the largest entry.

    Friction columns, which Pinocchio does not have, are omitted.
    """
    module: dict[str, Any] = {}
    exec(compile(source, chain.name, "exec"), module)
    q, dq, dq_ref, ddq_ref = np.random.default_rng(seed).uniform(-2, 2, (4, points, chain.n))
    if "Y_k" in module:
        free = travel_of_prismatic_joints(chain)
        found = [Y @ module["VALUES"] + free(*motion) for Y, *motion in zip(module["Y_k"](q, dq), q, dq, strict=True)]
        expected = [tool_velocity(chain, *motion) for motion in zip(q, dq, strict=True)]
    else:
        every = DynamicParameters(chain).size
        columns = base_parameters(chain, friction, symbolic=False).independent if base else range(every)
        inertial = [column for column in columns if column < every]
        found = list(module["Y_d"](q, dq, dq_ref, ddq_ref)[..., : len(inertial)])
        motions = zip(q, dq, dq_ref, ddq_ref, strict=True)
        expected = [polarised_regressor(chain, *motion)[:, inertial] for motion in motions]
    pairs = zip(found, expected, strict=True)
    return max(float(np.max(np.abs(a - b)) / max(float(np.max(np.abs(b))), 1e-300)) for a, b in pairs)


def _dynamic(chain: SerialChain, friction: Collection[str], base: bool) -> tuple[Sequence[str], list[float]]:
    parameters = DynamicParameters(chain, friction)
    values = [math.nan if value is None else float(value) for value in parameters.values]
    if not base:
        return parameters.names, values
    found = base_parameters(chain, friction, symbolic=False)
    sums = [sum(float(x) * v for x, v in zip(row, values, strict=True) if x) for row in found.grouping]
    return found.kept, sums


def _statements(function: Any) -> tuple[list[str], list[str]]:
    """A line for each instruction, and one for each entry of the result that is not zero."""
    program, lines = read(function), list[str]()

    def keep(node: Node, text: str) -> str:
        if node.code == CONST:
            return text
        name = f"w{node.line}"
        lines.append(f"    {name} = {text}")
        return name

    names = run(
        program,
        RULES,
        given=lambda argument, element: f"{program.inputs[argument].name}[..., {element}]",
        constant=_number,
        refuse=lambda code: ValueFault(
            f"Python source of {program.name}: expected plain operations, found CasADi's {code}"
        ),
        keep=keep,
    )
    (output,), (elements,) = program.outputs, program.stored(names)
    entries = [(*divmod(place, output.rows), name) for place, name in zip(output.places, elements, strict=True)]
    return lines, [f"    {output.name}[..., {i}, {j}] = {name}" for j, i, name in entries if name != "0.0"]


def _number(value: float) -> str:
    return repr(value) if value >= 0 else f"({value!r})"


def _lines(items: Sequence[str]) -> str:
    return "\n".join("    " + ", ".join(items[k : k + 6]) + "," for k in range(0, len(items), 6))


def _plain(name: str) -> str:
    """A name that cannot end a Python text."""
    return name.replace("\\", "/").replace('"', "'").replace("\n", " ")
