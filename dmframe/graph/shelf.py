"""What there is to choose from: packaged graphs, block types, robots."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from html import escape
from typing import Any, Generic, TypeVar, final

from dmframe import notebook
from dmframe.block import AbstractBlock, type_name
from dmframe.columns import columns
from dmframe.errors import UnknownNameError, ValueFault
from dmframe.graph.graph import Graph, load
from dmframe.robot.chain import SerialChain

T = TypeVar("T")


@final
@dataclass(frozen=True, repr=False)
class Shelf(Mapping[str, T], Generic[T]):
    """Things by name, each with a line about it; a notebook and ``str`` show the table.

    Parameters
    ----------
    kind
        What they are, ``block type``.
    rows
        Name, and what is said of it.
    make
        The thing of a name.
    """

    kind: str
    rows: Mapping[str, str]
    make: Callable[[str], T]

    def __getitem__(self, name: str) -> T:
        if not isinstance(name, str):
            raise ValueFault(f"{self.kind}s[{name!r:.30}]: expected a name, found {type(name).__name__}")
        if name not in self.rows:
            raise UnknownNameError(f"{self.kind}s[{name!r}]", self.kind, name, self.rows)
        return self.make(name)

    def __contains__(self, name: object) -> bool:
        return name in self.rows

    def __iter__(self) -> Iterator[str]:
        return iter(self.rows)

    def __len__(self) -> int:
        return len(self.rows)

    def _ipython_key_completions_(self) -> list[str]:
        return list(self.rows)

    def __repr__(self) -> str:
        return f"<{len(self)} {self.kind}s: {', '.join(self)}>"

    def __str__(self) -> str:
        return columns(self.rows.items(), indent="")

    def _repr_html_(self) -> str:
        return notebook.table(self.rows.items(), (self.kind, ""))


def graphs() -> Shelf[Graph]:
    """The packaged graphs, ``dm.graphs()["ur10_fast"]``."""
    from dmframe.catalogue import graphs as packaged
    from dmframe.config.document import read_file

    return Shelf("graph", {name: str(read_file(path).data.get("title", "")) for name, path in packaged().items()}, load)


@final
@dataclass(frozen=True, repr=False)
class BlockType:
    """A block type with its page: its law as its code says it, its ports, states and parameters.

    Called with parameters it makes a block, ``dm.blocks()["circle"](center=[0, 0, 0.5], radius=0.1, rate="1 rad/s")``.
    """

    kind: type[AbstractBlock]

    def __call__(self, **parameters: Any) -> AbstractBlock:
        """A block. Raises `DmframeError` with every fault of the parameters."""
        return self.kind(**parameters)

    def __repr__(self) -> str:
        return f"<block type {type_name(self.kind)}>"

    def __str__(self) -> str:
        from dmframe.graph.pages import block_page

        return block_page(self.kind)

    def _repr_html_(self) -> str:
        return f"<pre>{escape(str(self))}</pre>"


def blocks() -> Shelf[BlockType]:
    """The block types; ``print(dm.blocks()["dynamic_compensator"])`` is the page of ``dmframe blocks``."""
    from dmframe.catalogue import block_types
    from dmframe.graph.pages import first_line

    kinds = block_types()
    rows = {name: first_line(kind) for name, kind in kinds.items()}
    return Shelf("block type", rows, lambda name: BlockType(kinds[name]))


def robots() -> Shelf[SerialChain]:
    """The robots that come with installed packages, ``dm.robots()["ur10"]``."""
    from dmframe.robot.library import load as load_robot
    from dmframe.robot.library import robots as known

    return Shelf("robot", {name: source.description for name, source in known().items()}, load_robot)
