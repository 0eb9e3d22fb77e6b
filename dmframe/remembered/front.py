"""The first thing that ``dmframe verify`` does: find the verdict that was kept, if nothing has changed since.

It runs before CasADi, Pinocchio and the command line's library are imported, which take longer than all of this.
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
"""Columns of a verdict's text where there is no terminal, and at most."""
_VALUES: Final = {"verify": ("--set", "--seed"), "run": ("--set", "--until", "--reality")}
"""Options with a value that a verdict, or what a run concludes from its graphs, depends on."""
_FLAGS: Final = {"verify": ("--json", "--fresh"), "run": ("--json", "--fresh", "--no-plots", "--page", "--force")}
_APART: Final = {"verify": (), "run": ("--out", "-o", "--engine", "--figures")}
"""Flags and options with a value that it does not depend on."""


@final
@dataclass(frozen=True)
class Call:
    """A call of ``verify`` whose verdict may be kept, or of ``run`` whose conclusions may be.

    Parameters
    ----------
    command
        ``verify`` or ``run``.
    words
        Graphs and options as given, but for those of how it is shown.
    as_json, fresh
        Whether `--json` and `--fresh` were given.
    """

    command: str
    words: tuple[str, ...]
    as_json: bool = False
    fresh: bool = False

    @property
    def key(self) -> str:
        """Under which its verdict is kept: the words, and where and by what they are read."""
        flags = (sys.flags.optimize, sys.flags.isolated, sys.flags.no_site, sys.flags.dont_write_bytecode)
        where = (os.getcwd(), sys.executable, sys.version, sys.path, flags, __file__, _columns())  # noqa: PTH109
        return digest(repr((store.FORMAT, self.command, self.words, where)).encode("utf-8", "surrogateescape"))


def call_of(arguments: Sequence[str]) -> Call | None:
    """The call that a command line's words make; None for one whose verdict is not kept, as with `--report`."""
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
    """What was kept of a call, while all its inputs are the same; None where it has to be proved."""
    place = None if call.fresh else store.folder()
    entry = store.find(place, call.key) if place is not None else None
    if entry is None or not unchanged(entry["inputs"]):
        return None
    return entry


def page_of(entry: dict[str, Any], *, as_json: bool) -> str:
    """What is printed of a verdict that was kept."""
    if not as_json:
        return (
            f"{entry['text']}\n\nremembered: proved at {entry['proved_at']}, from the same inputs; --fresh repeats it"
        )
    summaries = [{**item, "remembered": True} for item in entry["summaries"]]
    return json.dumps(summaries[0] if len(summaries) == 1 else summaries, indent=2)


def _columns() -> int:
    """The width for which a text is wrapped."""
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
