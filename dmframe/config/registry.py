"""Read-only mapping from names to objects with facts about each; the error for a missing name suggests the closest."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Generic, TypeVar, final

from dmframe.common import notebook
from dmframe.common.columns import columns
from dmframe.common.errors import UnknownNameError, ValueFault
from dmframe.common.units import plain

T = TypeVar("T")


@final
@dataclass(frozen=True, repr=False, eq=False)
class Registry(Mapping[str, T], Generic[T]):
    """A read-only mapping; a notebook and ``str`` display its facts as a table.

    Parameters
    ----------
    kind
        Kind of the objects, ``block type``.
    facts
        Facts about each object, by its name: texts, and times [s].
    make
        Returns the object of a name.
    """

    kind: str
    facts: Mapping[str, Mapping[str, str | float]]
    make: Callable[[str], T]

    @property
    def summary(self) -> list[dict[str, Any]]:
        """The facts as plain data, which ``--json`` prints."""
        return [{"name": name, **facts} for name, facts in self.facts.items()]

    @property
    def _rows(self) -> list[tuple[str, ...]]:
        return [(name, *map(_cell, facts.values())) for name, facts in self.facts.items()]

    def __getitem__(self, name: str) -> T:
        if not isinstance(name, str):
            raise ValueFault(f"{self.kind}s[{name!r:.30}]: expected a name, found {type(name).__name__}")
        if name not in self.facts:
            raise UnknownNameError(f"{self.kind}s[{name!r:.40}]", self.kind, name, self.facts)
        return self.make(name)

    def __contains__(self, name: object) -> bool:
        return name in self.facts

    def __iter__(self) -> Iterator[str]:
        return iter(self.facts)

    def __len__(self) -> int:
        return len(self.facts)

    def _ipython_key_completions_(self) -> list[str]:
        return list(self)

    def __repr__(self) -> str:
        return f"<{len(self)} {self.kind}s: {', '.join(self)}>"

    def __str__(self) -> str:
        return columns(self._rows, indent="")

    def _repr_html_(self) -> str:
        heads = [head for facts in list(self.facts.values())[:1] for head in facts]
        return notebook.table(self._rows, (self.kind, *heads))


def _cell(fact: str | float) -> str:
    return fact if isinstance(fact, str) else plain(fact, "s")
