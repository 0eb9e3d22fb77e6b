"""Trial call of a new library in a separate process, so that a crash does not end this one.

A compiler may succeed and still produce a broken library: truncated on a full disk, built for another machine, or
wrong. Its first call would end the program silently, and, from the cache, every later run. This file is
executed by its path and imports nothing of dmframe.
"""

from __future__ import annotations

import ctypes
import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

LIMIT = 60.0
"""Timeout of a call [s]."""


def called(library: Path, function: str, arguments: Sequence[Any]) -> list[list[float]] | None:
    """Arrays of doubles after a call of a C function; None if it crashed, hung or does not exist.

    Parameters
    ----------
    arguments
        ``{"doubles": [...]}`` or ``{"integers": [...]}``, an array; ``{"double": x}`` or ``{"integer": k}``, a number.
    """
    given = json.dumps({"library": str(library), "function": function, "arguments": list(arguments)})
    words = [sys.executable, "-I", "-S", str(Path(__file__).resolve())]
    try:
        done = subprocess.run(words, input=given, capture_output=True, text=True, check=False, timeout=LIMIT)
    except (OSError, subprocess.TimeoutExpired):
        return None
    if done.returncode != 0:
        return None
    try:
        found: list[list[float]] = json.loads(done.stdout)
    except ValueError:
        return None
    return found


def main() -> None:
    """Read a call from standard input, execute it, and print the arrays."""
    call = json.load(sys.stdin)
    function = getattr(ctypes.CDLL(call["library"]), call["function"])
    arrays, given = list[tuple[Any, int]](), list[Any]()
    for argument in call["arguments"]:
        ((kind, value),) = argument.items()
        if kind == "doubles":
            given.append((ctypes.c_double * max(1, len(value)))(*value))  # an empty array has no address
            arrays.append((given[-1], len(value)))
        elif kind == "integers":
            given.append((ctypes.c_int64 * max(1, len(value)))(*value))
        else:
            given.append({"double": ctypes.c_double, "integer": ctypes.c_int64}[kind](value))
    function(*given)
    json.dump([array[:size] for array, size in arrays], sys.stdout)


if __name__ == "__main__":
    main()
