"""The closed loop as a WebAssembly module, generated from its expressions without a compiler.

It has the operations of `loop_source` in the same order, so that its numbers equal those of the C bit by bit, if the
compiler does not use fused multiply-add (``-ffp-contract=off``). A module exports

- ``run(state, p, period, substeps, first, ticks, given, every, kept, columns, log, bounds)``: ``dm_run`` of `loop.c`,
  which returns the number of ticks that ended within bounds. ``period`` is an f64; the others are i32: counts, and the
  addresses of arrays in bytes. Arrays are of f64, except ``kept``, which is of i32. Counts are from 0 to 2^31 - 1; only
  the remainder of ``first`` by ``every`` is used.
- ``flow(state, t, T, p, rates)``, all addresses: the derivatives of the continuous states, with the commands of that
  instant.
- additional functions, each with the addresses of its arguments and then of its results, all of f64.
- ``memory``, and ``heap``: the bytes up to that address are reserved for the module. The host places its arrays after
  them without overlap, and grows the memory as needed.

The module keeps no state between calls.

Sine, cosine, tanh, sign, fmin and fmax are those of `arithmetic.h`; sqrt, fabs, floor, ceil and copysign are single
instructions. Other functions, which no packaged graph needs, are imported from the host by their C names, as
``env.exp``; so are ``env.sin`` and ``env.cos``, for angles from 1e5 rad on. Their accuracy is that of the host. A web
page provides its ``Math``, which has all of them except erf, fmod and remainder.
"""

from __future__ import annotations

import math
import operator
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import count
from typing import Any, Final, NamedTuple, final

from dmframe.codegen.wasm_arithmetic import ARITHMETIC
from dmframe.codegen.wasm_binary import (
    AND,
    COPY,
    DROP,
    F64,
    I32,
    RETURN,
    Function,
    Number,
    Whole,
    called,
    module,
    number,
    whole,
)
from dmframe.common.errors import EngineError
from dmframe.diagram.parts import Parts
from dmframe.program import CONST, Node, by_code, read, run

_HOST_ONE: Final = "exp log tan asin acos atan erf sinh cosh asinh acosh atanh log1p expm1"
_HOST_TWO: Final = "pow fmod atan2 hypot remainder"
HOST: Final = {f"env.{name}": 1 for name in ("sin", "cos", *_HOST_ONE.split())} | {
    f"env.{name}": 2 for name in _HOST_TWO.split()
}
"""Functions that a module may import from the host, with their numbers of arguments."""

ENTRY: Final = tuple("state p period substeps first ticks given every kept columns log bounds".split())
"""Parameters of ``run``, in order."""


@final
class Turn(NamedTuple):
    """Sine (0) or cosine (1) of an angle; one call computes both."""

    angle: Number
    which: int


Value = Number | Turn

RULES: Final[dict[int, Callable[..., Any]]] = by_code(
    {
        **{name: partial(called, f"env.{name}") for name in (*_HOST_ONE.split(), *_HOST_TWO.split())},
        **{name: partial(called, name) for name in ("tanh", "sign", "fmin", "fmax")},
        "add": operator.add,
        "sub": operator.sub,
        "mul": operator.mul,
        "div": operator.truediv,
        "neg": operator.neg,
        "sq": lambda x: x * x,
        "twice": lambda x: x + x,
        "inv": lambda x: 1 / x,
        "constpow": partial(called, "env.pow"),
        "sqrt": Number.sqrt,
        "fabs": abs,
        "floor": math.floor,
        "ceil": math.ceil,
        "copysign": Number.copysign,
        "lt": lambda x, y: (x < y).number(),
        "le": lambda x, y: (x <= y).number(),
        "eq": lambda x, y: x.equals(y).number(),
        "ne": lambda x, y: x.differs(y).number(),
        "and": lambda x, y: (x.differs(0) & y.differs(0)).number(),
        "or": lambda x, y: (x.differs(0) | y.differs(0)).number(),
        "not": lambda x: x.equals(0).number(),
        "if_else_zero": lambda x, y: x.differs(0).choose(y, number(0)),
        "sin": lambda x: Turn(x, 0),
        "cos": lambda x: Turn(x, 1),
    }
)


def loop_module(parts: Parts, more: Sequence[Any] = ()) -> bytes:
    """Module of a whole run, with gains, true parameters and initial states as arguments.

    `more` are SX functions that it exports additionally, by their names.

    Raises `EngineError` for an operation without a rule, or a function that is too long for a browser.
    """
    hoisted = parts.hoisted
    own = {f.name(): written(f) for f in hoisted}
    sizes = {**parts.sizes, "C": hoisted.constants.numel_out(0)}
    places, used = dict[str, Whole](), 0
    columns = {"T": 1, "t": 1, "at": sizes["X"], **{f"k{k}": sizes["X"] for k in range(1, 5)}}
    columns |= {name.lower(): sizes[name] for name in "ZUWYCN"}
    for name, size in columns.items():
        places[name], used = whole(used), used + 8 * size
    frame = {
        "slope": _slope(places, parts.moved),
        "integrate": _integrate(places, sizes["X"]),
        "within_bounds": _within_bounds(sizes["Z"] + sizes["X"]),
        "record": _record(places, sizes["Z"] + sizes["X"]),
        "run": _run(places, sizes),
        "flow": _flow(places, sizes),
    }
    extra = {f.name(): written(f) for f in more}
    return module({**ARITHMETIC, **own, **frame, **extra}, ("run", "flow", *extra), HOST, used)


def written(f: Any) -> Function:
    """An SX function with the addresses of its arguments and then of its results, none of which may overlap.

    A value that is read once is computed where it is read. Another has a local, which is reused after its last read.
    """
    program = read(f)
    refuse = partial(_refused, program.name)
    reads, firsts = Counter[int](), dict[tuple[int, int], int]()
    places = count()

    def counted(node: Node, value: Value) -> Number:
        """Number of the value, as if it were a local."""
        place = next(places)
        if isinstance(value, Turn):
            if not {(node.a, 0), (node.a, 1)} & firsts.keys():
                reads[node.a] += 1
            return Number((firsts.setdefault((node.a, value.which), place),))
        reads.update(_locals(value))
        return Number((place,))

    nowhere = number(0)
    values = run(program, RULES, given=lambda *_: nowhere, constant=number, refuse=refuse, keep=counted)
    reads.update(place for output in program.stored(values) for value in output for place in _locals(value))
    function = Function([I32] * (f.n_in() + f.n_out()))
    straight = _Straight(function, reads, firsts)
    values = run(
        program,
        RULES,
        given=lambda argument, element: Whole((argument,)).load(8 * element),
        constant=number,
        refuse=refuse,
        keep=straight.kept,
    )
    for j, output in enumerate(program.stored(values)):
        for k, value in enumerate(output):
            function.store(Whole((f.n_in() + j,)), 8 * k, value)
            straight.release(value)
    return function


def _locals(value: Number) -> list[int]:
    return [piece for piece in value.parts if isinstance(piece, int)]


def _refused(name: str, code: int) -> EngineError:
    return EngineError(f"engine: {name} has CasADi's instruction {code}, which cannot be translated to WebAssembly")


@final
class _Straight:
    """Straight-line code; `reads` counts the reads of each value."""

    def __init__(self, function: Function, reads: Counter[int], firsts: Mapping[tuple[int, int], int]) -> None:
        self._function, self._reads, self._firsts = function, reads, firsts
        self._places = count()
        self._turns = dict[tuple[int, int], Number]()
        self._left, self._free = dict[int, int](), list[int]()

    def kept(self, node: Node, value: Value) -> Number:
        """Expression for a value from then on."""
        reads = self._reads[next(self._places)]
        if isinstance(value, Turn):
            if (node.a, value.which) not in self._turns:
                self._turn(node.a, value.angle)
            return self._turns[node.a, value.which]
        if reads < 2 or node.code == CONST:
            return value
        self._function.write(value)
        self.release(value)
        return self._settled(reads)

    def release(self, value: Number) -> None:
        """Count a read of the value's locals."""
        for local in _locals(value):
            if local in self._left:  # not an address
                self._left[local] -= 1
                if self._left[local] == 0:
                    self._free.append(local)

    def _turn(self, place: int, angle: Number) -> None:
        self._function.write(angle, "sincos")
        self.release(angle)
        for which in (1, 0):  # the cosine is on top of the stack
            if (place, which) in self._firsts:
                self._turns[place, which] = self._settled(self._reads[self._firsts[place, which]])
            else:
                self._function.write(DROP)

    def _settled(self, reads: int) -> Number:
        """Move the top of the stack to a local, until its last read."""
        local = self._free.pop() if self._free else self._function.local(F64)
        self._function.set(local)
        self._left[local] = reads
        return Number((local,))


def _integer(place: int) -> Whole:
    return Whole((place,))


def _slope(at: Mapping[str, Whole], moved: bool) -> Function:
    """(t, x, p, dx): dx at time t, with constant commands."""
    f = Function([F64, I32, I32, I32])
    t, (x, p, dx) = Number((0,)), map(_integer, (1, 2, 3))
    if moved:
        f.store(at["t"], 0, t)
        f.write(at["t"], p, at["c"], at["w"], "trajectory")
    f.write(x, at["u"], at["w"], p, at["c"], dx, "rate")
    return f


def _flow(at: Mapping[str, Whole], sizes: Mapping[str, int]) -> Function:
    """Exported function: derivatives at the first step of a tick, without random numbers."""
    f = Function([I32] * 5)
    state, t, period, p, rates = map(_integer, range(5))
    f.write(p, at["c"], "constants")
    f.write(t, p, at["c"], at["w"], "trajectory")
    f.write(state, at["w"], at["n"], period, p, at["c"], at["z"], at["u"], at["y"], "sample")
    f.write(state + 8 * sizes["Z"], at["u"], at["w"], p, at["c"], rates, "rate")
    return f


def _integrate(at: Mapping[str, Whole], size: int) -> Function:
    """(t, h, x, substeps, p): x from t to t + T by classical Runge-Kutta, in the order of `loop.c`."""
    f = Function([F64, F64, I32, I32, I32])
    (t, h), (x, substeps, p) = (Number((k,)) for k in (0, 1)), map(_integer, (2, 3, 4))
    half, sixth = f.keep(h / 2), f.keep(h / 6)
    with f.counted(substeps) as j:
        now = f.keep(t + j.number() * h)
        f.write(now, x, p, at["k1"], "slope")
        for step, time, before, after in (
            (half, now + half, "k1", "k2"),
            (half, now + half, "k2", "k3"),
            (h, now + h, "k3", "k4"),
        ):
            for i in range(0, 8 * size, 8):
                f.store(at["at"], i, x.load(i) + step * at[before].load(i))
            f.write(time, at["at"], p, at[after], "slope")
        for i in range(0, 8 * size, 8):
            k1, k2, k3, k4 = (at[f"k{k}"].load(i) for k in range(1, 5))
            f.store(x, i, x.load(i) + sixth * (k1 + 2 * k2 + 2 * k3 + k4))
    return f


def _within_bounds(size: int) -> Function:
    """(state, bounds): 1 if all states are within their bounds; 0 for NaN."""
    f = Function([I32, I32], [I32])
    state, bounds = map(_integer, (0, 1))
    f.write(whole(1))
    for i in range(0, 8 * size, 8):
        f.write(abs(state.load(i)) <= bounds.load(i), AND)
    return f


def _record(at: Mapping[str, Whole], size: int) -> Function:
    """(state, kept, columns, row): write the kept numbers of (state, outputs)."""
    f = Function([I32] * 4)
    state, kept, columns, row = map(_integer, range(4))
    place = f.local(I32)
    which = _integer(place)
    with f.counted(columns) as j:
        f.set(place, (kept + j * 4).load_whole())
        with f.when(which < size):
            f.store(row + j * 8, 0, (state + which * 8).load())
        with f.when(which >= size):
            f.store(row + j * 8, 0, (at["y"] + (which - size) * 8).load())
    return f


def _run(at: Mapping[str, Whole], sizes: Mapping[str, int]) -> Function:
    """Exported function with the parameters `ENTRY`."""
    f = Function([F64 if name == "period" else I32 for name in ENTRY], [I32])
    local = {name: place for place, name in enumerate(ENTRY)}
    state, p, _, substeps, first, ticks, given, every, kept, columns, log, bounds = map(_integer, range(len(ENTRY)))
    x = state + 8 * sizes["Z"]

    def sampled() -> None:
        f.write(given, p, at["c"], at["w"], "trajectory")
        f.write(state, at["w"], given + 16, at["T"], p, at["c"], at["z"], at["u"], at["y"], "sample")

    f.store(at["T"], 0, Number((local["period"],)))
    f.write(p, at["c"], "constants")
    with f.when(ticks.empty()):
        sampled()
        f.write(state, kept, columns, log, "record")
    with f.counted(ticks) as n:
        sampled()
        with f.when(((first + n) % every).empty()):
            f.write(state, kept, columns, log, "record")
            f.set(local["log"], log + columns * 8)
        f.write(state, at["z"], whole(8 * sizes["Z"]), COPY)
        f.write(given.load(), given.load(8) / substeps.number(), x, substeps, p, "integrate")
        f.write(x, p, at["c"], at["at"], "clip")
        f.write(x, at["at"], whole(8 * sizes["X"]), COPY)
        f.set(local["given"], given + 8 * (2 + sizes["N"]))
        with f.when(Whole((*state.parts, *bounds.parts, "within_bounds")).empty()):
            f.write(n, RETURN)
    f.write(ticks)
    return f
