"""The loop in MuJoCo with its semi-implicit Euler method: one evaluation per step, first-order error."""

from __future__ import annotations

from typing import ClassVar

from tests.benchmarks.peers import mujoco_callback


class Loop(mujoco_callback.Loop):
    """The usual choice for speed."""

    title: ClassVar[str] = "MuJoCo, Euler"
    method: ClassVar[str] = "semi-implicit Euler"
    integrator: ClassVar[str] = "Euler"
    note: ClassVar[str] = "Python once a step; it has a first-order error, so only its speed is compared"
