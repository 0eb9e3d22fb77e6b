"""Source files of blocks: their modules, and imports from block packages or from their own folder."""

from __future__ import annotations

import ast
import hashlib
import importlib.util
import inspect
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import final

from dmframe.block import AbstractBlock
from dmframe.catalogue import packages
from dmframe.common.version import version


@final
@dataclass(frozen=True)
class Module:
    """Python file; the module name is empty for a user's file, which may import from its folder."""

    name: str
    path: Path


@final
class Sources:
    """Digests of the code of blocks; each file is read once, so that all digests are consistent."""

    def __init__(self) -> None:
        self._folders = {package.__name__: [Path(folder) for folder in package.__path__] for package in packages()}
        self._content = cache(Path.read_bytes)
        self._imported = cache(self._modules_imported_by)
        self._version = version()

    def digest(self, kinds: Iterable[type[AbstractBlock]], files: Iterable[Path] = ()) -> str:
        """Digest of the version of dmframe, of the modules of blocks with their imports, and of other files."""
        digest = hashlib.sha256(self._version.encode())
        contents = {(module.name, module.path.name, self._content(module.path)) for module in self.modules(kinds)}
        for name, file, content in sorted(contents | {("", path.name, self._content(path)) for path in files}):
            digest.update(f"\n{name} {file} {len(content)}\n".encode() + content)
        return digest.hexdigest()

    def modules(self, kinds: Iterable[type[AbstractBlock]]) -> set[Module]:
        """Modules of blocks, with their imports from block packages or from their folder."""
        found, left = set[Module](), [module for kind in kinds for module in self._defining(kind)]
        while left:
            if (module := left.pop()) not in found:
                found.add(module)
                left += self._imported(module)
        return found

    def _defining(self, kind: type[AbstractBlock]) -> list[Module]:
        if modules := list(self._packaged(kind.__module__)):
            return modules
        file = inspect.getsourcefile(kind)
        return [Module("", Path(file))] if file is not None and Path(file).is_file() else []

    def _modules_imported_by(self, module: Module) -> list[Module]:
        found = list[Module]()
        for name in _imports(module, self._content(module.path)):
            found += self._packaged(name)
            if not module.name and (path := module.path.with_name(f"{name.partition('.')[0]}.py")).is_file():
                found.append(Module("", path))
        return found

    def _packaged(self, name: str) -> Iterator[Module]:
        """A module of a block package, with the packages around it, whose code runs at its import."""
        for package, folders in self._folders.items():
            inner = f".{name}".removeprefix(f".{package}").split(".")[1:]
            if f"{name}.".startswith(f"{package}."):
                for end in range(len(inner) + 1):
                    places = [folder.joinpath(*inner[:end]) for folder in folders]
                    files = [file for place in places for file in (place / "__init__.py", Path(f"{place}.py"))]
                    yield from (Module(".".join([package, *inner[:end]]), file) for file in files if file.is_file())


def _imports(module: Module, content: bytes) -> Iterator[str]:
    """Names of the modules that a module may import, anywhere in its text."""
    package = module.name if module.path.name == "__init__.py" else module.name.rpartition(".")[0]
    tree = ast.Module([], [])
    with suppress(SyntaxError, ValueError):  # a file that was imported before it was edited
        tree = ast.parse(content)
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and (package or not node.level):
            base = importlib.util.resolve_name("." * node.level + (node.module or ""), package)
            yield from (base, *(f"{base}.{alias.name}" for alias in node.names))
