"""Cache of the serial chains of robot files.

Reading a URDF file requires the import of Pinocchio, which takes as long as building a loop. An entry contains the
rational numbers of the chain; `SerialChain.model`, which few commands use, is read from the file at its first use.
"""

from __future__ import annotations

import importlib.util
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any, Final

from dmframe import robot as robot_package
from dmframe.common.errors import RobotError
from dmframe.remembered import recorder, store
from dmframe.remembered.inputs import content_of, digest, states_of
from dmframe.robot.chain import Joint, SerialChain
from dmframe.robot.library import find_robot, load

FOLDER: Final = "robots"
_PLAIN: Final = ("name", "axes", "rotation_change", "friction_velocity")
_EXACT: Final = ("tool", "tool_rotation", "inertia", "gravity")


def cached_robot(model: str, base: Path, **given: Any) -> SerialChain:
    """Load a chain as `dmframe.robot.library.load` does, from the cache if nothing changed.

    The key of an entry covers the arguments, the content of the URDF file and of the modules that read it, the versions
    of all installed packages, and the libraries of Pinocchio.
    """
    found, fresh = find_robot(model, base), partial(load, model, base=base, **given)
    place, file = store.folder(), str(found.urdf.absolute())
    with recorder.paused():
        inputs = [("content", file), *_dependencies()] if place is not None and found.urdf.is_file() else []
    if place is None or len(inputs) < 2:  # without Pinocchio, `load` raises the error
        return fresh()
    states = states_of(inputs)
    key = digest(repr((store.FORMAT, sys.version, found, given, states)).encode("utf-8", "surrogateescape"))
    folder = os.path.join(os.path.dirname(place), FOLDER)  # noqa: PTH118, PTH120 - as in `store`
    watching = recorder.current()
    if watching is not None:
        for kind, name in inputs:
            watching.add(kind, name)
    with recorder.paused():
        entry = store.find(folder, key)
    if entry is not None:
        return SerialChain.with_lazy_model(
            _numbers(entry["chain"]), partial(_reload, fresh, file, states["content"][file])
        )
    chain = fresh()
    with recorder.paused():
        store.keep(folder, key, {"chain": _data(chain)})
    return chain


def _reload(fresh: Any, file: str, content: str) -> SerialChain:
    """Load the chain with its model. Raises `RobotError` if the file has changed since."""
    if content_of(file) != content:
        raise RobotError(f"robot {Path(file).name}: the file has changed since it was read; load the graph again")
    chain: SerialChain = fresh()
    return chain


def _dependencies() -> Iterator[tuple[str, str]]:
    """Inputs of a chain other than its file: modules of dmframe, installed packages and libraries of Pinocchio."""
    spec = importlib.util.find_spec("pinocchio")
    if spec is None or spec.origin is None:
        return
    for sources in robot_package.__path__:
        yield from (("content", str(file)) for file in sorted(Path(sources).glob("*.py")))
    yield from (("packages", os.path.abspath(entry)) for entry in sys.path)  # noqa: PTH100 - as in `inputs`
    place = Path(spec.origin).parent
    for folder in (place, *place.parents[1:3]):
        yield from (("library", str(file)) for file in sorted(folder.glob("*pinocchio*.so*")))


def _data(chain: SerialChain) -> dict[str, Any]:
    joints = [{**vars(joint), **{key: _text(vars(joint)[key]) for key in Joint.EXACT}} for joint in chain.joints]
    exact = {key: _text(getattr(chain, key)) for key in _EXACT}
    return {**{key: getattr(chain, key) for key in _PLAIN}, **exact, "joints": joints}


def _numbers(data: Mapping[str, Any]) -> dict[str, Any]:
    joints = tuple(Joint(**{**item, **{key: _read(item[key]) for key in Joint.EXACT}}) for item in data["joints"])
    return {**{key: data[key] for key in _PLAIN}, **{key: _read(data[key]) for key in _EXACT}, "joints": joints}


def _text(value: Any) -> Any:
    """Nested tuples of fractions as nested lists of texts."""
    return str(value) if isinstance(value, Fraction) else [_text(item) for item in value]


def _read(value: str | Sequence[Any]) -> Any:
    return Fraction(value) if isinstance(value, str) else tuple(map(_read, value))
