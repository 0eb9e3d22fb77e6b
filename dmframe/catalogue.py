"""Find block types and packaged graphs in the registered packages and in the user's files.

A package registers itself by an entry point in the group ``dmframe.blocks`` whose value is the package's name. Each of
its public modules defines one block: ``pid_inverse.py`` defines ``PidInverse``, for ``type: pid_inverse``. Its folder
``graphs`` contains graph files.
"""

from __future__ import annotations

import functools
import hashlib
import importlib
import importlib.util
import inspect
import pkgutil
import sys
import traceback
from collections.abc import Callable, Iterator
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import ModuleType
from typing import TypeGuard

from dmframe.block import AbstractBlock
from dmframe.block.reloaded import CODE
from dmframe.common import trust
from dmframe.common.errors import BlockError, UnknownNameError, ValueFault
from dmframe.common.files import ROBOT_FILES, expanded, is_file, probed

GROUP = "dmframe.blocks"
_LOADED = "__dmframe_source__"


def packages() -> Iterator[ModuleType]:
    """The registered block packages. Raises `BlockError` if one cannot be imported, or if there is none."""
    found = {point.value: point for point in _points(tuple(sys.path))}  # an editable install may be listed twice
    if not found:
        raise BlockError(f"no package is registered under the entry-point group {GROUP}; install dmframe first")
    for value, point in sorted(found.items()):
        package = _imported(value, f"the block package {value} ({point.name})")
        if not hasattr(package, "__path__"):
            raise BlockError(f"the entry point {point.name} names {value}; expected a package, found a module")
        yield package


@functools.lru_cache(maxsize=8)
def _points(path: tuple[str, ...]) -> tuple[EntryPoint, ...]:
    """The entry points of the distributions on a path. Reading them takes milliseconds, so they are cached."""
    return tuple(entry_points(group=GROUP))


def _imported(module: str, what: str) -> ModuleType:
    try:
        return importlib.import_module(module)
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # SystemExit included: the message names the package
        raise BlockError(f"{what} cannot be imported: {type(error).__name__}: {error}") from error


def block_modules() -> dict[str, str]:
    """Block types and the modules that define them, ``{"circle": "dmframe_blocks.circle"}``."""
    modules = dict[str, str]()
    for package in packages():
        folders = tuple(package.__path__)
        for module in _listed(folders, tuple(Path(folder).stat().st_mtime_ns for folder in folders)):
            name = f"{package.__name__}.{module}"
            if module in modules:
                raise BlockError(f"two packages hold a block {module}: {modules[module]} and {name}")
            modules[module] = name
    return dict(sorted(modules.items()))


@functools.lru_cache(maxsize=8)
def _listed(folders: tuple[str, ...], changed: tuple[int, ...]) -> tuple[str, ...]:
    """The modules in a package's folders; `changed`, their times of modification, is a part of the cache's key."""
    found = pkgutil.iter_modules(folders)
    return tuple(module.name for module in found if not (module.name.startswith("_") or module.ispkg))


def block_types() -> dict[str, type[AbstractBlock]]:
    """All registered blocks."""
    return {name: _class_of(module, name) for name, module in block_modules().items()}


def find_block(name: str, base: Path | None = None, where: str = "type") -> type[AbstractBlock]:
    """The class of a block type, or of ``file.py:Class`` in the folder of the graph, `base`."""
    file, colon, class_name = name.rpartition(":")
    if colon and file.endswith(".py"):
        return _from_file(base or Path(), file, class_name, where)
    if name.endswith(".py"):
        raise BlockError(f"{where}: expected {name}:MyBlock, a file and a class in it, found the file alone")
    modules = block_modules()
    if name not in modules:
        raise UnknownNameError(f"{where}: {name}", "block type", name, modules)
    return _class_of(modules[name], name)


def _class_of(module_name: str, name: str) -> type[AbstractBlock]:
    module = _imported(module_name, f"the block {name}")
    class_name = "".join(word.capitalize() for word in name.split("_"))
    found = getattr(module, class_name, None)
    if not _is_block(found):
        raise BlockError(f"{module_name}: expected a class {class_name}, the file's name in CamelCase, found none")
    return found


def _is_block(found: object) -> TypeGuard[type[AbstractBlock]]:
    return inspect.isclass(found) and issubclass(found, AbstractBlock) and not inspect.isabstract(found)


def _from_file(base: Path, file: str, class_name: str, where: str) -> type[AbstractBlock]:
    path = base / file
    module = _load(path, trust.read(base, file, where), where)
    found = getattr(module, class_name, None)
    if _is_block(found):
        return found
    if inspect.isclass(found) and issubclass(found, AbstractBlock) and found is not AbstractBlock:
        missing = " and ".join(f"{name}()" for name in sorted(found.__abstractmethods__))
        raise BlockError(f"{where}: {path.name}:{class_name} has no {missing}; add it to the class")
    if found is not None:
        raise BlockError(f"{where}: {path.name}:{class_name} is no block; expected a subclass of AbstractBlock")
    choices = [name for name, item in vars(module).items() if _is_block(item) and item.__module__ == module.__name__]
    raise UnknownNameError(f"{where}: {path.name}:{class_name}", "class", class_name, choices)


def _load(path: Path, source: bytes, where: str) -> ModuleType:
    """A user's file as a module, loaded once; its unique name shadows no other module."""
    digest = hashlib.sha256(str(path.resolve()).encode() + source).hexdigest()[:16]
    name = f"dmframe_file_{path.stem}_{digest}"
    if name in sys.modules:
        return sys.modules[name]
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise BlockError(f"{where}: {path} cannot be read as a Python file")
    module = importlib.util.module_from_spec(spec)
    vars(module)[_LOADED] = hashlib.sha256(source).hexdigest()
    sys.modules[name] = module
    try:
        # not by the loader: it trusts a cached compilation of a file that has the same size and second
        vars(module)[CODE] = compile(source, path, "exec")
        exec(vars(module)[CODE], vars(module))
    except BaseException as error:  # SystemExit included: the message gives the line in the user's file
        del sys.modules[name]
        if isinstance(error, KeyboardInterrupt):
            raise
        frames = traceback.extract_tb(error.__traceback__)
        lines = [frame.lineno for frame in frames if Path(frame.filename).resolve() == path.resolve()]
        line = error.lineno if isinstance(error, SyntaxError) else (lines or [0])[-1]
        message = error.msg if isinstance(error, SyntaxError) else (str(error).splitlines() or [""])[0]
        raise BlockError(f"{where}: {path.name}:{line}: {type(error).__name__}: {message}") from error
    return module


def loaded_digest(module: ModuleType | None) -> str | None:
    """SHA-256 of a user's file as it was executed, even if it has changed since; None for any other module."""
    found = vars(module).get(_LOADED) if module is not None else None
    return found if isinstance(found, str) else None


def _packaged(folder: str, ending: str = ".yaml") -> dict[str, Path]:
    """Files in a folder of the registered packages, by name."""
    found = dict[str, Path]()
    for package in packages():
        for place in package.__path__:
            found |= {path.stem: path for path in sorted(Path(place, folder).glob(f"*{ending}"))}
    return dict(sorted(found.items()))


def graphs() -> dict[str, Path]:
    """Packaged graphs by name."""
    return _packaged("graphs")


def find_graph(name: str) -> Path:
    """The file of a graph: a path, or the name of a packaged one."""
    return _found(name, "graph", graphs)


def races() -> dict[str, Path]:
    """Packaged races of control laws, by name."""
    return _packaged("races")


def find_race(name: str) -> Path:
    """The file of a race: a path, or the name of a packaged one."""
    return _found(name, "race", races)


def _found(name: str, noun: str, packaged: Callable[[], dict[str, Path]]) -> Path:
    path = expanded(name)
    probed(path)
    if path.suffix in (".yaml", ".yml") or (is_file(path) and not name.lower().endswith(ROBOT_FILES)):
        return path
    known = packaged()
    if name in known:
        return known[name]
    from dmframe.robot.library import robots  # takes 0.1 s, and most names are those of graphs

    if name.lower().endswith(ROBOT_FILES) or name in robots():
        raise ValueFault(f"{name}: expected a {noun}, found a robot; `dmframe new {name}` writes a graph of it")
    raise UnknownNameError(name, noun, name, known, others=_hint(name, noun))


def _hint(name: str, noun: str) -> str:
    """The file that was probably meant, or how to list the packaged graphs; empty for other nouns, which are few."""
    files = [f"{name}{ending}" for ending in (".yaml", ".yml") if is_file(expanded(f"{name}{ending}"))]
    if files:
        return f"did you mean {files[0]}?"
    return "`dmframe graphs` lists the packaged ones, and the name of a file ends in .yaml" if noun == "graph" else ""


def find_twin(servo: str) -> Path:
    """The packaged graph of a robot with a servo of a class (pi, pid, p_pi), into which identified numbers are put."""
    known = _packaged("twins")
    if servo not in known:
        raise UnknownNameError(f"twin {servo}", "class of a servo", servo, known)
    return known[servo]


def find_guide(name: str) -> Path:
    """The file of a packaged guide: questions that select a graph."""
    known = _packaged("guides")
    if name not in known:
        raise UnknownNameError(f"guide {name}", "guide", name, known)
    return known[name]


def pages() -> dict[str, Path]:
    """Live pages that were built before, by the names of their graphs."""
    return _packaged("pages", ".html")


def find_page(name: str) -> Path:
    """The file of a live page that was built before."""
    known = pages()
    if name not in known:
        raise UnknownNameError(name, "page", name, known)
    return known[name]


def realities() -> dict[str, Path]:
    """Packaged sets of channel models (delays, noise, limits between controller and robot), by name."""
    return _packaged("realities")


def find_reality(name: str) -> Path:
    """The file of a packaged set of channel models."""
    known = realities()
    if name not in known:
        raise UnknownNameError(f"reality {name}", "set", name, [*known, "none"])
    return known[name]
