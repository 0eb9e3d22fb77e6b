"""Folder of an identification: the robot as URDF, a graph of its twin with intervals, and the numbers as JSON."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any, Final

import numpy as np

from dmframe.catalogue import find_twin
from dmframe.files import write_text, writing
from dmframe.identification.found import Identified
from dmframe.identification.model import Array
from dmframe.identification.robot_file import TOOL, urdf_text

RESULT: Final = "identified.json"
ROBOT: Final = "twin.urdf"
GRAPH: Final = "twin.yaml"
WHOLE: Final = 0.02
"""Deviation from a whole number of samples below which a delay is rounded."""


def written(found: Identified, folder: Path) -> tuple[Path, ...]:
    """Write `identified.json` and, for a known servo, `twin.urdf` and `twin.yaml`; returns their paths."""
    with writing(folder, "folder"):
        folder.mkdir(parents=True, exist_ok=True)
    texts = {RESULT: json.dumps({**found.summary, "record": found.record}, indent=2) + "\n"}
    if found.known:
        bodies, _ = bodies_of(found)
        texts |= {ROBOT: urdf_text(found.fit.unknowns.model.chain, bodies), GRAPH: graph_text(found)}
    for name, text in texts.items():
        write_text(folder / name, text)
    return tuple(folder / name for name in texts)


def bodies_of(found: Identified) -> tuple[Array, Array]:
    """Inertial parameters of the links, (n, 10), and of the rotors, (n,), with the identified base parameters.

    Of all that have them, those are chosen that deviate least from the robot's file, relative to the prior; rotors are
    not negative.
    """
    unknowns = found.fit.unknowns
    model, parameters = unknowns.model, unknowns.model.base.parameters
    values = np.array([0.0 if value is None else float(value) for value in parameters.values])
    beta, root = found.number("beta")[0], unknowns.full
    rotors = parameters.places("rotor")

    def nearest(start: Array, root: Array) -> Array:
        gain = model.grouping @ root
        return np.asarray(start + root @ np.linalg.lstsq(gain, beta - model.grouping @ start, rcond=1e-9)[0])

    start = values.copy()
    start[rotors] = np.maximum(nearest(values, root)[rotors], 0.0)
    fixed = root.copy()
    fixed[rotors] = 0.0
    everything = nearest(start, fixed)
    return everything[parameters.inertial].reshape(model.n, -1), everything[rotors]


def graph_text(found: Identified) -> str:
    """The twin as a graph in which it follows a joint path; its section `uncertain` has the intervals."""
    from ruamel.yaml import YAML

    yaml = YAML()
    yaml.default_flow_style = None
    yaml.width = 140
    data = yaml.load(find_twin(found.kind).read_text(encoding="utf-8"))
    servo, friction = _servo(found), found.friction
    samples, share = divmod(found.delay[0] + WHOLE / 2, 1)
    blocks, log = data["blocks"], found.fit.unknowns.log
    data["title"] = f"Identified {found.fit.unknowns.model.chain.name}, which follows a joint path"
    v_0 = float(friction["friction_velocity"][0][0])
    data["robot"] = {
        "model": ROBOT,
        "tool": TOOL,
        "axes": found.fit.unknowns.model.chain.axes,
        "friction_velocity": v_0,
    }
    data["clock"] = float(round(log.period, 9))
    blocks["path"]["center"] = _plain(log.q[0])
    blocks["servo"] |= {name: _plain(value) for name, (value, _) in servo.items()}
    arm = {name: friction[name] for name in ("viscous", "coulomb")}
    blocks["arm"] |= {name: _plain(value) for name, (value, _) in arm.items()} | {"rotor": _plain(bodies_of(found)[1])}
    blocks["delay"] |= {"samples": int(samples), "share": float(max(0.0, share - WHOLE / 2))}
    if abs(blocks["delay"]["share"]) < WHOLE:
        del blocks["delay"]["share"]
        if not samples:
            del blocks["delay"]
    sticking = friction["sticking"]
    if np.any(sticking[1][:, 0] > 0):
        velocity = float(friction["stribeck_velocity"][0][0])
        blocks["rubbing"] |= {"sticking": _plain(sticking[0]), "velocity": velocity}
    else:
        del blocks["rubbing"]
    named = {**{f"servo.{key}": own for key, own in servo.items()}, **{f"arm.{key}": own for key, own in arm.items()}}
    data["uncertain"] = {key: [_plain(limits[:, 0]), _plain(limits[:, 1])] for key, (_, limits) in named.items()}
    stream = io.StringIO()
    yaml.dump(data, stream)
    return stream.getvalue()


def _servo(found: Identified) -> dict[str, tuple[Array, Array]]:
    """Gains of the servo's block, with limits; those of w are those of the velocity gain."""
    own = found.servo
    speed = 1 / own["w"][0], 1 / own["w"][1][:, ::-1]

    def times(name: str) -> tuple[Array, Array]:
        return own[name][0] * speed[0], own[name][1] * speed[1]

    if found.kind == "pi":
        return {"K_P": speed, "K_I": times("k_I")}
    if found.kind == "pid":
        return {"K_D": speed, "K_P": times("k_P"), "K_I": times("k_I")}
    return {"k_p": own["k_p"], "K_v": speed, "K_i": times("k_i"), "feed_forward": own["f"]}


def _plain(values: Any) -> list[float]:
    return [float(f"{float(x):.9g}") for x in values]
