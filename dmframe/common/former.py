"""Modules that were at the top of the package: their former paths import the same module, with a notice."""

from __future__ import annotations

import sys
import warnings
from importlib import import_module
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any, Final

FORMER: Final = {
    **dict.fromkeys(
        ("adaptation", "certificate", "condition", "linalg", "naming", "parameter", "port", "steps", "terms"), "block"
    ),
    **dict.fromkeys(("errors", "text", "units"), "common"),
}
"""Former public modules, and the package that each has moved to."""


class FormerModules:
    """Finder and loader of these paths (`sys.meta_path`)."""

    @staticmethod
    def find_spec(name: str, path: object = None, target: object = None) -> ModuleSpec | None:
        """The specification of a former path, else None."""
        package, _, module = name.rpartition(".")
        loader: Any = _Alias()  # no subclass of importlib.abc.Loader, whose import takes a millisecond
        return ModuleSpec(name, loader) if package == "dmframe" and module in FORMER else None


class _Alias:
    def create_module(self, spec: ModuleSpec) -> ModuleType:
        module = spec.name.rpartition(".")[2]
        now = f"dmframe.{FORMER[module]}.{module}"
        warnings.warn(f"{spec.name} is now {now}", DeprecationWarning, stacklevel=2)
        found = import_module(now)
        self._spec = found.__spec__
        return found

    def exec_module(self, module: ModuleType) -> None:
        """The module has run already; the import system replaced its specification by that of the former path."""
        module.__spec__ = self._spec


def accept_former_paths() -> None:
    """Make the former paths importable: ``dmframe.certificate`` gives `dmframe.block.certificate`, and so on."""
    if FormerModules not in sys.meta_path:
        sys.meta_path.append(FormerModules)
