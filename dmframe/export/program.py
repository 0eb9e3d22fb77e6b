"""What an exported controller computes, and what its numbers are called."""

from __future__ import annotations

import hashlib
import keyword
import re
import unicodedata
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, final

import casadi as ca

from dmframe.block.model import symbols_in
from dmframe.config.experiment import Experiment
from dmframe.diagram import Diagram
from dmframe.diagram.closed_loop import stack
from dmframe.errors import EngineError, OutputError
from dmframe.files import told_apart
from dmframe.port import Side
from dmframe.robot.symbolic import SymbolicRobot
from dmframe.runtime.controller import control_function, path_function, path_leaves, start_function

_WORDS: Final = frozenset(
    "auto bool break case char const continue default do double else enum extern float for goto if inline int long "
    "register restrict return short signed sizeof static struct switch typedef union unsigned void volatile "
    "while "
    # later versions of C, and C++, which may include the header
    "alignas alignof asm catch concept constexpr delete explicit export false friend mutable namespace new noexcept "
    "nullptr operator private protected public requires static_assert template this thread_local throw true try "
    "typeid typename typeof using virtual xor".split()
)
_FILES: Final = frozenset(
    # beside the controller, and the prefix of its own functions
    "example replay samples dm "
    # headers of C, which an own one of this name would hide
    "assert complex ctype errno fenv float inttypes iso646 limits locale math setjmp signal stdarg stdbool stddef "
    "stdint stdio stdlib string tgmath threads time uchar wchar wctype memory strings unistd features "
    # targets of CMake
    "all clean depend edit_cache help install package package_source rebuild_cache test".split()
)
"""Names that no controller may have: its files would be others'."""


@final
@dataclass(frozen=True)
class Member:
    """Some numbers in a row.

    Parameters
    ----------
    label
        As the graph calls them, ``arm.q``.
    word
        As a program does, ``arm_q``.
    size
        How many; a matrix is kept column by column.
    value
        The graph's own numbers, of a parameter.
    """

    label: str
    word: str
    size: int
    unit: str
    value: tuple[float, ...] = ()


@final
@dataclass(frozen=True)
class Program:
    """A controller apart from its diagram: functions of numbers in a row, and what these are.

    Parameters
    ----------
    path
        What the controller is told of it: trajectories, their rates, and what they are later where it looks ahead.
    control
        (z, measured, t, T, p) -> (z one period later, commands), on the graph's own path.
    follow
        (z, measured, t, T, p, path) -> the same, on any path.
    own_path
        (t, T, p) -> path.
    start
        (measured, t, T, p) -> z.
    tool
        q -> x, where the robot's tool is; None without a robot.
    untold
        States whose start no measurement tells.
    model
        The hash of the closed loop, `Diagram.fingerprint`: that of a run and of a verification of the same model.
    """

    name: str
    title: str
    period: float
    measured: tuple[Member, ...]
    commanded: tuple[Member, ...]
    states: tuple[Member, ...]
    parameters: tuple[Member, ...]
    path: tuple[Member, ...]
    control: Any
    follow: Any
    own_path: Any
    start: Any
    tool: Any
    untold: tuple[str, ...]
    model: str


def program_of(experiment: Experiment, diagram: Diagram) -> Program:
    """The controller of a graph.

    Raises
    ------
    EngineError
        It runs in continuous time, commands nothing, or draws numbers.
    OutputError
        The name has no letter or digit.
    """
    loop, clock = diagram.loop, experiment.file.clock
    if not isinstance(clock, float):
        raise EngineError(
            f"{experiment.name}: expected a clock such as 8 ms, found continuous; an exported law is sampled"
        )
    if not loop.commanded:
        raise EngineError("export: expected a graph that commands something, found no wire to a plant")
    control = control_function(diagram)
    start, untold = start_function(diagram, experiment.start)
    inputs = [ca.SX.sym(word, control.numel_in(k)) for k, word in enumerate(("z", "measured", "t", "T"))]
    told = control(*inputs, loop.p)
    begun = start(*inputs[1:], loop.p)
    follow, own_path = control_function(diagram, path=True), path_function(diagram)
    path = ca.SX.sym("path", follow.numel_in(5))
    used = symbols_in([*told, begun])
    kept = [parameter for parameter in loop.parameters if used & symbols_in([parameter.symbol])]
    sides = {label: block.side for label, block in diagram.blocks.items()}
    for parameter in kept:
        if sides.get(parameter.label.split(".")[0]) is Side.PLANT:  # the diagram was built without such a way
            raise EngineError(f"export: the controller reads {parameter.label}, a number of the plant")
    p = stack(parameter.symbol for parameter in kept)
    units = {signal.label: signal.unit for signal in loop.outputs}
    return Program(
        name=own_name(experiment.name),
        title=experiment.file.title or "",
        period=clock,
        measured=members((leaf.name, leaf.symbol, units[leaf.name]) for leaf in loop.measured),
        commanded=members((leaf.name, leaf.symbol, units[leaf.name]) for leaf in loop.commanded),
        states=members((variable.label, variable.symbol, variable.unit) for variable in loop.controller),
        parameters=members((item.label, item.symbol, item.unit, item.value.ravel(order="F").tolist()) for item in kept),
        path=members((leaf.name, leaf.symbol, _path_unit(leaf.name, units)) for leaf in path_leaves(diagram)),
        control=ca.Function("control", [*inputs, p], list(told)),
        follow=ca.Function("follow", [*inputs, p, path], list(follow(*inputs, loop.p, path))),
        own_path=ca.Function("own_path", [*inputs[2:], p], [own_path(*inputs[2:], loop.p)]),
        start=ca.Function("start", [*inputs[1:], p], [begun]),
        tool=_tool(diagram),
        untold=untold,
        model=diagram.fingerprint,
    )


def _path_unit(name: str, units: Mapping[str, str]) -> str:
    """Of a trajectory, or of its rate, ``path.ddx_d``, which is no output of its own."""
    label, _, _ = name.partition("(")
    block, _, port = label.rpartition(".")
    for order in range(len(port)):
        if (unit := units.get(f"{block}.{port[order:]}")) is not None and port[:order] == "d" * order:
            below = "s" if order == 1 else f"s^{order}"
            return unit if order == 0 else f"{unit or 1}/{below}"
    return ""


def _tool(diagram: Diagram) -> Any:
    """Q -> where the tool is, with the robot's own lengths; None without a robot."""
    if diagram.robot is None:
        return None
    robot, q = SymbolicRobot(diagram.robot), ca.SX.sym("q", diagram.robot.n)
    symbols = stack(constant.symbol for constant in robot.constants)
    (x,) = ca.substitute([robot.position(q)], [symbols], [ca.vertcat(*map(ca.DM, robot.values().values()))])
    return ca.Function("tool", [q], [x])


def members(items: Iterable[Sequence[Any]]) -> tuple[Member, ...]:
    """Members from labels, symbols, units and, of parameters, values; words are told apart."""
    found = list(items)
    words = told_apart([identifier(item[0]) for item in found], "{}_{}".format)
    return tuple(
        Member(item[0], word, item[1].numel(), item[2], tuple(item[3]) if len(item) > 3 else ())
        for item, word in zip(found, words, strict=True)
    )


def own_name(name: str) -> str:
    """A graph's name as that of functions, files and targets: ``replay`` is ``replay_controller``."""
    word = identifier(name)
    return f"{word}_controller" if word.casefold() in _FILES else word


def _in_ascii(name: str) -> str:
    """Letters without their accents, and a few digits of the whole name's hash, so that no two names become one."""
    if name.isascii():
        return name
    plain = "".join(letter for letter in unicodedata.normalize("NFKD", name) if letter.isascii())
    return f"{plain or 'name'}_{hashlib.sha256(name.encode()).hexdigest()[:6]}"


def identifier(name: str) -> str:
    """A name as a word of C: ``arm.q`` is ``arm_q``."""
    word = re.sub(r"[^0-9A-Za-z]+", "_", _in_ascii(name)).strip("_")
    if not word:
        raise OutputError(f"{name!r}: expected a name with a letter or digit, as the name of a C function")
    return f"_{word}"[word[0].isalpha() :] + "_" * (word in _WORDS or keyword.iskeyword(word))
