"""Execution of a controller sample by sample: in a real-time loop, or on a robot behind a gate."""

from dmframe.runtime.controller import Controller

__all__ = ["Controller"]
