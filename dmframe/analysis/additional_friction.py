"""Friction between servo and arm that depends on the joint velocity only, such as the Stribeck effect, linearised."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, final

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from dmframe.block.model import BlockModel

Array = NDArray[np.float64]

VOLTAGE: Final = "u"
SPEED: Final = "dq"
MOTOR: Final = "K"
SPEEDS: Final = np.concatenate([[0.0], np.logspace(-4, 1, 201)])
"""Velocities at which the slope is computed [rad/s]."""
LARGE: Final = 1e5
"""Voltages at which the block must add the same torque."""
NEGLIGIBLE: Final = 0.01
"""Slope, relative to the largest, that does not count."""


@final
@dataclass(frozen=True)
class AdditionalFriction:
    """Slope of a block's torque in the joint velocity, over velocities and joints [N m s/rad].

    Parameters
    ----------
    standstill, least
        Largest slope at zero velocity, and least slope (negative where friction decreases with velocity).
    above
        Velocity above which the slope is negligible [rad/s].
    """

    block: str
    standstill: float
    least: float
    above: float

    def __str__(self) -> str:
        return (
            f"without the friction of {self.block}, whose slope is up to {self.standstill:.3g} N m s/rad at "
            f"standstill, {self.least:.3g} at the least, and small above {self.above:.2g} rad/s"
        )


def additional_friction(name: str, model: BlockModel) -> AdditionalFriction | None:
    """Friction of a block with the output u that replaces its input u; None if it does more than add friction."""
    output = next((port.name for port in model.block.outputs if port.instead_of == VOLTAGE), None)
    if output is None or model.states or not {VOLTAGE, SPEED, MOTOR} <= model.inputs.keys():
        return None
    result, inputs = model.equations.outputs[output], model.inputs
    slopes = [ca.jacobian(result, inputs[key]) for key in (VOLTAGE, SPEED)]
    everything = {**inputs, **model.parameters}
    robot = [] if model.robot is None else [(c.symbol, model.robot.values()[c.name]) for c in model.robot.constants]
    function = ca.Function("slopes", [*everything.values(), *(symbol for symbol, _ in robot)], slopes)
    n, random = inputs[VOLTAGE].numel(), np.random.default_rng(0)
    found = list[Array]()
    for speed in SPEEDS:
        given = {key: np.zeros(symbol.shape) for key, symbol in everything.items()} | dict(model.values)
        given |= {VOLTAGE: LARGE * random.normal(size=n), SPEED: np.full(n, speed), MOTOR: np.ones(n)}
        through, slope = (
            np.asarray(ca.densify(part).full())
            for part in function(*(given[key] for key in everything), *(value for _, value in robot))
        )
        if not np.allclose(through, np.eye(n), rtol=0, atol=1e-12) or np.any(slope - np.diag(np.diag(slope))):
            return None
        found.append(-np.diag(slope))
    table = np.array(found)
    size = float(np.max(np.abs(table)))
    steep = np.flatnonzero(np.any(np.abs(table) > NEGLIGIBLE * size, axis=1))
    above = float(SPEEDS[min(int(steep[-1]) + 1, len(SPEEDS) - 1)]) if len(steep) else 0.0
    return AdditionalFriction(name, float(np.max(table[0])), float(np.min(table)), above)
