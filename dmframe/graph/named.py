"""Things by name, which nobody changes; a name that is not there is told with the nearest."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Generic, TypeVar, final

from dmframe.errors import UnknownNameError

T = TypeVar("T")


@final
@dataclass(frozen=True, repr=False)
class Named(Mapping[str, T], Generic[T]):
    """A read-only mapping; `kind` is what its things are."""

    kind: str
    held: Mapping[str, T]

    def __getitem__(self, name: str) -> T:
        if name not in self.held:
            raise UnknownNameError(f"{self.kind}s[{name!r:.40}]", self.kind, str(name), self.held)
        return self.held[name]

    def __contains__(self, name: object) -> bool:
        return name in self.held

    def __iter__(self) -> Iterator[str]:
        return iter(self.held)

    def __len__(self) -> int:
        return len(self.held)

    def __repr__(self) -> str:
        return repr(dict(self.held))

    def _ipython_key_completions_(self) -> list[str]:
        return list(self.held)
