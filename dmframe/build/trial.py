"""One call of a freshly compiled library in a process of its own: what crashes there takes nobody with it.

A compiler may end well and leave a library that does not work: cut off on a full disk, made for another machine, or
plainly wrong. Loaded into the program, its first call would end it without a word; kept in the cache, every later run.
This file is run by its path and imports nothing of dmframe.
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
"""A call that takes longer has hung [s]."""


def called(library: Path, function: str, arguments: Sequence[Any]) -> list[list[float]] | None:
    """What a C function leaves in its arrays of doubles; None where it crashed, hung or is not there.

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
    """Read the call from standard input, do it, and print the arrays."""
    asked = json.load(sys.stdin)
    function = getattr(ctypes.CDLL(asked["library"]), asked["function"])
    arrays, given = list[tuple[Any, int]](), list[Any]()
    for argument in asked["arguments"]:
        ((kind, value),) = argument.items()
        if kind == "doubles":
            given.append((ctypes.c_double * max(1, len(value)))(*value))  # none would have no address
            arrays.append((given[-1], len(value)))
        elif kind == "integers":
            given.append((ctypes.c_int64 * max(1, len(value)))(*value))
        else:
            given.append({"double": ctypes.c_double, "integer": ctypes.c_int64}[kind](value))
    function(*given)
    json.dump([array[:size] for array, size in arrays], sys.stdout)


if __name__ == "__main__":
    main()
