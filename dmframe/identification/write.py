"""Folder of an identification: the robot as URDF, a graph of its twin with intervals, and the numbers as JSON."""

from __future__ import annotations

import io
import json
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from dmframe.catalogue import find_twin
from dmframe.common.files import write_text, writing
from dmframe.identification.drawn import Plant, periods, plain, rubbing_of, thetas, whole
from dmframe.identification.found import Identified
from dmframe.identification.model import Array
from dmframe.identification.page import as_html
from dmframe.identification.robot_file import TOOL, urdf_text

RESULT: Final = "identified.json"
ROBOT: Final = "twin.urdf"
GRAPH: Final = "twin.yaml"
ADAPTIVE: Final = "adaptive.yaml"
PAGE: Final = "report.html"
RACE: Final = "verdict.yaml"
VERDICT: Final = "verdict"
PREVIOUS: Final = "previous"
LEAST_FEED_FORWARD: Final = 0.05
"""Least feed-forward of a cascade for which the adaptive law is written: it divides by it."""
DRAWS: Final = 200
"""For the intervals of the graph."""


def written(found: Identified, folder: Path) -> tuple[Path, ...]:
    """Write the numbers, the page and, for a known servo, the robot and the graph of its twin; returns their paths."""
    with writing(folder, "folder"):
        folder.mkdir(parents=True, exist_ok=True)
    stale = not found.known and (folder / ROBOT).exists()  # an unknown servo has no twin
    if stale or _digest(folder) not in ("", found.record.get("sha256")):
        set_aside(folder)
    texts = {RESULT: json.dumps({**found.summary, "record": found.record}, indent=2) + "\n"}
    if found.known:
        texts |= {ROBOT: robot_text(found), GRAPH: graph_text(found)}
        if adaptive := adaptive_text(found):
            texts[ADAPTIVE] = adaptive
        else:
            (folder / ADAPTIVE).unlink(missing_ok=True)
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
        for name in (RESULT, ROBOT, GRAPH, ADAPTIVE, PAGE, RACE, VERDICT):
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
    data = _template(found, found.kind)
    unknowns = found.fit.unknowns
    plant, log, count = Plant.of(unknowns, found.fit.theta), unknowns.log, periods(found)
    blocks, rubbing = data["blocks"], rubbing_of(found)
    data["title"] = f"Identified {unknowns.model.chain.name}, which follows a joint path"
    data["clock"] = float(round(count * log.period, 9))
    samples, share = divmod(whole(plant.delay / count), 1)
    blocks["delay"] |= {"samples": int(samples), "share": share}
    if not share:
        del blocks["delay"]["share"]
        if not samples:
            del blocks["delay"]
    if rubbing:
        blocks["rubbing"] = {"type": blocks["rubbing"]["type"], **plant.rubbing(rubbing)}
    else:
        del blocks["rubbing"]
    return _yaml(_with_numbers(data, found, rubbing))


def adaptive_text(found: Identified) -> str | None:
    """The twin as a graph with an adaptive law in continuous time, whose proof `verify` checks.

    The law has columns of links, rotors and friction. Its boxes contain the identified values. Delay and Stribeck
    friction are left out, since the proof excludes them. None for a cascade without feed-forward, for which there is no
    such law.
    """
    unknowns = found.fit.unknowns
    plant, data = Plant.of(unknowns, found.fit.theta), _template(found, f"adaptive_{found.kind}")
    servo = plant.servo
    if found.kind == "p_pi" and np.min(servo["feed_forward"]) < LEAST_FEED_FORWARD:
        return None
    data["title"] = (
        f"Identified {unknowns.model.chain.name} without delay and Stribeck friction, which follows a joint path with "
        "an adaptive law"
    )
    data["clock"] = float(round(unknowns.log.period, 9))
    data["start"]["q"] = plain(unknowns.log.q[0])
    speed = servo["K_P" if found.kind == "pi" else "K_D" if found.kind == "pid" else "K_v"]
    numbers, inverse = (plant.bodies, plant.rotors, plant.viscous, plant.coulomb), data["blocks"]["inverse"]
    most = 2 * max(float(np.max(np.abs(values))) for values in numbers)
    data["blocks"]["dynamics"]["a_d_hat_box"] = plain([-most, most])
    inverse["w_box"] = plain([0.0, 2 * float(np.max(1 / speed))])
    if found.kind != "pi":
        linear = servo["K_P"] / speed if found.kind == "pid" else servo["k_p"] + servo["K_i"] / speed
        constant = servo["K_I"] / speed if found.kind == "pid" else servo["k_p"] * servo["K_i"] / speed
        least = np.max(np.sqrt(linear**2 / 4 + constant) - linear / 2)  # K_c^2 + k_P K_c - k_I >= 0: M-bar
        inverse["K_c"] = plain([max(1.0, 1.2 * float(least))])[0]
    if found.kind == "p_pi":
        f, position, integral = servo["feed_forward"], servo["k_p"], servo["K_i"] / speed
        inverse["w_box"] = plain([0.0, 2 * float(np.max(1 / (f * speed)))])
        turned = position / f + integral
        ratios = {"w_f": 1 / f, "w_r": turned, "w_c": turned}  # the true w_r would command a jump at the start
        inverse |= {name: plain(own) for name, own in (ratios | {"w_z": position * integral / f}).items()}
    for name, gain in {"pi": {"w_I": "K_I"}, "pid": {"w_P": "K_P", "w_I": "K_I"}}.get(found.kind, {}).items():
        ratio = servo[gain] / speed
        inverse |= {name: plain(ratio), f"{name}_box": plain([0.5 * np.min(ratio), 1.5 * np.max(ratio)])}
    return _yaml(_with_numbers(data, found))


def _template(found: Identified, name: str) -> Any:
    """A packaged graph with the robot and the path of a result."""
    data, unknowns = _reader().load(find_twin(name).read_text(encoding="utf-8")), found.fit.unknowns
    data["robot"] = {
        "model": ROBOT,
        "tool": TOOL,
        "axes": unknowns.model.chain.axes,
        "friction_velocity": float(found.friction["friction_velocity"][0][0]),
    }
    data["blocks"]["path"]["center"] = plain(unknowns.log.q[0])
    return data


def _with_numbers(data: Any, found: Identified, rubbing: Sequence[str] = ()) -> Any:
    """The graph with the identified numbers and their intervals; `rubbing` are the terms of `stribeck_friction`."""
    unknowns = found.fit.unknowns
    named = _numbers(Plant.of(unknowns, found.fit.theta), rubbing)
    for label, value in named.items():
        block, _, name = label.partition(".")
        data["blocks"][block][name] = plain(value)
    drawn = [_numbers(Plant.of(unknowns, theta), rubbing) for theta in thetas(found, DRAWS).T]
    for label, value in named.items():
        spread = 2 * np.std([numbers[label] for numbers in drawn], axis=0)
        if label == "arm.rotor":
            spread = 2 * _rotor_deviation(found)
        data.setdefault("uncertain", {})[label] = [plain(np.maximum(value - spread, 0.0)), plain(value + spread)]
    return data


def _rotor_deviation(found: Identified) -> Array:
    """Standard deviations of the rotors' inertia with the links of the graph, whose inertia is not known apart."""
    unknowns = found.fit.unknowns
    model, parameters = unknowns.model, unknowns.model.base.parameters
    beta = unknowns.numbers(thetas(found, DRAWS), 0.0)[model.places["beta"]]
    root = np.linalg.svd(beta - np.mean(beta, axis=1)[:, None], full_matrices=False)
    size = np.maximum(root.S, 1e-9 * root.S[0]) / np.sqrt(DRAWS)
    white = (root.U / size).T @ model.grouping[:, parameters.places("rotor")]
    return np.asarray(np.sqrt(np.diag(np.linalg.inv(white.T @ white))))


def _reader() -> Any:
    from ruamel.yaml import YAML

    yaml = YAML()
    yaml.default_flow_style, yaml.width = None, 140
    return yaml


def _yaml(data: Any) -> str:
    stream = io.StringIO()
    _reader().dump(data, stream)
    return stream.getvalue()


def _numbers(plant: Plant, rubbing: Sequence[str]) -> dict[str, Array]:
    """Servo gains, friction and rotors by their labels in the graph."""
    arm = {"viscous": plant.viscous, "coulomb": plant.coulomb, "rotor": plant.rotors}
    terms = {"sticking": plant.sticking, "per_torque": plant.per_torque}
    found = {f"servo.{key}": own for key, own in plant.servo.items()} | {f"arm.{key}": own for key, own in arm.items()}
    return found | {f"rubbing.{name}": terms[name] for name in rubbing}
