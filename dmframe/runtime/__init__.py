"""A controller outside of a simulation: one sample at a time, in real time."""

from dmframe.runtime.controller import Controller

__all__ = ["Controller"]
