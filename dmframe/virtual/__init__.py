"""A closed robot without hardware: the maker's protocols and scripts about a graph's own arm and hidden servo."""

from dmframe.virtual.robot import Series, VirtualRobot
from dmframe.virtual.server import Ports
from dmframe.virtual.words import ScriptError

__all__ = ["Ports", "ScriptError", "Series", "VirtualRobot"]
