"""The packaged graphs that differ in more than numbers, and a few that together contain every block."""

from __future__ import annotations

from functools import cache
from typing import Any

import yaml  # part of distributed

from dmframe.catalogue import graphs


@cache
def packaged() -> dict[str, dict[str, Any]]:
    """The data of every packaged graph, small robots first. YAML 1.1 is read in C; it reads 1e-3 as a text."""
    names = sorted(graphs(), key=lambda name: ("_full" in name, name))
    return {name: yaml.load(graphs()[name].read_bytes(), yaml.CSafeLoader) for name in names}


def structures() -> list[str]:
    """One graph of each structure: blocks, given parameters, and wires; small robots first."""
    found = dict[str, str]()
    for name, data in packaged().items():
        blocks = sorted((block, entry["type"], sorted(entry)) for block, entry in data["blocks"].items())
        found.setdefault(f"{blocks}, {data.get('wires')}", name)
    return list(found.values())


def every_block() -> list[str]:
    """A few graphs that together contain every packaged graph's blocks, one with a redundant robot of 7 joints."""
    kinds = {name: {entry["type"] for entry in data["blocks"].values()} for name, data in packaged().items()}
    found, left = ["panda_full"], set[str]().union(*kinds.values()) - kinds["panda_full"]
    while left:
        most = max(kinds, key=lambda name: len(kinds[name] & left))
        found.append(most)
        left -= kinds[most]
    return found
