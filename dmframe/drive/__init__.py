"""Control of a robot by a graph's controller: limits, rehearsal, drive, and replay of its record."""

from dmframe.drive.drive import run_on_robot
from dmframe.drive.limits import load_limits, own_limits
from dmframe.drive.rehearse import Rehearsal, rehearsed
from dmframe.drive.replay import Replay, replayed

__all__ = ["Rehearsal", "Replay", "load_limits", "own_limits", "rehearsed", "replayed", "run_on_robot"]
