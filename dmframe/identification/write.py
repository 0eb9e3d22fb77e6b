"""Folder of an identification: the robot as URDF, a graph of its twin with intervals, and the numbers as JSON."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Final

import numpy as np

from dmframe.catalogue import find_twin
from dmframe.files import write_text, writing
from dmframe.identification.drawn import WHOLE, bodies_of, plain, servo_of
from dmframe.identification.found import Identified
from dmframe.identification.model import Array
from dmframe.identification.page import as_html
from dmframe.identification.robot_file import TOOL, urdf_text

RESULT: Final = "identified.json"
ROBOT: Final = "twin.urdf"
GRAPH: Final = "twin.yaml"
PAGE: Final = "report.html"


def written(found: Identified, folder: Path) -> tuple[Path, ...]:
    """Write the numbers, the page and, for a known servo, the robot and the graph of its twin; returns their paths."""
    with writing(folder, "folder"):
        folder.mkdir(parents=True, exist_ok=True)
    texts = {RESULT: json.dumps({**found.summary, "record": found.record}, indent=2) + "\n"}
    if found.known:
        bodies, _ = bodies_of(found.fit.unknowns, found.number("beta")[0])
        texts |= {ROBOT: urdf_text(found.fit.unknowns.model.chain, bodies), GRAPH: graph_text(found)}
    texts[PAGE] = as_html(found)
    for name, text in texts.items():
        write_text(folder / name, text)
    return tuple(folder / name for name in texts)


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
    blocks["path"]["center"] = plain(log.q[0])
    blocks["servo"] |= {name: plain(value) for name, (value, _) in servo.items()}
    arm = {name: friction[name] for name in ("viscous", "coulomb")}
    _, rotors = bodies_of(found.fit.unknowns, found.number("beta")[0])
    blocks["arm"] |= {name: plain(value) for name, (value, _) in arm.items()} | {"rotor": plain(rotors)}
    blocks["delay"] |= {"samples": int(samples), "share": float(max(0.0, share - WHOLE / 2))}
    if abs(blocks["delay"]["share"]) < WHOLE:
        del blocks["delay"]["share"]
        if not samples:
            del blocks["delay"]
    sticking = friction["sticking"]
    if np.any(sticking[1][:, 0] > 0):
        velocity = float(friction["stribeck_velocity"][0][0])
        blocks["rubbing"] |= {"sticking": plain(sticking[0]), "velocity": velocity}
    else:
        del blocks["rubbing"]
    named = {**{f"servo.{key}": own for key, own in servo.items()}, **{f"arm.{key}": own for key, own in arm.items()}}
    data["uncertain"] = {key: [plain(limits[:, 0]), plain(limits[:, 1])] for key, (_, limits) in named.items()}
    stream = io.StringIO()
    yaml.dump(data, stream)
    return stream.getvalue()


def _servo(found: Identified) -> dict[str, tuple[Array, Array]]:
    """Gains of the servo's block, with limits; those of w are those of the velocity gain."""
    speed = 1 / found.servo["w"][0], 1 / found.servo["w"][1][:, ::-1]
    values, limits = (
        servo_of(found.kind, speed[k], {name: own[k] for name, own in found.servo.items()}) for k in (0, 1)
    )
    return {name: (values[name], limits[name]) for name in values}
