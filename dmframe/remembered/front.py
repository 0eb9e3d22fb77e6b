"""Start of ``dmframe verify``: look up a cached verdict with unchanged inputs.

It runs before the imports of CasADi, Pinocchio and the command line's library, which take longer than the lookup.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, final

from dmframe.remembered import store
from dmframe.remembered.inputs import digest, unchanged

WIDEST: Final = 116
"""Largest number of columns of a verdict's text, and the number without a terminal."""
_VALUES: Final = {"verify": ("--set", "--seed", "--over", "--disturbance"), "run": ("--set", "--until", "--reality")}
"""Options with a value on which a verdict, or the conclusions of a run, depends."""
_FLAGS: Final = {"verify": ("--json", "--fresh"), "run": ("--json", "--fresh", "--no-plots", "--page", "--force")}
_APART: Final = {"verify": (), "run": ("--out", "-o", "--engine", "--figures")}
"""Flags and options with a value on which it does not depend."""


@final
@dataclass(frozen=True)
class Call:
    """A call of ``verify`` whose verdict may be cached, or of ``run`` whose conclusions may be.

    Parameters
    ----------
    command
        ``verify`` or ``run``.
    words
        Graphs and options as given, without those that change the output only.
    as_json, fresh
        Whether `--json` and `--fresh` were given.
    """

    command: str
    words: tuple[str, ...]
    as_json: bool = False
    fresh: bool = False

    @property
    def key(self) -> str:
        """The key of its cache entry: its words, the working folder, and the interpreter."""
        flags = (sys.flags.optimize, sys.flags.isolated, sys.flags.no_site, sys.flags.dont_write_bytecode)
        where = (os.getcwd(), sys.executable, sys.version, sys.path, flags, __file__, _columns())  # noqa: PTH109
        return digest(repr((store.FORMAT, self.command, self.words, where)).encode("utf-8", "surrogateescape"))


def call_of(arguments: Sequence[str]) -> Call | None:
    """The call of a command line's words; None if its verdict is not cached, as with `--report`."""
    command = arguments[0] if arguments else ""
    if command not in _VALUES:
        return None
    values, apart = _VALUES[command], _APART[command]
    words, given = list[str](), set[str]()
    rest = iter(arguments[1:])
    for word in rest:
        option = word.partition("=")[0]
        if word in _FLAGS[command]:
            given.add(word)
        elif word in values or word in apart:
            value = next(rest, None)
            if value is None:
                return None
            words += [word, value] if word in values else []
        elif word == "--baseline" and command == "run":
            words.append(word)
        elif word.startswith("-") and option not in (*values, *apart):
            return None
        elif option not in apart:
            words.append(word)
    return Call(command, tuple(words), "--json" in given, "--fresh" in given) if words else None


def found(call: Call) -> dict[str, Any] | None:
    """The cached result of a call if all its inputs are unchanged; otherwise None."""
    place = None if call.fresh else store.folder()
    entry = store.find(place, call.key) if place is not None else None
    if entry is None or not unchanged(entry["inputs"]):
        return None
    return entry


def page_of(entry: dict[str, Any], *, as_json: bool) -> str:
    """The printed text of a cached verdict."""
    if not as_json:
        return (
            f"{entry['text']}\n\nremembered: proved at {entry['proved_at']}, from the same inputs; --fresh repeats it"
        )
    summaries = [{**item, "remembered": True} for item in entry["summaries"]]
    return json.dumps(summaries[0] if len(summaries) == 1 else summaries, indent=2)


def _columns() -> int:
    """The width to which a text is wrapped."""
    try:
        given = int(os.environ.get("COLUMNS", "0"))
    except ValueError:
        given = 0
    if given <= 0 and sys.__stdout__ is not None:
        try:
            given = os.get_terminal_size(sys.__stdout__.fileno()).columns
        except (OSError, ValueError):
            given = WIDEST
    return min(given or WIDEST, WIDEST)
