"""Files of a study for its folder and for workers on other machines."""

from __future__ import annotations

import atexit
import io
import pickle
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, final

from dmframe.common.files import encoded, write_text, writing
from dmframe.config.document import Document
from dmframe.config.resolved import companions, resolved_text
from dmframe.graph.graph import Graph
from dmframe.study.identity import graphs_of

if TYPE_CHECKING:
    from dmframe.study.plan import Study

GRAPH: Final = "graph.yaml"


def write_graph(graph: Graph, path: Path) -> None:
    """Write a graph, and the files that it names into the same folder. Raises `OutputError`."""
    write_text(path, graph.text)
    for name, source in companions(graph).items():
        target = path.with_name(name)
        if source.resolve() != target.resolve():
            with writing(target):
                shutil.copyfile(source, target)


def folder_files(study: Study) -> dict[str, bytes]:
    """Contents, by name, of the files that make a study's folder self-contained.

    These are the study, its graph with all defaults, and graphs, blocks and robots that it names by path.
    """
    text, found = study.text, {GRAPH: encoded(resolved_text(study.bases[""]))}
    for key, graph in study.bases.items():
        name, path = Path(key or study.file.graph), Path(graph.document.name)
        if name.suffix not in (".yaml", ".yml") or name.is_absolute():
            continue
        if ".." in name.parts:  # outside of the folder
            text = text.replace(str(name), str(path.resolve()))
            continue
        found[str(name)] = path.read_bytes()
    for graph in graphs_of(study):
        base = Path(graph.document.name).parent
        place = next(
            (Path(key or study.file.graph).parent for key, each in study.bases.items() if _base(each) == base), Path()
        )
        if place.is_absolute():
            continue
        for inner, path in _own(graph):
            found[str(place / inner)] = path.read_bytes()
    return {**found, "study.yaml": encoded(text)}


def _base(graph: Graph) -> Path:
    return Path(graph.document.name).parent


def _own(graph: Graph) -> Iterator[tuple[Path, Path]]:
    """Files that a graph names in its own folder or below: relative and absolute paths."""
    base = _base(graph).resolve()
    for path in companions(graph).values():
        if path.resolve().is_relative_to(base):
            yield path.resolve().relative_to(base), path


@final
@dataclass(frozen=True)
class Parcel:
    """A pickled study with the contents of the files that its graphs name, by folder number and path in the folder."""

    study: bytes
    files: Mapping[tuple[int, str], bytes]


@final
class _Packer(pickle.Pickler):
    """Pickler that numbers the folders of the graphs."""

    def __init__(self, file: io.BytesIO) -> None:
        super().__init__(file, protocol=pickle.HIGHEST_PROTOCOL)
        self.folders = dict[Path, int]()

    def reducer_override(self, value: Any) -> Any:
        if isinstance(value, Graph):
            number = self.folders.setdefault(_base(value), len(self.folders))
            return _placed, (number, value.document, value.name, value.overrides)
        return NotImplemented


def packed(study: Study) -> bytes:
    """A study with the files that its graphs name, for `unpacked` on any machine."""
    stream = io.BytesIO()
    packer = _Packer(stream)
    packer.dump(study)
    files = dict[tuple[int, str], bytes]()
    for graph in graphs_of(study):
        number = packer.folders.setdefault(_base(graph), len(packer.folders))
        files |= {(number, str(inner)): path.read_bytes() for inner, path in _own(graph)}
    return pickle.dumps(Parcel(stream.getvalue(), files), protocol=pickle.HIGHEST_PROTOCOL)


def unpacked(content: bytes) -> Study:
    """The study of a parcel; its files are in a temporary folder until this process ends."""
    global _root
    parcel: Parcel = pickle.loads(content)
    _root = Path(tempfile.mkdtemp(prefix="dmframe-study-"))
    atexit.register(shutil.rmtree, _root, ignore_errors=True)
    for (number, name), data in parcel.files.items():
        place = _root / str(number) / name
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(data)
    found: Study = pickle.loads(parcel.study)
    return found


_root = Path()
"""Folder of the parcel that is being unpacked; a worker unpacks one at a time."""


def _placed(number: int, document: Document, name: str, overrides: tuple[str, ...]) -> Graph:
    """A graph of a parcel."""
    place = _root / str(number) / Path(document.name).name
    return replace(Graph.of(replace(document, name=str(place))), name=name, overrides=overrides)
