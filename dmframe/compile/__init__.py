"""C from CasADi functions, compiled once and kept."""

from dmframe.compile.library import Loaded, first_time, load
from dmframe.compile.parts import Parts
from dmframe.compile.source import control_source, loop_source

__all__ = ["Loaded", "Parts", "control_source", "first_time", "load", "loop_source"]
