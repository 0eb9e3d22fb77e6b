"""The race of a verdict as a file: laws on the best fit and on draws, as `dmframe race` reads it."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from dmframe.catalogue import find_twin
from dmframe.common.errors import MissingError
from dmframe.identification.built import moved
from dmframe.identification.drawn import MOST_SAMPLES, Plant, periods, plain, rubbing_of, thetas, whole
from dmframe.identification.found import Identified
from dmframe.identification.robot_file import TOOL
from dmframe.identification.tool_path import Place, place_of

FILE: Final = "verdict"
"""Name of the packaged race into which the identified numbers are put."""
FIT: Final = "best_fit"
LEAST_CLOCK: Final = 0.008
"""Shortest sampling period of the controllers [s]."""
LONGEST_CLOCK: Final = 0.1
MOST_JOINTS: Final = 3
SERVO: Final = {"pi": "pi_servo", "pid": "pid_servo", "p_pi": "p_pi_servo"}
FORGETTING: Final = 5.0
"""Time constant of the model's forgetting [s]."""
AVERAGE: Final = 0.07
"""Time over which the rows of the model are averaged [s]."""


def not_applicable(found: Identified) -> str:
    """Why there is no verdict for a robot, or an empty text."""
    chain = found.fit.unknowns.model.chain
    if not found.known:
        return "the class of the servo is unknown, so that there is no twin"
    if not found.twin:
        return "no physical bodies have the base parameters, so that there is no twin"
    if chain.n > MOST_JOINTS or chain.n != chain.m:
        return (
            f"the laws are compared for two or three joints and as many coordinates of the tool, found {chain.n} and "
            f"{chain.m}; choose the joints that move and the axes with a graph as ROBOT"
        )
    if any(joint.kind != "revolute" for joint in chain.joints):
        return "the laws are compared for revolute joints"
    try:
        clock_of(found)
    except MissingError as error:
        return error.text
    return ""


def clock_of(found: Identified) -> float:
    """The shortest multiple of the log's period at which the packaged laws and the delay line apply [s].

    Raises
    ------
    MissingError
        There is none.
    """
    period, delay = round(found.fit.unknowns.log.period, 9), found.delay[1][1]
    count = periods(found, LEAST_CLOCK)
    if count * period > LONGEST_CLOCK:
        raise MissingError(
            f"expected a delay below {MOST_SAMPLES:g} samples and a sampling period of at most {LONGEST_CLOCK:g} s, "
            f"found {1000 * delay * period:.3g} ms at {1000 * period:.3g} ms"
        )
    return count * period


def noise_of(found: Identified) -> float:
    """Standard deviation of the positions' noise: that of the log, which a residual may bound more closely [rad]."""
    return min(found.fit.unknowns.log.noise, float(np.min(found.fit.rms)))


def race_text(found: Identified, draws: int, place: Place, seed: int = 0) -> str:
    """The packaged race with the plants, paths, channel and sampling period of an identified robot."""
    unknowns, data = found.fit.unknowns, packaged()
    log, chain, clock = unknowns.log, unknowns.model.chain, clock_of(found)
    plants = [Plant.of(unknowns, found.fit.theta)]
    plants += [Plant.of(unknowns, theta) for theta in moved(found, thetas(found, draws, seed)).T]
    names = [FIT, *(f"draw_{k}" for k in range(1, draws + 1))]
    rubbing = rubbing_of(found)
    data["robot"] = {
        "model": "twin.urdf",
        "tool": TOOL,
        "axes": chain.axes,
        "friction_velocity": plain(found.friction["friction_velocity"][0])[0],
    }
    data["start"], data["clocks"] = {"near": plain(place.q)}, [clock]
    data["plants"] = {
        name: plant.blocks(SERVO[found.kind], rubbing)
        | {"transport_delay": plain([whole(plant.delay * log.period / clock)])[0]}
        for name, plant in zip(names, plants, strict=True)
    }
    for path in data["paths"].values():
        path["radius"] = plain([place.scale * radius for radius in path["radius"]])
        path["center"], path["plane"] = plain(place.center), place.plane
    data["realities"]["log"]["encoder"]["step"] = plain([max(math.sqrt(12) * noise_of(found), 1e-9)])[0]
    late = [plant.delay * log.period / clock for plant in plants]
    for law in data["laws"].values():  # a controller is configured once, so with the delay of the best fit
        law["set"] = {**law.get("set", {}), **dict.fromkeys(law.pop("delay", ()), math.floor(late[0] + 0.5))}
    data["laws"][data["entrant"]]["set"] = settings(clock, max(late))
    return dumped(data)


def settings(clock: float, delay: float) -> dict[str, Any]:
    """Values of the aggregation for a sampling period, by the rules of docs/how_to/experts.md."""
    fast = clock <= LEAST_CLOCK * 1.5
    usual, taps = (6, 14) if fast else (4, 8) if clock <= 0.05 else (3, 4)
    longest = min(max(usual, math.ceil(delay) + 2), 8)
    found: dict[str, Any] = {
        "inverse.retention": float(f"{math.exp(-clock / FORGETTING):.6g}"),
        "inverse.average": max(1, round(AVERAGE / clock)),
        "probe.probe": float(f"{min(0.03, 0.45 * 1.3 * clock):.3g}"),
        "probe.taps": taps + longest - usual,
        "mix.trial": None,  # no square wave on a robot unless its user writes one
        "inverse.inertia_size": 5,
    }
    return found | {f"{block}.delay_up_to": longest for block in ("task", "probe", "inverse", "mix")}


def place_in(found: Identified) -> Place | None:
    """Where the paths of the race lie; None if they do not fit."""
    data, unknowns = packaged(), found.fit.unknowns
    paths: Sequence[Any] = list(data["paths"].values())
    return place_of(unknowns.model.chain, unknowns.log, paths, float(str(data["duration"]).removesuffix(" s")))


def packaged() -> Any:
    """The packaged race, whose plants and paths are filled in."""
    from ruamel.yaml import YAML

    return YAML().load(find_twin(FILE).read_text(encoding="utf-8"))


def dumped(data: Any) -> str:
    """YAML text, in the style of packaged files."""
    from ruamel.yaml import YAML

    yaml, stream = YAML(), io.StringIO()
    yaml.default_flow_style, yaml.width = None, 140
    yaml.dump(data, stream)
    return stream.getvalue()
