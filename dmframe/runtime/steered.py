"""A controller fed with a robot's samples, also where the robot runs slower than it was told."""

from __future__ import annotations

from typing import final

import numpy as np

from dmframe.diagram import Diagram
from dmframe.runtime.controller import Controller
from dmframe.runtime.robot import Sample
from dmframe.runtime.signals import measured_as, velocity_command


@final
class Steered:
    """A controller in its own time, which runs `scale` times as fast as the robot's.

    A period of length T is then scale T long for it, and a velocity dq is dq / scale. So it sees the robot that it
    knows, on a path that is passed more slowly. Friction and inertia do not scale alike, so it goes on learning; a law
    whose estimates are held is another one, which need not be stable.
    """

    def __init__(self, diagram: Diagram, controller: Controller) -> None:
        self.controller, self.fields = controller, measured_as(diagram)
        self.label = velocity_command(diagram)
        self.command = controller.commanded[self.label]

    @property
    def lacking(self) -> tuple[str, ...]:
        """Fields of a sample that it needs and a robot may not tell."""
        return tuple(name for name in ("q_c", "x") if name in self.fields.values())

    def begin(self, sample: Sample, t: float = 0.0) -> None:
        """Start its states from where the robot is."""
        self._feed(sample, 1.0)
        self.controller.reset(measured=True, t=t)

    def step(self, sample: Sample, t: float, scale: float) -> bool:
        """Its command at its own time t [s] is then in `command`. False for a sample that it has refused."""
        self._feed(sample, scale)
        return self.controller.step(t, scale * (self.controller.clock * (1 + sample.missed)))

    def _feed(self, sample: Sample, scale: float) -> None:
        for label, name in self.fields.items():
            values: np.ndarray = getattr(sample, name)
            if name == "dq" and scale != 1:
                np.divide(values, scale, out=self.controller.measured[label])
            else:
                self.controller.measured[label][:] = values
