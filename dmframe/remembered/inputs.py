"""Inputs of a verdict: each by its kind and name, with a text that changes when the input changes.

A command imports this module first; it uses only the parts of the standard library that load quickly.
"""

from __future__ import annotations

import importlib.machinery
import os
import stat
from collections.abc import Callable, Iterable, Mapping
from hashlib import blake2b
from typing import Final

Inputs = Mapping[str, Mapping[str, str]]
"""The states of all inputs, by kind and name."""

ABSENT: Final = "absent"
VOLATILE: Final = ("_",)
"""Environment variables that the shell sets for each command."""
_SUFFIXES: Final = tuple(importlib.machinery.all_suffixes())
_METADATA: Final = (".dist-info", ".egg-info", ".egg", ".pth", ".egg-link")


def digest(content: bytes) -> str:
    """A collision-resistant digest."""
    return blake2b(content, digest_size=20).hexdigest()


def content_of(path: str) -> str:
    """A digest of a file's content."""
    try:
        with open(path, "rb") as file:  # noqa: PTH123 - pathlib takes longer to import than this file to read
            return digest(file.read())
    except OSError:
        return ABSENT


def size_and_time(path: str) -> str:
    """State of a file of an installed library: size and time of modification."""
    try:
        found = os.stat(path)  # noqa: PTH116 - as above
    except OSError:
        return ABSENT
    return f"{found.st_size} {found.st_mtime_ns}"


def names_in(path: str, wanted: Callable[[str], bool] = lambda name: name != "__pycache__") -> str:
    """A digest of the names in a folder."""
    try:
        names = [name for name in os.listdir(path) if wanted(name)]  # noqa: PTH208 - as above
    except OSError:
        return ABSENT
    return digest("\0".join(sorted(names)).encode("utf-8", "surrogateescape"))


def modules_in(path: str) -> str:
    """A digest of the names in a folder that an import can find."""

    def is_module(name: str) -> bool:
        package = os.path.join(path, name, "__init__.py")  # noqa: PTH118 - as above
        return name.endswith(_SUFFIXES) or ("." not in name and os.path.exists(package))  # noqa: PTH110 - as above

    return names_in(path, is_module)


def packages_in(path: str) -> str:
    """A digest of the names in a folder by which installed packages are found."""
    return names_in(path, lambda name: name.endswith(_METADATA))


def is_file(path: str) -> str:
    """Whether there is a file of this name."""
    try:
        return "a file" if stat.S_ISREG(os.stat(path).st_mode) else "no file"  # noqa: PTH116 - as above
    except (OSError, ValueError):
        return "no file"


def variable(name: str) -> str:
    """A digest of an environment variable; of all of them without a name."""
    if name:
        value = os.environ.get(name)
        return ABSENT if value is None else digest(value.encode("utf-8", "surrogateescape"))
    items = sorted((key, value) for key, value in os.environ.items() if key not in VOLATILE)
    return digest(repr(items).encode("utf-8", "surrogateescape"))


STATES: Final[Mapping[str, Callable[[str], str]]] = {
    "content": content_of,
    "library": size_and_time,
    "names": names_in,
    "modules": modules_in,
    "packages": packages_in,
    "probe": is_file,
    "variable": variable,
}
"""The function that computes the state of an input of each kind."""


def states_of(names: Iterable[tuple[str, str]]) -> dict[str, dict[str, str]]:
    """The present states of inputs, given as pairs of kind and name."""
    found = dict[str, dict[str, str]]()
    for kind, name in names:
        found.setdefault(kind, {})[name] = STATES[kind](name)
    return found


def unchanged(inputs: Inputs) -> bool:
    """True if every input has the stored state."""
    return all(STATES[kind](name) == state for kind, states in inputs.items() for name, state in states.items())
