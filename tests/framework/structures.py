"""The packaged graphs that differ in more than numbers."""

from __future__ import annotations

from dmframe.catalogue import graphs
from dmframe.config.document import read_file


def structures() -> list[str]:
    """One graph of each structure: the blocks, which parameters each is given, and the wires; a small robot's first."""
    found = dict[str, str]()
    for name in sorted(graphs(), key=lambda name: (name.endswith("_full"), name)):
        data = read_file(graphs()[name]).data
        blocks = sorted((block, entry["type"], sorted(entry)) for block, entry in data["blocks"].items())
        found.setdefault(f"{blocks}, {data.get('wires')}", name)
    return list(found.values())
