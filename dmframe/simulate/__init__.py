"""Running a diagram."""

from dmframe.simulate.keep import Log
from dmframe.simulate.run import Divergence, Run, simulate
from dmframe.simulate.start import start_state
from dmframe.simulate.step import Solver

__all__ = ["Divergence", "Log", "Run", "Solver", "simulate", "start_state"]
