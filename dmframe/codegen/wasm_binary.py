"""Encoder of binary WebAssembly: expressions, functions and modules.

An expression is a sequence of pieces: instructions (bytes), locals to read (numbers), functions to call (names). Names
are resolved when the module is assembled: uncalled functions are omitted, and ``env.exp`` is imported from the host.

Beyond WebAssembly 1.0 it uses functions with several results, and memory copy.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import groupby
from typing import Final, final

from dmframe.common.errors import EngineError

Piece = bytes | str | int

I32, F64 = b"\x7f", b"\x7c"
IF, END, RETURN, DROP, AND = b"\x04\x40", b"\x0b", b"\x0f", b"\x1a", b"\x71"
COPY: Final = b"\xfc\x0a\x00\x00"
"""Memory copy: destination, source, count of bytes."""

PAGE: Final = 65536
"""Page size of the memory [bytes]."""

MOST_LOCALS: Final = 50_000
MOST_BYTES: Final = 7_654_321
"""Limits of browsers for one function."""


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


def _whole(operation: bytes) -> Callable[[Whole, Whole | int], Whole]:
    """Binary instruction of two i32."""

    def method(self: Whole, other: Whole | int) -> Whole:
        return Whole((*self.parts, *(whole(other) if isinstance(other, int) else other).parts, operation))

    return method


def _unary(operation: bytes) -> Callable[[Number], Number]:
    """Instruction of one f64."""
    return lambda self: Number((*self.parts, operation))


def _binary(operation: bytes) -> Callable[[Number, Number | float], Number]:
    """Instruction of two f64."""

    def method(self: Number, other: Number | float) -> Number:
        return Number((*self.parts, *(other if isinstance(other, Number) else number(other)).parts, operation))

    return method


def _reflected(operation: bytes) -> Callable[[Number, float], Number]:
    """Binary instruction with a constant on the left."""
    return lambda self, other: Number((*number(other).parts, *self.parts, operation))


def _comparison(operation: bytes) -> Callable[[Number, Number | float], Whole]:
    """Comparison of two f64, with the result 1 or 0."""
    compare = _binary(operation)
    return lambda self, other: Whole(compare(self, other).parts)


@final
@dataclass(frozen=True)
class Whole:
    """An i32: a count, an address, a truth value."""

    parts: tuple[Piece, ...]

    __add__ = _whole(b"\x6a")
    __sub__ = _whole(b"\x6b")
    __mul__ = _whole(b"\x6c")
    __mod__ = _whole(b"\x70")
    __and__ = _whole(b"\x71")
    __or__ = _whole(b"\x72")
    __lt__ = _whole(b"\x49")
    __ge__ = _whole(b"\x4f")

    def empty(self) -> Whole:
        """1 if it is 0, else 0."""
        return Whole((*self.parts, b"\x45"))

    def number(self) -> Number:
        """Conversion to f64, as signed."""
        return Number((*self.parts, b"\xb7"))

    def choose(self, one: Number, other: Number) -> Number:
        """`one` if it is not 0, else `other`; both are computed."""
        return Number((*one.parts, *other.parts, *self.parts, b"\x1b"))

    def load(self, offset: int = 0) -> Number:
        """The f64 at this address."""
        return Number((*self.parts, b"\x2b\x03" + unsigned(offset)))

    def load_whole(self) -> Whole:
        """The i32 at this address."""
        return Whole((*self.parts, b"\x28\x02\x00"))


@final
@dataclass(frozen=True)
class Number:
    """An f64; comparisons with NaN are 0, except `differs`."""

    parts: tuple[Piece, ...]

    __add__ = _binary(b"\xa0")
    __sub__ = _binary(b"\xa1")
    __mul__ = _binary(b"\xa2")
    __truediv__ = _binary(b"\xa3")
    __radd__ = _reflected(b"\xa0")
    __rsub__ = _reflected(b"\xa1")
    __rmul__ = _reflected(b"\xa2")
    __rtruediv__ = _reflected(b"\xa3")
    copysign = _binary(b"\xa6")
    __neg__ = _unary(b"\x9a")
    __abs__ = _unary(b"\x99")
    __ceil__ = _unary(b"\x9b")
    __floor__ = _unary(b"\x9c")
    sqrt = _unary(b"\x9f")
    __lt__ = _comparison(b"\x63")
    __gt__ = _comparison(b"\x64")
    __le__ = _comparison(b"\x65")
    equals = _comparison(b"\x61")
    differs = _comparison(b"\x62")

    def low_bits(self) -> Whole:
        """Low 32 bits."""
        return Whole((*self.parts, b"\xbd\xa7"))

    def power_of_two(self) -> Number:
        """2^n from n + 1.5 * 2^52, whose last bits are those of n."""
        return Number((*self.parts, b"\xbd\x42" + signed(1023) + b"\x7c\x42" + signed(52) + b"\x86\xbf"))


def whole(value: int) -> Whole:
    """A constant."""
    return Whole((b"\x41" + signed(value),))


def number(value: float) -> Number:
    """An exact constant."""
    return Number((b"\x44" + struct.pack("<d", value),))


def called(name: str, *operands: Number) -> Number:
    """Call of a function of numbers."""
    return Number((*(piece for operand in operands for piece in operand.parts), name))


@final
class Function:
    """A function, whose parameters are its first locals."""

    def __init__(self, takes: Sequence[bytes], gives: Sequence[bytes] = ()) -> None:
        self.takes, self.gives = tuple(takes), tuple(gives)
        self._kinds, self._pieces = list(takes), list[Piece]()

    @property
    def calls(self) -> set[str]:
        """Names of the functions that it calls."""
        return {piece for piece in self._pieces if isinstance(piece, str)}

    def write(self, *pieces: Piece | Whole | Number) -> None:
        """Append instructions."""
        for piece in pieces:
            self._pieces.extend(piece.parts if isinstance(piece, Whole | Number) else (piece,))

    def local(self, kind: bytes) -> int:
        """Add a local, and return its index."""
        self._kinds.append(kind)
        return len(self._kinds) - 1

    def set(self, local: int, *value: Whole | Number) -> None:
        """Set a local to `value`, or to the top of the stack."""
        self.write(*value, b"\x21" + unsigned(local))

    def keep(self, value: Number) -> Number:
        """Compute a number once, and store it in a local."""
        local = self.local(F64)
        self.set(local, value)
        return Number((local,))

    def store(self, address: Whole, offset: int, value: Number) -> None:
        """Write a number to memory."""
        self.write(address, value, b"\x39\x03" + unsigned(offset))

    @contextmanager
    def when(self, truth: Whole) -> Iterator[None]:
        """Execute the instructions of the ``with`` block if `truth` is not 0."""
        self.write(truth, IF)
        yield
        self.write(END)

    @contextmanager
    def counted(self, end: Whole) -> Iterator[Whole]:
        """Execute the instructions of the ``with`` block for each count from 0 to `end` - 1."""
        count = self.local(I32)
        self.set(count, whole(0))
        self.write(b"\x02\x40\x03\x40", Whole((count,)) >= end, b"\x0d\x01")
        yield Whole((count,))
        self.set(count, Whole((count,)) + 1)
        self.write(b"\x0c\x00", END, END)

    def encoded(self, name: str, places: Mapping[str, int]) -> bytes:
        """Entry of the code section. Raises `EngineError` if it exceeds the limits of browsers."""
        runs = [(kind, len(list(run))) for kind, run in groupby(self._kinds[len(self.takes) :])]
        pieces = [_encoded(piece, places) for piece in self._pieces]
        body = b"".join([_vector([unsigned(count) + kind for kind, count in runs]), *pieces, END])
        for what, found, most in (("locals", len(self._kinds), MOST_LOCALS), ("bytes", len(body), MOST_BYTES)):
            if found > most:
                raise EngineError(f"WebAssembly: {name} has {found} {what}, expected at most {most} in one function")
        return unsigned(len(body)) + body


def _encoded(piece: Piece, places: Mapping[str, int]) -> bytes:
    if isinstance(piece, bytes):
        return piece
    return b"\x20" + unsigned(piece) if isinstance(piece, int) else b"\x10" + unsigned(places[piece])


def module(functions: Mapping[str, Function], exported: Sequence[str], arities: Mapping[str, int], used: int) -> bytes:
    """A module that exports functions, its memory, and ``heap``, the number of bytes that it reserves.

    `arities` has the numbers of arguments of the host's functions; those that are called are imported from ``env``.
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
    """A name, or a section's content, preceded by its length."""
    content = text.encode() if isinstance(text, str) else text
    return unsigned(len(content)) + content
