"""Functions and names of an exported controller."""

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
from dmframe.block.port import Side
from dmframe.common.errors import EngineError, OutputError
from dmframe.common.files import made_distinct
from dmframe.config import BaseGraph
from dmframe.diagram.closed_loop import stack
from dmframe.robot.symbolic import tool_position
from dmframe.runtime.controller import control_function, path_function, path_leaves, start_function

_WORDS: Final = frozenset(
    "auto bool break case char const continue default do double else enum extern float for goto if inline int long "
    "register restrict return short signed sizeof static struct switch typedef union unsigned void volatile "
    "while "
    # later versions of C, and C++, which may include the header
    "alignas alignof asm catch concept constexpr delete explicit export false friend mutable namespace new noexcept "
    "nullptr operator private protected public requires static_assert template this thread_local throw true try "
    "typeid typename typeof using virtual xor "
    # macros of C and POSIX of the form block_port
    "and_eq bit_and not_eq or_eq xor_eq h_addr math_errhandling pthread_cleanup_pop pthread_cleanup_push s6_addr "
    "sa_handler sa_sigaction sched_priority si_addr si_band si_fd si_int si_overrun si_pid si_ptr si_status si_stime "
    "si_timerid si_uid si_utime si_value st_atime st_ctime st_mtime va_arg va_copy va_end va_start".split()
)
_FILES: Final = frozenset(
    # other files of the export, and the prefix of its functions
    "example replay samples dm "
    # headers of C, which the exported header would hide
    "assert complex ctype errno fenv float inttypes iso646 limits locale math setjmp signal stdarg stdbool stddef "
    "stdint stdio stdlib string tgmath threads time uchar wchar wctype memory strings unistd features "
    # and of POSIX and glibc, some of which are included by the headers of C
    "aio alloca ar byteswap cpio dirent dlfcn elf endian err error fcntl fnmatch ftw getopt glob grp iconv langinfo "
    "libgen libintl link malloc monetary mqueue netdb nl_types nss poll pthread pwd regex regexp resolv sched search "
    "semaphore spawn syscall sysexits syslog tar termios ucontext ulimit utime utmp values wait wordexp xlocale "
    # targets of CMake
    "all clean depend edit_cache help install package package_source rebuild_cache test".split()
)
"""Names that a controller must not have, since its files would collide with others."""


@final
@dataclass(frozen=True)
class Member:
    """A signal, state or parameter as consecutive numbers.

    Parameters
    ----------
    label
        Name in the graph, ``arm.q``.
    word
        Name in a program, ``arm_q``.
    size
        Count of numbers; matrices are column-major.
    value
        Values of a parameter in the graph.
    """

    label: str
    word: str
    size: int
    unit: str
    value: tuple[float, ...] = ()


@final
@dataclass(frozen=True)
class Program:
    """A controller separated from its diagram: functions of vectors, and the members of the vectors.

    Parameters
    ----------
    path
        Trajectories that the controller reads, their rates, and future values for preview.
    control
        (z, measured, t, T, p) -> (z one period later, commands), on the graph's path.
    follow
        (z, measured, t, T, p, path) -> the same, on any path.
    own_path
        (t, T, p) -> path.
    start
        (measured, t, T, p) -> z.
    tool
        q -> x, the tool position; None without a robot.
    unmeasured
        States whose initial values do not depend on measurements.
    model
        Hash of the closed loop, `Diagram.fingerprint`: that of a run and of a verification of the same model.
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
    unmeasured: tuple[str, ...]
    model: str


def program_of(graph: BaseGraph) -> Program:
    """Controller of a graph.

    Raises
    ------
    EngineError
        The graph runs in continuous time, has no command, or uses random numbers.
    OutputError
        The name has no letter or digit.
    """
    diagram = graph.diagram
    loop, clock = diagram.loop, graph.file.clock
    if not isinstance(clock, float):
        raise EngineError(f"{graph.name}: expected a clock such as 8 ms, found continuous; an exported law is sampled")
    if not loop.commanded:
        raise EngineError("export: expected a graph with a command, found no wire to a plant")
    control = control_function(diagram)
    start, unmeasured = start_function(diagram, graph.start)
    inputs = [ca.SX.sym(word, control.numel_in(k)) for k, word in enumerate(("z", "measured", "t", "T"))]
    results = control(*inputs, loop.p)
    initial = start(*inputs[1:], loop.p)
    follow, own_path = control_function(diagram, path=True), path_function(diagram)
    path = ca.SX.sym("path", follow.numel_in(5))
    used = symbols_in([*results, initial])
    kept = [parameter for parameter in loop.parameters if used & symbols_in([parameter.symbol])]
    sides = {label: block.side for label, block in diagram.blocks.items()}
    for parameter in kept:
        if sides.get(parameter.label.split(".")[0]) is Side.PLANT:  # the diagram excludes this
            raise EngineError(f"export: the controller reads {parameter.label}, a number of the plant")
    p = stack(parameter.symbol for parameter in kept)
    units = {signal.label: signal.unit for signal in loop.outputs}
    return Program(
        name=own_name(graph.name),
        title=graph.file.title or "",
        period=clock,
        measured=members((leaf.name, leaf.symbol, units[leaf.name]) for leaf in loop.measured),
        commanded=members((leaf.name, leaf.symbol, units[leaf.name]) for leaf in loop.commanded),
        states=members((variable.label, variable.symbol, variable.unit) for variable in loop.controller),
        parameters=members((item.label, item.symbol, item.unit, item.value.ravel(order="F").tolist()) for item in kept),
        path=members((leaf.name, leaf.symbol, _path_unit(leaf.name, units)) for leaf in path_leaves(diagram)),
        control=ca.Function("control", [*inputs, p], list(results)),
        follow=ca.Function("follow", [*inputs, p, path], list(follow(*inputs, loop.p, path))),
        own_path=ca.Function("own_path", [*inputs[2:], p], [own_path(*inputs[2:], loop.p)]),
        start=ca.Function("start", [*inputs[1:], p], [initial]),
        tool=None if diagram.robot is None else tool_position(diagram.robot),
        unmeasured=unmeasured,
        model=diagram.fingerprint,
    )


def _path_unit(name: str, units: Mapping[str, str]) -> str:
    """Unit of a trajectory, or of its rate, ``path.ddx_d``, which is not an output."""
    label, _, _ = name.partition("(")
    block, _, port = label.rpartition(".")
    for order in range(len(port)):
        if (unit := units.get(f"{block}.{port[order:]}")) is not None and port[:order] == "d" * order:
            below = "s" if order == 1 else f"s^{order}"
            return unit if order == 0 else f"{unit or 1}/{below}"
    return ""


def members(items: Iterable[Sequence[Any]]) -> tuple[Member, ...]:
    """Members from labels, symbols, units and, for parameters, values; with unique words, none of which is a macro."""
    found = list(items)
    words = made_distinct([_with_small(identifier(item[0])) for item in found], "{}_{}".format)
    return tuple(
        Member(item[0], word, item[1].numel(), item[2], tuple(item[3]) if len(item) > 3 else ())
        for item, word in zip(found, words, strict=True)
    )


def _with_small(word: str) -> str:
    """A word that is no macro such as ``M_PI``; a word without small letters gets one."""
    return word if any(letter.islower() for letter in word) else f"{word}_x"


def own_name(name: str) -> str:
    """Name of functions, files and targets for a graph's name: ``replay`` becomes ``replay_controller``."""
    word = identifier(name)
    return f"{word}_controller" if word.casefold() in _FILES else word


def _in_ascii(name: str) -> str:
    """Letters without accents, with some digits of the name's hash, so that different names stay different."""
    if name.isascii():
        return name
    plain = "".join(letter for letter in unicodedata.normalize("NFKD", name) if letter.isascii())
    return f"{plain or 'name'}_{hashlib.sha256(name.encode()).hexdigest()[:6]}"


def identifier(name: str) -> str:
    """A name as a C identifier: ``arm.q`` becomes ``arm_q``."""
    word = re.sub(r"[^0-9A-Za-z]+", "_", _in_ascii(name)).strip("_")
    if not word:
        raise OutputError(f"{name!r}: expected a name with a letter or digit, for the name of a C function")
    return f"_{word}"[word[0].isalpha() :] + "_" * (word in _WORDS or keyword.iskeyword(word))
