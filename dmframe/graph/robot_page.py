"""A robot as a text page and as plain data: joints with limits and masses, tool, known errors of the model."""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Mapping
from typing import Any, Final

from dmframe.common.columns import columns, page_width
from dmframe.common.units import plain
from dmframe.robot.library import RobotSource, find_robot, load

UNITS: Final[Mapping[str, Mapping[str, str]]] = {
    "revolute": {"lower": "rad", "upper": "rad", "velocity": "rad/s", "effort": "N m"},
    "prismatic": {"lower": "m", "upper": "m", "velocity": "m/s", "effort": "N"},
}
SECTIONS: Final = {"source": "", "known_errors": "Known errors"}
"""The parts of a robot's SOURCE.md that are quoted: the text before its first section, and one section."""


def robot_data(name: str) -> dict[str, Any]:
    """A robot as a graph loads it by its name; missing limits are None.

    Raises the errors of `dmframe.robot.library.load`.
    """
    source, chain = find_robot(name), load(name)
    frame = source.tool if isinstance(source.tool, str) else None
    joints = [
        {
            "name": joint.name,
            "kind": joint.kind,
            **{key: value if math.isfinite(value := getattr(joint, key)) else None for key in UNITS[joint.kind]},
            "mass": float(body[0]),
        }
        for joint, body in zip(chain.joints, chain.inertia, strict=True)
    ]
    return {
        "name": chain.name,
        "description": source.description,
        "urdf": str(source.urdf),
        "axes": chain.axes,
        "tool": {"frame": frame, "offset": [float(length) for length in chain.tool]},
        "held": dict(source.hold),
        "joints": joints,
        **_source_facts(source),
    }


def robot_page(name: str) -> str:
    """`robot_data` as text for a terminal."""
    data = robot_data(name)
    offset = ", ".join(f"{length:.4g}" for length in data["tool"]["offset"])
    facts = [
        ("model", data["urdf"]),
        ("task", f"coordinates {data['axes']} of the tool"),
        ("tool", f"{data['tool']['frame'] or 'a point'}, at ({offset}) m in the last joint's frame"),
        ("held", ", ".join(f"{joint} at {plain(angle, 'rad')}" for joint, angle in data["held"].items()) or "no joint"),
        ("mass", f"{plain(sum(joint['mass'] for joint in data['joints']), 'kg')} moves"),
    ]
    heads = ("name", "kind", "lower", "upper", "velocity", "effort", "mass")
    rows = [
        (
            joint["name"],
            joint["kind"],
            *(
                "none" if joint[key] is None else f"{joint[key]:.4g} {unit}"
                for key, unit in UNITS[joint["kind"]].items()
            ),
            f"{joint['mass']:.4g} kg",
        )
        for joint in data["joints"]
    ]
    parts = [
        f"{data['name']}: {data['description']}".rstrip(": "),
        columns(facts),
        f"joints\n{columns([heads, *rows])}",
    ]
    parts += [f"{key.replace('_', ' ')}\n{_wrapped(data[key])}" for key in SECTIONS if data[key]]
    return "\n\n".join(parts)


def _source_facts(source: RobotSource) -> dict[str, str | None]:
    """Texts of a robot's package, by the keys of `SECTIONS`; None for a missing one."""
    file = None if source.folder is None or not source.description else source.folder / "SOURCE.md"
    if file is None or not file.is_file():
        return dict.fromkeys(SECTIONS)
    first, *others = re.split(r"^## (.*)\n", file.read_text(encoding="utf-8"), flags=re.MULTILINE)
    texts = {"": re.sub(r"\A# .*\n", "", first), **dict(zip(others[::2], others[1::2], strict=True))}
    return {key: texts[head].strip().replace("`", "") if head in texts else None for key, head in SECTIONS.items()}


def _wrapped(text: str) -> str:
    """Paragraphs and list items, each wrapped."""
    items = re.split(r"\n\n|\n(?=- )", text)
    return "\n".join(
        textwrap.fill(" ".join(item.split()), page_width(), initial_indent="  ", subsequent_indent="    ")
        for item in items
    )
