"""Simulation of a diagram."""

from dmframe.simulate.bounds import Divergence
from dmframe.simulate.keep import Log
from dmframe.simulate.many import simulate_many
from dmframe.simulate.recording import Recording
from dmframe.simulate.run import simulate
from dmframe.simulate.start import start_state
from dmframe.simulate.step import Solver

__all__ = ["Divergence", "Log", "Recording", "Solver", "simulate", "simulate_many", "start_state"]
