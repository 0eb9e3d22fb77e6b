"""Standard streams that escape characters and tolerate closed, full or broken outputs."""

from __future__ import annotations

import io
import os
import sys
from contextlib import suppress
from typing import Final, TextIO, final


class OutputGone(Exception):
    """Standard output cannot be written; not an `OSError`, which libraries handle by exiting."""

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


listeners: Final = list[list[str]]()
"""Lists that receive the texts on standard error."""


@final
class _Errors(io.TextIOWrapper):
    """Standard error that drops text after an error: a run survives the loss of its terminal."""

    def write(self, text: str, /) -> int:
        if text.strip() and not {"\x1b", "\r"} & set(text):  # no progress bar
            for texts in listeners:
                texts.append(text)
        with suppress(OSError):
            return super().write(text)
        return len(text)

    def flush(self) -> None:
        with suppress(OSError):
            super().flush()


def prepare() -> None:
    """Make the streams usable; call it before any file is opened or text printed."""
    for number in (0, 1, 2):
        try:
            os.fstat(number)
        except OSError:  # closed, as by >&-: the next opened file would get this number
            os.open(os.devnull, os.O_RDWR)
    sys.stdout = _wrapped(sys.stdout, _Output)
    sys.stderr = _wrapped(sys.stderr, _Errors)


def _wrapped(stream: TextIO | None, kind: type[io.TextIOWrapper]) -> TextIO:
    if stream is None:
        return open(os.devnull, "w", encoding="utf-8")  # noqa: PTH123 - open for the whole process
    if type(stream) is not io.TextIOWrapper:  # replaced by the host, as in tests
        return stream
    return kind(
        stream.buffer,
        stream.encoding,
        "backslashreplace",  # for characters outside the encoding and undecodable bytes of names
        line_buffering=stream.line_buffering,
        write_through=stream.write_through,
    )


def tell(text: str, *, aside: bool = False) -> None:
    """Print and flush to standard output, or to standard error with `aside`."""
    stream = sys.stderr if aside else sys.stdout
    stream.write(text + "\n")
    stream.flush()


def drop_output() -> None:
    """Discard further output, so that the flush at exit raises no error."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
