"""Identity of a rehearsal: everything that can change a command, in named parts.

The parts are the resolved graph, the sources of its blocks, the robot's model, the limits, the payload, the times of
the drive, the engine with its compiler, dmframe itself, the numeric libraries, and the resulting closed loop. The
closed loop is that of the loaded diagram and controller, because a file may have changed since it was read. The address
is not a part: the arm and its driver receive the command, and do not alter it.
"""

from __future__ import annotations

import ast
import functools
import hashlib
import importlib.util
import platform
import sys
import sysconfig
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

import numpy as np

from dmframe.build.compiler import FLAGS, LONG, SHARED, find_compiler, processor
from dmframe.catalogue import loaded_digest
from dmframe.common.files import encoded
from dmframe.common.seal import digest
from dmframe.common.version import version as own_version
from dmframe.common.version import version_of
from dmframe.config import BaseGraph
from dmframe.config.resolved import resolved, robot_source
from dmframe.program import CONST, instructions
from dmframe.runtime.controller import control_function, start_function
from dmframe.runtime.gate import Limits
from dmframe.runtime.scaled import ScaledController

Identity = Mapping[str, Mapping[str, str]]
"""Part -> item -> value or digest."""

LOOP: Final = "closed loop"
"""The part that is computed from the others; reported only if none of them changed."""
_LIBRARIES: Final = ("casadi", "numpy", "scipy")


def identity(
    graph: BaseGraph,
    scaled: ScaledController,
    limits: Limits,
    *,
    payload: float,
    ramp: float,
    patience: float | None,
) -> Identity:
    """Compute all parts, in about 0.1 s.

    Parameters
    ----------
    payload
        Mass at the tool in the rehearsal [kg].
    ramp
        Time in which the first motion accelerates [s].
    patience
        Timeout of a sample [s]; None for the driver's.
    """
    files, libraries = _sources(graph)
    return {
        "graph": dict(_flat(resolved(graph.until(1.0)))),
        "block source": files,
        "robot model": _model(graph),
        "limits": {key: str(value) for key, value in limits.data.items()},
        "payload": {"at the tool [kg]": repr(float(payload))},
        "drive": {"ramp [s]": repr(float(ramp)), "patience [s]": "default" if patience is None else repr(patience)},
        "engine": _engine(scaled.controller.engine),
        "dmframe": {"version": own_version(), "source": _framework()},
        "library": {name: _installed(name) for name in sorted({*_LIBRARIES, *libraries})}
        | {"python": platform.python_version()},
        LOOP: _loop(scaled),
    }


def differences(then: Identity, now: Identity) -> list[str]:
    """Descriptions of all items that differ."""
    found, names = list[str](), [name for name in now if name != LOOP]
    for part in [*names, LOOP]:
        before, after = then.get(part, {}), now[part]
        if part == LOOP and found:
            continue
        for item in dict.fromkeys((*before, *after)):
            if before.get(item) != after.get(item):
                found.append(f"{part}: {item}{_values(before.get(item), after.get(item))}")
    return found


def key_of(parts: Identity) -> str:
    """Digest of all parts."""
    lines = [f"{part}\0{item}\0{value}" for part, items in parts.items() for item, value in items.items()]
    return digest(encoded("\n".join(lines)))


def _values(before: str | None, after: str | None) -> str:
    """Both values, if they are short."""
    if before is None or after is None:
        return " is new" if before is None else " is gone"
    if max(len(before), len(after)) > 40:  # a digest or a long list
        return ""
    return f" was {before}, is {after}"


def _flat(value: Any, path: str = "") -> Iterator[tuple[str, str]]:
    if isinstance(value, Mapping) and value:
        for key, item in value.items():
            yield from _flat(item, f"{path}.{key}" if path else str(key))
    else:
        yield path, repr(value)


def _model(graph: BaseGraph) -> dict[str, str]:
    """Digest of the robot's URDF; meshes do not change commands."""
    source = robot_source(graph)
    return {} if source is None else {source.urdf.name: digest(source.urdf.read_bytes())}


def _engine(engine: str) -> dict[str, str]:
    compiler = find_compiler() if engine == "compiled" else None
    if compiler is None:
        return {"kind": engine, "machine": platform.machine()}
    return {
        "kind": engine,
        "compiler": compiler.identity,
        "flags": repr((SHARED, FLAGS, LONG)),
        "processor": processor(),
    }


def _installed(name: str) -> str:
    return version_of(name) or "none"


@functools.cache
def _framework() -> str:
    """Digest of dmframe's Python files, which a development version does not identify."""
    folder, found = Path(__file__).parents[1], hashlib.sha256()
    for path in sorted(folder.rglob("*.py")):
        found.update(encoded(str(path.relative_to(folder))) + b"\0" + hashlib.sha256(path.read_bytes()).digest())
    return found.hexdigest()


def _loop(scaled: ScaledController) -> dict[str, str]:
    """Digests of the loaded diagram and controller."""
    controller = scaled.controller
    diagram = controller.diagram
    begin, _ = start_function(diagram, controller.given)
    numbers = [np.array([controller.clock]), diagram.loop.p_values]
    return {
        "field": diagram.fingerprint,
        "controller": _digest(control_function(diagram)),
        "start": _digest(begin),
        "numbers": digest(b"".join(np.ascontiguousarray(part, dtype=float).tobytes() for part in numbers)),
    }


def _digest(function: Any) -> str:
    lines = (
        f"{code} {read} {written} {constant.hex() if code == CONST else ''}"
        for code, read, written, constant in instructions(function)
    )
    return digest(encoded("\n".join(lines)))


def _sources(graph: BaseGraph) -> tuple[dict[str, str], set[str]]:
    """Digests of the blocks' source files and of the local modules that they import; names of imported libraries.

    Other data that a block reads, such as a table of numbers, changes the part `LOOP`.
    """
    classes = {each for block in graph.blocks.values() for each in type(block).__mro__}
    todo = sorted({each.__module__ for each in classes if each.__module__ in sys.modules})
    own, seen, files, libraries = frozenset(todo), set[str](), dict[str, str](), set[str]()
    while todo:
        name = todo.pop()
        top, file = name.partition(".")[0], _file(name)
        if name in seen or top in sys.stdlib_module_names or top == "dmframe" or file is None:
            continue
        seen.add(name)
        if _is_library(file) and name not in own:
            libraries.add(top)
            continue
        content = file.read_bytes() if file.suffix == ".py" and file.is_file() else b""
        # for a user's file the source that was executed; the file may have changed
        loaded = loaded_digest(sys.modules.get(name))
        files[file.name if loaded else name] = loaded or digest(content)
        todo += _imported(name, content)
    return files, libraries


def _file(name: str) -> Path | None:
    """File of a module, which is not imported."""
    found = getattr(sys.modules.get(name), "__file__", None)
    if name not in sys.modules and "." not in name:
        with suppress(ImportError, ValueError):
            spec = importlib.util.find_spec(name)
            found = spec.origin if spec is not None and spec.has_location else None
    return Path(found) if found else None


def _is_library(path: Path) -> bool:
    """True for a file of an installed package, of this environment or one visible from it (system packages)."""
    installed = any(path.is_relative_to(sysconfig.get_path(kind)) for kind in ("purelib", "platlib"))
    return installed or bool({"site-packages", "dist-packages"} & set(path.parts))


def _imported(name: str, content: bytes) -> Iterator[str]:
    """Modules that a source imports."""
    try:
        tree = ast.parse(content)
    except (SyntaxError, ValueError):
        return
    package = getattr(sys.modules.get(name), "__package__", None) or ""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (item.name for item in node.names)
        elif isinstance(node, ast.ImportFrom):
            with suppress(ImportError, ValueError):
                base = importlib.util.resolve_name("." * node.level + (node.module or ""), package)
                yield from (base, *(f"{base}.{item.name}" for item in node.names))
