"""From a C source to a library in this process: the compiler, a trial, a cache."""

from dmframe.build.library import Loaded, first_time, load

__all__ = ["Loaded", "first_time", "load"]
