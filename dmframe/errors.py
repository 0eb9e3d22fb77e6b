"""Every fault that dmframe reports, one class a kind.

A fault's text reads *where: what was expected and found; the nearest right choice*, and its parts stand as
attributes for programs. `path` leads to the culprit in a graph file (``("blocks", "task", "gama")``); whoever knows
the file adds `location` (``graph.yaml:9:31``).
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence
from typing import final


def nearest(name: str, choices: Iterable[str]) -> str:
    """A hint that ends an error message: the nearest right choice, or all of them where none is near."""
    known = sorted(choices)
    close = difflib.get_close_matches(name, [other for other in known if _alike(name, other)], n=1, cutoff=0.6)
    if close:
        return f"did you mean {close[0]}?"
    if not known:
        return "there is none to choose from"
    return "choose from " + ", ".join(known)


def _alike(name: str, other: str) -> bool:
    """Not by their last word alone: J_hat is not nearly a_d_hat."""
    (head, _, tail), (start, _, end) = name.rpartition("_"), other.rpartition("_")
    return not head or tail != end or difflib.SequenceMatcher(None, head, start).ratio() >= 0.6


def listed(names: Sequence[str]) -> str:
    """As a sentence lists them: "a", "a and b", "a, b and c"."""
    *most, last = names or [""]
    return f"{', '.join(most)} and {last}" if most else last


class DmframeError(Exception):
    """The base of every fault; catch this one to catch them all."""

    def __init__(self, text: str, *, path: Sequence[str | int] = (), location: str = "") -> None:
        super().__init__(text)
        self.text = text
        self.path = tuple(path)
        self.location = location

    @property
    def faults(self) -> tuple[DmframeError, ...]:
        """The faults that it stands for: itself, or each of several."""
        return (self,)

    def __str__(self) -> str:
        return f"{self.location}: {self.text}" if self.location else self.text


def visible(text: str) -> str:
    """A text that a message quotes, in one line: what cannot be shown is escaped."""
    return "".join(letter if letter.isprintable() else ascii(letter)[1:-1] for letter in text)


@final
class Faults(DmframeError):
    """Several faults found in one pass; `faults` holds them in the order of the file."""

    def __init__(self, faults: Sequence[DmframeError]) -> None:
        self._faults = tuple(faults)
        super().__init__("\n".join(str(fault) for fault in self._faults))

    @property
    def faults(self) -> tuple[DmframeError, ...]:
        """Each of them."""
        return self._faults


def raise_all(faults: Sequence[DmframeError]) -> None:
    """Raise nothing, the one fault, or all of them together."""
    if len(faults) == 1:
        raise faults[0]
    if faults:
        raise Faults(faults)


@final
class DocumentError(DmframeError):
    """A graph file that is not a readable YAML document."""


@final
class UnknownNameError(DmframeError, KeyError):
    """A name that nothing bears: a block type, a parameter, a key, a graph, a signal."""

    def __init__(self, where: str, kind: str, name: str, choices: Iterable[str], **place: object) -> None:
        self.name, self.choices = name, tuple(sorted(choices))
        super().__init__(f"{where}: unknown {kind}; {nearest(name, self.choices)}", **place)  # type: ignore[arg-type]  # as DmframeError takes it


@final
class SizeError(DmframeError):
    """A letter of a shape that nothing binds to a number."""

    def __init__(self, text: str, letter: str, path: Sequence[str | int] = ()) -> None:
        super().__init__(text, path=path)
        self.letter = letter


@final
class ValueFault(DmframeError):
    """A value of the wrong type, size, sign or range."""


@final
class MissingError(DmframeError):
    """Something required that is not there: a key, a parameter, a file."""


@final
class ShapeError(DmframeError):
    """Two sizes that must agree and do not."""


@final
class UnitError(DmframeError):
    """A quantity in a unit that cannot be converted to the one expected."""


@final
class WiringError(DmframeError):
    """An input without a source, with two, or a wire from or to nowhere; `missing` is the port that no block has."""

    def __init__(self, text: str, *, missing: str = "", path: Sequence[str | int] = ()) -> None:
        super().__init__(text, path=path)
        self.missing = missing


@final
class AccessError(DmframeError):
    """A controller block that reads what a closed robot hides, or a robot driven by what cannot be commanded."""


@final
class AlgebraicLoopError(DmframeError):
    """Signals that need one another at the same instant; `ports` lists them in order."""

    def __init__(self, ports: Sequence[str], remedy: str) -> None:
        self.ports = tuple(ports)
        super().__init__(f"algebraic loop: {' -> '.join(ports)}; {remedy}")


@final
class DerivativeError(DmframeError):
    """A time derivative that the controller cannot have."""


@final
class BlockError(DmframeError):
    """A block class that breaks the contract of `AbstractBlock`."""


@final
class NeedsDiagramError(DmframeError):
    """A parameter that a block reads as a number: another value of it needs another diagram."""


@final
class RobotError(DmframeError):
    """A robot that cannot be found, read or modelled as a serial chain."""


@final
class StartError(DmframeError):
    """A start pose that cannot be reached."""


@final
class EngineError(DmframeError):
    """An integrator that failed or a step that cannot work."""


@final
class DisagreementError(DmframeError):
    """Two ways to compute one thing disagree, so that neither is believed: a proof and what contradicts it."""


@final
class OutputError(DmframeError):
    """Results that cannot be written."""


@final
class DriveError(DmframeError):
    """A robot that is not to be driven, or not by this graph."""


@final
class LostError(DmframeError):
    """A robot that no longer answers."""
