"""WebAssembly in its binary form: expressions, functions made of them, and a module of functions.

An expression is a sequence of pieces: instructions as bytes, a number for the local that is read, a name for the
function that is called. What a name stands for is decided when the module is put together: functions that nothing calls
stay out, and a name ``env.exp`` is the host's ``exp``.

Of what came after WebAssembly 1.0 it takes functions with several results and the copying of memory.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import groupby
from typing import Final, final

from dmframe.errors import EngineError

Piece = bytes | str | int

I32, F64 = b"\x7f", b"\x7c"
IF, END, RETURN, DROP, AND = b"\x04\x40", b"\x0b", b"\x0f", b"\x1a", b"\x71"
COPY: Final = b"\xfc\x0a\x00\x00"
"""Copies bytes: to an address, from an address, so many."""

PAGE: Final = 65536
"""Bytes by which memory grows."""

MOST_LOCALS: Final = 50_000
MOST_BYTES: Final = 7_654_321
"""Of one function: browsers refuse more."""


def unsigned(value: int) -> bytes:
    """A whole number from 0 on, in LEB128."""
    found = bytearray()
    while value > 0x7F:
        found.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes((*found, value))


def signed(value: int) -> bytes:
    """A whole number in LEB128; bit 6 of the last byte is its sign."""
    found = bytearray()
    while not -0x40 <= value < 0x40:
        found.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes((*found, value & 0x7F))


@final
@dataclass(frozen=True)
class Whole:
    """An i32: a count, an address, a truth value."""

    parts: tuple[Piece, ...]

    def __add__(self, other: Whole | int) -> Whole:
        return self._with(other, b"\x6a")

    def __sub__(self, other: Whole | int) -> Whole:
        return self._with(other, b"\x6b")

    def __mul__(self, other: Whole | int) -> Whole:
        return self._with(other, b"\x6c")

    def __mod__(self, other: Whole | int) -> Whole:
        return self._with(other, b"\x70")

    def __and__(self, other: Whole | int) -> Whole:
        return self._with(other, b"\x71")

    def __or__(self, other: Whole | int) -> Whole:
        return self._with(other, b"\x72")

    def __lt__(self, other: Whole | int) -> Whole:
        return self._with(other, b"\x49")

    def __ge__(self, other: Whole | int) -> Whole:
        return self._with(other, b"\x4f")

    def empty(self) -> Whole:
        """1 for 0, 0 for others."""
        return Whole((*self.parts, b"\x45"))

    def number(self) -> Number:
        """The same as an f64; it is taken as signed."""
        return Number((*self.parts, b"\xb7"))

    def choose(self, one: Number, other: Number) -> Number:
        """`one` where this is not 0; both are computed."""
        return Number((*one.parts, *other.parts, *self.parts, b"\x1b"))

    def load(self, offset: int = 0) -> Number:
        """The f64 that lies there."""
        return Number((*self.parts, b"\x2b\x03" + unsigned(offset)))

    def load_whole(self) -> Whole:
        """The i32 that lies there."""
        return Whole((*self.parts, b"\x28\x02\x00"))

    def _with(self, other: Whole | int, operation: bytes) -> Whole:
        return Whole((*self.parts, *(whole(other) if isinstance(other, int) else other).parts, operation))


@final
@dataclass(frozen=True)
class Number:
    """An f64."""

    parts: tuple[Piece, ...]

    def __add__(self, other: Number | float) -> Number:
        return self._with(other, b"\xa0")

    def __radd__(self, other: float) -> Number:
        return number(other) + self

    def __sub__(self, other: Number | float) -> Number:
        return self._with(other, b"\xa1")

    def __rsub__(self, other: float) -> Number:
        return number(other) - self

    def __mul__(self, other: Number | float) -> Number:
        return self._with(other, b"\xa2")

    def __rmul__(self, other: float) -> Number:
        return number(other) * self

    def __truediv__(self, other: Number | float) -> Number:
        return self._with(other, b"\xa3")

    def __rtruediv__(self, other: float) -> Number:
        return number(other) / self

    def copysign(self, other: Number) -> Number:
        """The sign of the other."""
        return self._with(other, b"\xa6")

    def __neg__(self) -> Number:
        return self._then(b"\x9a")

    def __abs__(self) -> Number:
        return self._then(b"\x99")

    def __ceil__(self) -> Number:
        return self._then(b"\x9b")

    def __floor__(self) -> Number:
        return self._then(b"\x9c")

    def sqrt(self) -> Number:
        """The square root."""
        return self._then(b"\x9f")

    def __lt__(self, other: Number | float) -> Whole:
        return Whole(self._with(other, b"\x63").parts)

    def __gt__(self, other: Number | float) -> Whole:
        return Whole(self._with(other, b"\x64").parts)

    def __le__(self, other: Number | float) -> Whole:
        return Whole(self._with(other, b"\x65").parts)

    def equals(self, other: Number | float) -> Whole:
        """1 where they are equal; two that are no numbers are not."""
        return Whole(self._with(other, b"\x61").parts)

    def differs(self, other: Number | float) -> Whole:
        """1 where they are not equal."""
        return Whole(self._with(other, b"\x62").parts)

    def low_bits(self) -> Whole:
        """The last 32 bits of the 64."""
        return Whole(self._then(b"\xbd\xa7").parts)

    def power_of_two(self) -> Number:
        """2^n, of a sum n + 1.5 * 2^52, whose last bits are those of n."""
        return self._then(b"\xbd\x42" + signed(1023) + b"\x7c\x42" + signed(52) + b"\x86\xbf")

    def _then(self, operation: bytes) -> Number:
        return Number((*self.parts, operation))

    def _with(self, other: Number | float, operation: bytes) -> Number:
        return Number((*self.parts, *(other if isinstance(other, Number) else number(other)).parts, operation))


def whole(value: int) -> Whole:
    """A constant."""
    return Whole((b"\x41" + signed(value),))


def number(value: float) -> Number:
    """A constant, with all its bits."""
    return Number((b"\x44" + struct.pack("<d", value),))


def called(name: str, *operands: Number) -> Number:
    """What a function of numbers returns."""
    return Number((*(piece for operand in operands for piece in operand.parts), name))


@final
class Function:
    """A function; what it takes is in its first locals."""

    def __init__(self, takes: Sequence[bytes], gives: Sequence[bytes] = ()) -> None:
        self.takes, self.gives = tuple(takes), tuple(gives)
        self._kinds, self._pieces = list(takes), list[Piece]()

    @property
    def calls(self) -> set[str]:
        """The names of what it calls."""
        return {piece for piece in self._pieces if isinstance(piece, str)}

    def write(self, *pieces: Piece | Whole | Number) -> None:
        """Append instructions."""
        for piece in pieces:
            self._pieces.extend(piece.parts if isinstance(piece, Whole | Number) else (piece,))

    def local(self, kind: bytes) -> int:
        """A new one."""
        self._kinds.append(kind)
        return len(self._kinds) - 1

    def set(self, local: int, *value: Whole | Number) -> None:
        """Of `value`, or of what lies on the stack."""
        self.write(*value, b"\x21" + unsigned(local))

    def keep(self, value: Number) -> Number:
        """The same number, computed here once."""
        local = self.local(F64)
        self.set(local, value)
        return Number((local,))

    def store(self, address: Whole, offset: int, value: Number) -> None:
        """Write a number to memory."""
        self.write(address, value, b"\x39\x03" + unsigned(offset))

    @contextmanager
    def when(self, truth: Whole) -> Iterator[None]:
        """What is written meanwhile is done where `truth` is not 0."""
        self.write(truth, IF)
        yield
        self.write(END)

    @contextmanager
    def counted(self, end: Whole) -> Iterator[Whole]:
        """What is written meanwhile is done for each count from 0 to `end` - 1."""
        count = self.local(I32)
        self.set(count, whole(0))
        self.write(b"\x02\x40\x03\x40", Whole((count,)) >= end, b"\x0d\x01")
        yield Whole((count,))
        self.set(count, Whole((count,)) + 1)
        self.write(b"\x0c\x00", END, END)

    def encoded(self, name: str, places: Mapping[str, int]) -> bytes:
        """Its entry in the code section. Raises `EngineError` for one that is larger than browsers take."""
        runs = [(kind, len(list(run))) for kind, run in groupby(self._kinds[len(self.takes) :])]
        pieces = [_encoded(piece, places) for piece in self._pieces]
        body = b"".join([_vector([unsigned(count) + kind for kind, count in runs]), *pieces, END])
        for what, found, most in (("locals", len(self._kinds), MOST_LOCALS), ("bytes", len(body), MOST_BYTES)):
            if found > most:
                raise EngineError(f"WebAssembly: {name} takes {found} {what}, expected at most {most} in one function")
        return unsigned(len(body)) + body


def _encoded(piece: Piece, places: Mapping[str, int]) -> bytes:
    if isinstance(piece, bytes):
        return piece
    return b"\x20" + unsigned(piece) if isinstance(piece, int) else b"\x10" + unsigned(places[piece])


def module(functions: Mapping[str, Function], exported: Sequence[str], arities: Mapping[str, int], used: int) -> bytes:
    """A module that exports functions, its memory, and as ``heap`` how many bytes of that it uses itself.

    `arities` says how many numbers each function of the host takes; those that are called are imported from ``env``.
    """
    reached, waiting = set[str](), [*exported]
    while waiting:
        name = waiting.pop()
        if name not in reached:
            reached.add(name)
            waiting += functions[name].calls if name in functions else ()
    hosts = sorted(reached - functions.keys())
    own = {name: function for name, function in functions.items() if name in reached}
    signatures: dict[str, tuple[tuple[bytes, ...], tuple[bytes, ...]]] = {
        name: ((F64,) * arities[name], (F64,)) for name in hosts
    }
    signatures |= {name: (function.takes, function.gives) for name, function in own.items()}
    places = {name: place for place, name in enumerate(signatures)}
    types = list(dict.fromkeys(signatures.values()))
    kind = {name: unsigned(types.index(signature)) for name, signature in signatures.items()}
    exports = [_text("memory") + b"\x02\x00", _text("heap") + b"\x03\x00"]
    exports += [_text(name) + b"\x00" + unsigned(places[name]) for name in exported]
    sections = {
        1: [b"\x60" + _vector(takes) + _vector(gives) for takes, gives in types],
        2: [b"".join(map(_text, name.split("."))) + b"\x00" + kind[name] for name in hosts],
        3: [kind[name] for name in own],
        5: [b"\x00" + unsigned(-(-used // PAGE))],
        6: [I32 + b"\x00\x41" + signed(used) + END],
        7: exports,
        10: [function.encoded(name, places) for name, function in own.items()],
    }
    parts = [bytes((place,)) + _text(_vector(items)) for place, items in sections.items()]
    return b"".join([b"\0asm\1\0\0\0", *parts])


def _vector(items: Sequence[bytes]) -> bytes:
    return unsigned(len(items)) + b"".join(items)


def _text(text: str | bytes) -> bytes:
    """A name, or a section's content: after its length."""
    content = text.encode() if isinstance(text, str) else text
    return unsigned(len(content)) + content
