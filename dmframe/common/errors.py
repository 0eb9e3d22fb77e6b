"""Errors of dmframe, one class for each kind.

The text of an error is *where: what was expected and found; the nearest valid choice*; attributes have its parts for
programs. `path` is the place in a graph file (``("blocks", "task", "gama")``); the reader of the file adds `location`
(``graph.yaml:9:31``).
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence
from typing import final


def nearest(name: str, choices: Iterable[str]) -> str:
    """Hint at the end of an error message: the nearest valid choice, or all of them if none is near."""
    known = sorted(choices)
    same = [other for other in known if other.casefold() == name.casefold()]
    near = [other for other in known if _alike(name, other)]
    close = same or difflib.get_close_matches(name, near, n=1, cutoff=0.6)
    if close:
        return f"did you mean {close[0]}?"
    if not known:
        return "there is none to choose from"
    return "choose from " + ", ".join(known)


def _alike(name: str, other: str) -> bool:
    """True unless only the last words of two names agree: J_hat is not similar to a_d_hat."""
    (head, _, tail), (start, _, end) = name.rpartition("_"), other.rpartition("_")
    return not head or tail != end or difflib.SequenceMatcher(None, head, start).ratio() >= 0.6


def listed(names: Sequence[str]) -> str:
    """Join names in a sentence: "a", "a and b", "a, b and c"."""
    *most, last = names or [""]
    return f"{', '.join(most)} and {last}" if most else last


LISTS = "`dmframe graphs` and `dmframe robots` list the packaged ones"
"""What replaces a list of all graphs and robots."""
MOST_LISTED = 6
"""Names of a list that `summarised` gives in full."""


def summarised(names: Sequence[str], last: str = " and") -> str:
    """A list of any length in a sentence: "a, b and c", or "a, b, c, d, e and 120 others"."""
    most = len(names) if len(names) <= MOST_LISTED else MOST_LISTED - 1
    *first, end = [*names[:most], *([f"{len(names) - most} others"] if most < len(names) else [])] or [""]
    return f"{', '.join(first)}{last or ','} {end}" if first else end


class DmframeError(Exception):
    """Base class of all errors of dmframe."""

    def __init__(self, text: str, *, path: Sequence[str | int] = (), location: str = "") -> None:
        super().__init__(text)
        self.text = text
        self.path = tuple(path)
        self.location = location

    @property
    def faults(self) -> tuple[DmframeError, ...]:
        """Itself, or each of several errors."""
        return (self,)

    def __str__(self) -> str:
        return f"{self.location}: {self.text}" if self.location else self.text


def visible(text: str) -> str:
    """A text to quote in a message, in one line, with unprintable characters escaped."""
    return "".join(letter if letter.isprintable() else ascii(letter)[1:-1] for letter in text)


@final
class Faults(DmframeError):
    """Several errors found in one pass, in the order of the file."""

    def __init__(self, faults: Sequence[DmframeError]) -> None:
        self._faults = tuple(faults)
        super().__init__("\n".join(str(fault) for fault in self._faults))

    @property
    def faults(self) -> tuple[DmframeError, ...]:
        """The errors."""
        return self._faults


def raise_all(faults: Sequence[DmframeError]) -> None:
    """Raise the error, or `Faults` for several; nothing for none."""
    if len(faults) == 1:
        raise faults[0]
    if faults:
        raise Faults(faults)


@final
class DocumentError(DmframeError):
    """A graph file that is not a readable YAML document."""


@final
class UnknownNameError(DmframeError, KeyError):
    """An unknown name of a block type, a parameter, a key, a graph or a signal.

    Without `spelling` the message lists all choices, and suggests one only if it differs in upper and lower case.
    `others` replaces a list of all choices.
    """

    def __init__(
        self,
        where: str,
        kind: str,
        name: str,
        choices: Iterable[str],
        *,
        spelling: bool = True,
        others: str = "",
        **place: object,
    ) -> None:
        self.name, self.choices = name, tuple(sorted(choices))
        same = name.casefold() in map(str.casefold, self.choices)
        hint = nearest(name if spelling or same else "", self.choices)
        hint = others if others and not hint.startswith("did you mean") else hint
        super().__init__(f"{where}: unknown {kind}; {hint}", **place)  # type: ignore[arg-type]  # as DmframeError takes it


@final
class SizeError(DmframeError):
    """A letter of a shape without a value."""

    def __init__(self, text: str, letter: str, path: Sequence[str | int] = ()) -> None:
        super().__init__(text, path=path)
        self.letter = letter


@final
class ValueFault(DmframeError):
    """A value of the wrong type, size, sign or range."""


@final
class MissingError(DmframeError):
    """A missing key, parameter or file."""


@final
class ShapeError(DmframeError):
    """Two sizes that do not agree."""


@final
class UnitError(DmframeError):
    """A quantity in a unit that cannot be converted to the expected one."""


@final
class WiringError(DmframeError):
    """An input without a source, or with two, or a wire with an unknown end; `missing` is the unknown port."""

    def __init__(self, text: str, *, missing: str = "", path: Sequence[str | int] = ()) -> None:
        super().__init__(text, path=path)
        self.missing = missing


@final
class AccessError(DmframeError):
    """A controller block that reads a hidden signal of a closed robot, or a wire to an input that is not a command."""


@final
class AlgebraicLoopError(DmframeError):
    """Signals that depend on one another at the same instant; `ports` lists them in order."""

    def __init__(self, ports: Sequence[str], remedy: str) -> None:
        self.ports = tuple(ports)
        super().__init__(f"algebraic loop: {' -> '.join(ports)}; {remedy}")


@final
class DerivativeError(DmframeError):
    """A time derivative that the controller cannot compute."""


@final
class BlockError(DmframeError):
    """A block class that violates the contract of `AbstractBlock`."""


@final
class NeedsDiagramError(DmframeError):
    """A parameter that a block reads as a number, so that another value requires another diagram."""


@final
class RobotError(DmframeError):
    """A robot that cannot be found, read or modelled as a serial chain."""


@final
class StartError(DmframeError):
    """A start pose that cannot be reached."""


@final
class EngineError(DmframeError):
    """A failed integrator, or an invalid step."""


@final
class DisagreementError(DmframeError):
    """Contradicting results of two computations, such as a proof and its cross-check."""


@final
class OutputError(DmframeError):
    """Results that cannot be written."""


@final
class DriveError(DmframeError):
    """A robot that must not be driven, or not by this graph."""


@final
class LostError(DmframeError):
    """A robot that does not answer."""
