"""Plants on which laws are tuned and judged: servos as manufacturers sell them, or draws of an identified one.

Without a log the servo is unknown, so the family contains a PID position servo and a cascade with and without velocity
feed-forward, of half to three times the stiffness of the first graph's placeholder, with up to twice its friction, up
to one sample of delay besides that of the channel, and a load that is picked up after half of the time.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, final

import numpy as np

from dmframe.graph.first import FirstGraph
from dmframe.identification.built import moved
from dmframe.identification.drawn import Plant, rubbing_of, thetas
from dmframe.identification.found import Identified
from dmframe.identification.race_text import FIT, SERVO, noise_of

Block = dict[str, Any]

STIFFNESS_P: Final = 20.0
"""Position gain of a cascade [1/s]."""
STIFFNESS_I: Final = 10.0
"""K_i/K_v of a cascade [1/s]."""
DIGITS: Final = 6
DRAWS: Final = 8
"""Draws of an identified robot."""


@final
@dataclass(frozen=True)
class Kind:
    """One servo of the family, relative to the placeholder of the first graph."""

    cascade: bool
    stiffness: float = 1.0
    friction: float = 1.0
    feed_forward: float = 1.0
    delay: float = 0.0
    loaded: bool = False


TRAINING: Final[Mapping[str, Kind]] = {
    "pid": Kind(cascade=False),
    "cascade": Kind(cascade=True, delay=1.0),
}
HELD_OUT: Final[Mapping[str, Kind]] = {
    "pid_soft": Kind(cascade=False, stiffness=0.5),
    "pid_stiff_late": Kind(cascade=False, stiffness=3.0, delay=1.0),
    "pid_loaded": Kind(cascade=False, loaded=True),
    "cascade_half_late": Kind(cascade=True, feed_forward=0.5, delay=1.0),
    "cascade_rubbing": Kind(cascade=True, friction=2.0),
    "cascade_loaded": Kind(cascade=True, delay=1.0, loaded=True),
}


@final
@dataclass(frozen=True)
class Family:
    """Plants by name, as sections of a race file.

    Parameters
    ----------
    training
        Names of those for tuning; the first one is the nominal.
    channel
        Channel models between controller and robot, as the key reality of a graph.
    late
        Longest delay of a plant and the channel [samples].
    """

    plants: Mapping[str, Block]
    training: Sequence[str]
    channel: str | Block = "ur"
    late: float = 2.0

    @property
    def nominal(self) -> str:
        """The plant of the graph that is handed over."""
        return self.training[0]


def makers(first: FirstGraph, payload: float, seconds: float) -> Family:
    """The family of an unknown servo, with a payload [kg] after half of the runs' duration [s]."""
    from ruamel.yaml import YAML

    blocks = YAML(typ="safe").load(first.text)["blocks"]
    found = {name: _plant(kind, blocks, payload, seconds) for name, kind in {**TRAINING, **HELD_OUT}.items()}
    return Family(found, list(TRAINING))


def identified(found: Identified, payload: float, seconds: float, clock: float, seed: int = 0) -> Family:
    """The best fit of a log for tuning; draws from its covariance, and the best fit with a payload, for comparison."""
    unknowns = found.fit.unknowns
    drawn = moved(found, thetas(found, DRAWS, seed))
    plants = [Plant.of(unknowns, theta) for theta in (found.fit.theta, *drawn.T)]
    rubbing = rubbing_of(found)
    late = [plant.delay * unknowns.log.period / clock for plant in plants]
    names = [FIT, *(f"draw_{k}" for k in range(1, DRAWS + 1))]
    sections: dict[str, Block] = {
        name: plant.blocks(SERVO[found.kind], rubbing) | {"transport_delay": rounded([delay])[0]}
        for name, plant, delay in zip(names, plants, late, strict=True)
    }
    for name, section in sections.items():  # all with a load, so that they share machine code
        mass = payload if name == names[-1] else 0.0
        section["arm"] = {**section["arm"], "payload": [mass], "payload_at": [seconds / 2]}
    step = max(math.sqrt(12) * noise_of(found), 1e-9)
    return Family(sections, [FIT], {"encoder": {"step": step}, "command_limits": {}}, max(late))


def _plant(kind: Kind, blocks: Mapping[str, Block], payload: float, seconds: float) -> Block:
    gain = kind.stiffness * np.array(blocks["servo"]["K_D"], dtype=float)
    if kind.cascade:
        servo: Block = {
            "type": "p_pi_servo",
            "k_p": STIFFNESS_P,
            "K_v": rounded(gain),
            "K_i": rounded(STIFFNESS_I * gain),
            "feed_forward": kind.feed_forward,
            "velocity_filter": "2 ms",
            "torque_lag": "1 ms",
        }
    else:
        given = ((name, np.array(blocks["servo"][name], dtype=float)) for name in ("K_D", "K_P", "K_I"))
        servo = {"type": "pid_servo", **{name: rounded(kind.stiffness * value) for name, value in given}}
    friction = ((name, np.array(blocks["arm"][name], dtype=float)) for name in ("viscous", "coulomb"))
    arm = {
        "type": "loaded_manipulator",
        **{name: rounded(kind.friction * value) for name, value in friction},
        "rotor": blocks["arm"]["rotor"],
        "payload": [payload if kind.loaded else 0.0],
        "payload_at": [seconds / 2],
    }
    return {"servo": servo, "arm": arm, "transport_delay": kind.delay}


def rounded(values: Any) -> list[float]:
    """Numbers of `DIGITS` significant digits, for a file."""
    return [float(f"{float(x):.{DIGITS}g}") for x in np.asarray(values, dtype=float)]
