"""Controller on a robot's samples, with time scaling for a robot that runs more slowly than commanded."""

from __future__ import annotations

from typing import final

import numpy as np

from dmframe.diagram import Diagram
from dmframe.runtime.controller import Controller
from dmframe.runtime.robot import Sample
from dmframe.runtime.signals import measured_as, velocity_command


@final
class ScaledController:
    """Controller whose time runs `scale` times as fast as the robot's.

    Its period is scale T, and it reads velocities dq / scale, so its inputs are those of a slower path. Friction
    and inertia do not scale alike, so that adaptation continues; a law with frozen estimates need not be stable.
    """

    def __init__(self, diagram: Diagram, controller: Controller) -> None:
        self.controller, self.fields = controller, measured_as(diagram)
        self.label = velocity_command(diagram)
        self.command = controller.commanded[self.label]

    @property
    def lacking(self) -> tuple[str, ...]:
        """Fields of a sample that the controller needs and a robot may not have."""
        return tuple(name for name in ("q_c", "x") if name in self.fields.values())

    def begin(self, sample: Sample, t: float = 0.0) -> None:
        """Initialise the states from the robot's pose."""
        self._feed(sample, 1.0)
        self.controller.reset(measured=True, t=t)

    def step(self, sample: Sample, t: float, scale: float) -> bool:
        """Write the command at the controller's time t [s] to `command`; False if the sample is refused."""
        self._feed(sample, scale)
        return self.controller.step(t, scale * (self.controller.clock * (1 + sample.missed)))

    def _feed(self, sample: Sample, scale: float) -> None:
        for label, name in self.fields.items():
            values: np.ndarray = getattr(sample, name)
            if name == "dq" and scale != 1:
                np.divide(values, scale, out=self.controller.measured[label])
            else:
                self.controller.measured[label][:] = values
