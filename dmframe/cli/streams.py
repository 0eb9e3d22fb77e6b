"""Standard streams: what cannot be encoded is escaped, and each may be closed, full or gone."""

from __future__ import annotations

import io
import os
import sys
from contextlib import suppress
from typing import TextIO, final


class OutputGone(Exception):
    """Standard output takes no more: no `OSError`, for libraries end the program at those, each in its way."""

    def __init__(self, why: OSError) -> None:
        super().__init__(str(why))
        self.why = why


@final
class _Output(io.TextIOWrapper):
    def write(self, text: str, /) -> int:
        try:
            return super().write(text)
        except OSError as error:
            raise OutputGone(error) from None

    def flush(self) -> None:
        try:
            super().flush()
        except OSError as error:
            raise OutputGone(error) from None


@final
class _Errors(io.TextIOWrapper):
    """What cannot be told is dropped: a run is not lost because its terminal has gone."""

    def write(self, text: str, /) -> int:
        with suppress(OSError):
            return super().write(text)
        return len(text)

    def flush(self) -> None:
        with suppress(OSError):
            super().flush()


def prepare() -> None:
    """Make the streams usable. To be called before anything is opened or printed."""
    for number in (0, 1, 2):
        try:
            os.fstat(number)
        except OSError:  # closed, as by >&-: the next file that is opened would take its place
            os.open(os.devnull, os.O_RDWR)
    sys.stdout = _wrapped(sys.stdout, _Output)
    sys.stderr = _wrapped(sys.stderr, _Errors)


def _wrapped(stream: TextIO | None, kind: type[io.TextIOWrapper]) -> TextIO:
    if stream is None:
        return open(os.devnull, "w", encoding="utf-8")  # noqa: PTH123 - it stays open as long as we run
    if type(stream) is not io.TextIOWrapper:  # a host's own, as in tests
        return stream
    return kind(
        stream.buffer,
        stream.encoding,
        "backslashreplace",  # some letters have no code in the terminal's alphabet, some bytes of names no letter
        line_buffering=stream.line_buffering,
        write_through=stream.write_through,
    )


def tell(text: str, *, aside: bool = False) -> None:
    """Print to standard output at once; to standard error where it is said aside."""
    stream = sys.stderr if aside else sys.stdout
    stream.write(text + "\n")
    stream.flush()


def drop_output() -> None:
    """Let nothing more be written: Python would complain once more when it flushes at its exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
