"""Targets of an export: the controller of a graph for other programs.

A target is a function of a graph that returns files by their paths below the new folder. To add one, write the function
in a module of this package, and add a row to `TARGETS`: the command line and `Graph.export` offer what the table has.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import TYPE_CHECKING, Final, NamedTuple, TypeAlias, cast

if TYPE_CHECKING:
    from dmframe.config import BaseGraph

Files: TypeAlias = Mapping[str, str | bytes]
TargetFunction: TypeAlias = "Callable[[BaseGraph], Files]"


class Target(NamedTuple):
    """One target.

    Parameters
    ----------
    about
        Help of its option.
    home
        Module and name of its function, imported when a graph is exported.
    into_existing
        Its files may be written into a folder that exists.
    """

    about: str
    home: str
    into_existing: bool = False

    @property
    def function(self) -> TargetFunction:
        """(graph) -> files."""
        module, _, name = self.home.partition(":")
        return cast("TargetFunction", getattr(import_module(module), name))


TARGETS: Final = {
    "c": Target("The controller as C99, with an example and a test.", "dmframe.export.c:c_files"),
    "fmi2": Target("Controller and robot as units of FMI 2.0.", "dmframe.export.fmu:fmi2_files", into_existing=True),
    "fmi3": Target("Controller and robot as units of FMI 3.0.", "dmframe.export.fmu:fmi3_files", into_existing=True),
    "ros2": Target(
        "A package with a controller of ros2_control; never run in ROS 2.", "dmframe.export.ros2:ros2_files"
    ),
}
"""Each target, by the word of its option: ``dmframe export GRAPH OUT --c``, ``graph.export(OUT, "c")``."""
