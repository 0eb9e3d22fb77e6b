"""A controller outside of a simulation: one sample at a time, in real time, and on a robot through a gate."""

from dmframe.runtime.controller import Controller

__all__ = ["Controller"]
