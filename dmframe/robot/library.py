"""Robots of installed packages by name, and URDF files by path.

A package registers robots through the entry-point group `dmframe.robots`, whose value is the package's name: each of
its folders with a `robot.toml` is a robot of the folder's name.
"""

from __future__ import annotations

import functools
import sys
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import metadata, util
from pathlib import Path
from typing import Any, final

from dmframe.common.errors import RobotError, UnknownNameError, ValueFault
from dmframe.common.files import probed
from dmframe.robot.chain import SerialChain

GROUP = "dmframe.robots"
KEYS = ("description", "urdf", "tool", "axes", "free", "hold")
MODEL_PATH = ("robot", "model")


@final
@dataclass(frozen=True)
class RobotSource:
    """Location of a robot's model, and its defaults.

    `tool`, `axes`, `free` and `hold` (rad) are the defaults of :meth:`dmframe.robot.chain.SerialChain.from_urdf`.
    """

    name: str
    urdf: Path
    tool: str | tuple[float, ...] | None = None
    axes: str = "xyz"
    free: tuple[str, ...] | None = None
    hold: Mapping[str, float] = field(default_factory=dict)
    description: str = ""
    folder: Path | None = None


def robots() -> dict[str, RobotSource]:
    """Packaged robots by name, in alphabetical order.

    Raises
    ------
    RobotError
        A registered package is missing, a `robot.toml` is invalid, or two robots have the same name.
    """
    found: dict[str, RobotSource] = {}
    for entry in sorted(set(_points(tuple(sys.path))), key=lambda entry: entry.value):
        spec = util.find_spec(entry.value)
        if spec is None or not spec.submodule_search_locations:
            raise RobotError(f"robots of {entry.value}: expected an installed package, found none")
        for folder in map(Path, spec.submodule_search_locations):
            for source in robots_in(folder):
                if source.name in found:
                    raise RobotError(
                        f"robot {source.name}: defined twice, in {found[source.name].folder} and {source.folder}"
                    )
                found[source.name] = source
    return dict(sorted(found.items()))


@functools.lru_cache(maxsize=8)
def _points(path: tuple[str, ...]) -> tuple[metadata.EntryPoint, ...]:
    """Entry points of the packages on a path; cached, since reading them takes milliseconds."""
    return tuple(metadata.entry_points(group=GROUP))


def robots_in(folder: Path) -> list[RobotSource]:
    """Robots of one package folder.

    Raises
    ------
    RobotError
        A `robot.toml` cannot be read, or has unexpected keys or types.
    """
    return [_source_of(file) for file in sorted(folder.glob("*/robot.toml"))]


def _source_of(file: Path) -> RobotSource:
    """Robot of a file, read once per version of the file."""
    try:
        status = file.stat()
    except OSError:  # reported by the reader
        return _read_source(file)
    return _read_version(file, status.st_mtime_ns, status.st_size)


@functools.lru_cache(maxsize=256)
def _read_version(file: Path, changed: int, size: int) -> RobotSource:
    return _read_source(file)


def find_robot(name_or_path: str, base: Path | None = None) -> RobotSource:
    """Find a packaged robot by name, or a URDF file by a path that ends in `.urdf`.

    Parameters
    ----------
    name_or_path : "ur10", or "my_arm.urdf" relative to `base`, else to the current folder
    base : the graph's folder

    Raises
    ------
    UnknownNameError
        There is no robot of that name.
    """
    if name_or_path.endswith(".urdf"):
        path = Path(name_or_path).expanduser()
        local = (base or Path()) / path
        probed(local)
        path = local if local.is_file() else path
        return RobotSource(name=path.stem, urdf=path, folder=path.parent)
    known = robots()
    if name_or_path.endswith((".yaml", ".yml")):
        text = f"robot {name_or_path}: expected the name or the file of a robot, found a graph; name its robot"
        raise ValueFault(text, path=MODEL_PATH)
    if name_or_path not in known:
        # no suggestion: another robot is not a misspelling of this one
        raise UnknownNameError(f"robot {name_or_path}", "robot", name_or_path, known, path=MODEL_PATH, spelling=False)
    return known[name_or_path]


def load(
    name_or_path: str,
    *,
    base: Path | None = None,
    free: Sequence[str] | None = None,
    hold: Mapping[str, float] | None = None,
    tool: str | Sequence[float] | None = None,
    axes: str | None = None,
    friction_velocity: float = 0.005,
) -> SerialChain:
    """Chain of a robot by name or path; arguments override the robot's defaults.

    A joint in `free` is removed from the default `hold`, and a joint in `hold` (rad) from the default `free`.

    Raises
    ------
    UnknownNameError, RobotError, MissingError, ValueFault
        See :func:`find_robot` and :meth:`dmframe.robot.chain.SerialChain.from_model`.
    """
    source = find_robot(name_or_path, base)
    held = {joint: angle for joint, angle in source.hold.items() if joint not in (free or ())} | dict(hold or {})
    if free is None and source.free is not None:
        free = [joint for joint in source.free if joint not in (hold or {})]
    return SerialChain.from_urdf(
        source.urdf,
        free=free,
        hold=held,
        tool=source.tool if tool is None else tool,
        axes=axes or source.axes,
        name=source.name,
        friction_velocity=friction_velocity,
    )


def _read_source(file: Path) -> RobotSource:
    name = file.parent.name
    where = f"robot {name}: {file.name}"
    try:
        data = tomllib.loads(file.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as fault:
        raise RobotError(f"{where}: expected a readable TOML file: {fault}") from None
    for key in data:
        if key not in KEYS:
            raise UnknownNameError(f"{where}: {key}", "key", key, KEYS)
    return RobotSource(
        name=name,
        urdf=file.parent / _text(data, "urdf", where),
        tool=_text(data, "tool", where) if "tool" in data else None,
        axes=_text(data, "axes", where) if "axes" in data else "xyz",
        free=_names(data["free"], where) if "free" in data else None,
        hold=_hold(data.get("hold", {}), where),
        description=_text(data, "description", where),
        folder=file.parent,
    )


def _text(data: Mapping[str, Any], key: str, where: str) -> str:
    value = data.get(key)
    if not isinstance(value, str) or not value:
        raise RobotError(f"{where}: expected a text as {key}, found {value!r}")
    return value


def _names(value: Any, where: str) -> tuple[str, ...]:
    if not isinstance(value, list) or not all(isinstance(name, str) for name in value):
        raise RobotError(f"{where}: expected free as a list of joint names, found {value!r}")
    return tuple(value)


def _hold(table: Any, where: str) -> dict[str, float]:
    if not isinstance(table, dict) or not all(isinstance(angle, int | float) for angle in table.values()):
        raise RobotError(f"{where}: expected hold as a table of joint = angle in rad, found {table!r}")
    return {joint: float(angle) for joint, angle in table.items()}
