"""Folder of an identification: the robot as URDF, a graph of its twin with intervals, and the numbers as JSON."""

from __future__ import annotations

import io
import json
import shutil
from pathlib import Path
from typing import Final

import numpy as np

from dmframe.catalogue import find_twin
from dmframe.common.files import write_text, writing
from dmframe.identification.drawn import Plant, periods, plain, thetas, whole
from dmframe.identification.found import Identified
from dmframe.identification.model import Array
from dmframe.identification.page import as_html
from dmframe.identification.robot_file import TOOL, urdf_text

RESULT: Final = "identified.json"
ROBOT: Final = "twin.urdf"
GRAPH: Final = "twin.yaml"
PAGE: Final = "report.html"
RACE: Final = "verdict.yaml"
VERDICT: Final = "verdict"
PREVIOUS: Final = "previous"
DRAWS: Final = 200
"""For the intervals of the graph."""


def written(found: Identified, folder: Path) -> tuple[Path, ...]:
    """Write the numbers, the page and, for a known servo, the robot and the graph of its twin; returns their paths."""
    with writing(folder, "folder"):
        folder.mkdir(parents=True, exist_ok=True)
    if not found.known or _digest(folder) not in ("", found.record.get("sha256")):
        set_aside(folder)
    texts = {RESULT: json.dumps({**found.summary, "record": found.record}, indent=2) + "\n"}
    if found.known:
        texts |= {ROBOT: robot_text(found), GRAPH: graph_text(found)}
    texts[PAGE] = as_html(found)
    for name, text in texts.items():
        write_text(folder / name, text)
    return tuple(folder / name for name in texts)


def set_aside(folder: Path) -> None:
    """Move the files of an earlier identification, and its verdict, to the folder ``previous``.

    They are not of the present log: no twin of another log remains where a program expects that of this one.
    """
    if not (folder / RESULT).is_file():
        return
    with writing(folder, "folder"):
        shutil.rmtree(folder / PREVIOUS, ignore_errors=True)
        (folder / PREVIOUS).mkdir()
        for name in (RESULT, ROBOT, GRAPH, PAGE, RACE, VERDICT):
            if (folder / name).exists():
                (folder / name).rename(folder / PREVIOUS / name)


def _digest(folder: Path) -> str:
    """SHA-256 of the log of an earlier identification; empty if there is none, other if it cannot be read."""
    if not (folder / RESULT).is_file():
        return ""
    try:
        return str(json.loads((folder / RESULT).read_text(encoding="utf-8"))["record"]["sha256"])
    except (OSError, ValueError, KeyError, TypeError):
        return "other"


def robot_text(found: Identified) -> str:
    """The identified robot as URDF."""
    unknowns = found.fit.unknowns
    return urdf_text(unknowns.model.chain, Plant.of(unknowns, found.fit.theta).bodies)


def graph_text(found: Identified) -> str:
    """The twin as a graph in which it follows a joint path; its section `uncertain` has intervals of its numbers.

    They are two standard deviations of draws at the scale of the torques that the robot of the graph has.
    """
    from ruamel.yaml import YAML

    yaml = YAML()
    yaml.default_flow_style, yaml.width = None, 140
    data = yaml.load(find_twin(found.kind).read_text(encoding="utf-8"))
    unknowns = found.fit.unknowns
    plant, log, count = Plant.of(unknowns, found.fit.theta), unknowns.log, periods(found)
    blocks, stribeck = data["blocks"], bool(np.any(found.friction["sticking"][1][:, 0] > 0))
    data["title"] = f"Identified {unknowns.model.chain.name}, which follows a joint path"
    data["robot"] = {
        "model": ROBOT,
        "tool": TOOL,
        "axes": unknowns.model.chain.axes,
        "friction_velocity": float(found.friction["friction_velocity"][0][0]),
    }
    data["clock"] = float(round(count * log.period, 9))
    blocks["path"]["center"] = plain(log.q[0])
    named = _numbers(plant)
    for label, value in named.items():
        block, _, name = label.partition(".")
        blocks[block][name] = plain(value)
    samples, share = divmod(whole(plant.delay / count), 1)
    blocks["delay"] |= {"samples": int(samples), "share": share}
    if not share:
        del blocks["delay"]["share"]
        if not samples:
            del blocks["delay"]
    if stribeck:
        blocks["rubbing"] |= {"sticking": plain(plant.sticking), "velocity": plant.velocity}
    else:
        del blocks["rubbing"]
    drawn = [_numbers(Plant.of(unknowns, theta)) for theta in thetas(found, DRAWS).T]
    for label, value in named.items():
        spread = 2 * np.std([numbers[label] for numbers in drawn], axis=0)
        data.setdefault("uncertain", {})[label] = [plain(np.maximum(value - spread, 0.0)), plain(value + spread)]
    stream = io.StringIO()
    yaml.dump(data, stream)
    return stream.getvalue()


def _numbers(plant: Plant) -> dict[str, Array]:
    """Servo gains, friction and rotors by their labels in the graph."""
    arm = {"viscous": plant.viscous, "coulomb": plant.coulomb, "rotor": plant.rotors}
    return {f"servo.{key}": own for key, own in plant.servo.items()} | {f"arm.{key}": own for key, own in arm.items()}
