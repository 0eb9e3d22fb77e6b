"""A block's equations with the robot's limits as symbols: as numbers they have no units."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final, final

import casadi as ca

from dmframe.block.certificate import SX
from dmframe.block.model import BlockModel, signals_of, stated_by
from dmframe.block.sizes import Sizes

LIMITS: Final[Mapping[str, str]] = {
    "velocity_limits": "rad/s",
    "effort_limits": "N m",
    "lower_limits": "rad",
    "upper_limits": "rad",
}
"""Numeric joint limits of a robot model, with their units."""


@final
class Limited:
    """A robot whose limits are symbols."""

    def __init__(self, robot: Any) -> None:
        self._robot, self.limits = robot, dict[str, SX]()

    def __getattr__(self, name: str) -> Any:
        if name not in LIMITS:
            return getattr(self._robot, name)
        if name not in self.limits:
            self.limits[name] = ca.SX.sym(name, self._robot.n)
        return self.limits[name]


def with_limits(model: BlockModel, sizes: Sizes) -> BlockModel | None:
    """The block with such a robot; None if its equations read no limits."""
    robot = Limited(model.robot)
    parameters = {**model.parameters, **model.starts}
    signals = signals_of(model.name, model.inputs, model.states, parameters, robot)
    equations = stated_by(model.name, model.block, signals, sizes)
    return replace(model, equations=equations, robot=robot) if robot.limits else None
