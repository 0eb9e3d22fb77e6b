"""Build of a C source to a loaded library: compiler, trial call, cache."""

from dmframe.build.library import Loaded, first_time, load

__all__ = ["Loaded", "first_time", "load"]
