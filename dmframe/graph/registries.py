"""The available packaged graphs, block types and robots."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape
from typing import Any, final

from dmframe.block import AbstractBlock, type_name
from dmframe.common.errors import DmframeError
from dmframe.common.units import to_unit
from dmframe.config.registry import Registry
from dmframe.graph.graph import Graph
from dmframe.graph.load import load
from dmframe.robot.chain import SerialChain


def graphs() -> Registry[Graph]:
    """The packaged graphs, ``dm.graphs()["ur10_fast"]``."""
    from dmframe.catalogue import graphs as packaged
    from dmframe.config.document import read_file

    facts = dict[str, dict[str, str | float]]()
    for name, path in packaged().items():
        data = read_file(path).data
        times = {key: _seconds(data.get(key, "")) for key in ("duration", "clock")}
        facts[name] = {**times, "title": str(data.get("title", ""))}
    return Registry("graph", facts, load)


def _seconds(value: Any) -> str | float:
    """A time [s], or the text of the file if it is not a time, such as continuous."""
    try:
        return to_unit(value, "s")
    except DmframeError:
        return str(value)


@final
@dataclass(frozen=True, repr=False)
class BlockType:
    """A block type with its page: the law printed from its code, its ports, states and parameters.

    Called with parameters it creates a block:
    ``dm.blocks()["circle"](center=[0, 0, 0.5], radius=0.1, rate="1 rad/s")``.
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


def blocks() -> Registry[BlockType]:
    """The block types; ``print(dm.blocks()["dynamic_compensator"])`` is the page of ``dmframe blocks``."""
    from dmframe.catalogue import block_types
    from dmframe.graph.pages import first_line

    kinds = block_types()
    facts = {name: {"side": kind.side.value, "summary": first_line(kind)} for name, kind in kinds.items()}
    return Registry("block type", facts, lambda name: BlockType(kinds[name]))


def robots() -> Registry[SerialChain]:
    """The robots that come with installed packages, ``dm.robots()["ur10"]``."""
    from dmframe.robot.library import load as load_robot
    from dmframe.robot.library import robots as known

    return Registry(
        "robot", {name: {"description": source.description} for name, source in known().items()}, load_robot
    )
