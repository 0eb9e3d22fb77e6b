"""The chain from a certificate to a robot: the files of a folder that name a model, compared with the folder's graph.

Each run, export, page, rehearsal, drive and certificate contains the hash of the model that it was made from
(`Diagram.fingerprint`). `audit` computes that of the graph again and compares. It checks certificates by the
independent checker, digests of sealed folders, the robot's file, and exported C by exporting it again.
"""

from __future__ import annotations

import json
import re
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import Any, Final, final

from dmframe.checker.check import check
from dmframe.common.errors import DmframeError, ValueFault
from dmframe.common.seal import SEAL, faults
from dmframe.config.resolved import robot_source
from dmframe.graph.graph import Graph
from dmframe.graph.load import load

LARGEST: Final = 64 * 2**20
"""Bytes of the largest file that is read."""
HEX: Final = r"[0-9a-f]{64}"
NAMED: Final = re.compile(rf'(?:from model |field_hash"?[=:] ?"?)({HEX})')
TEXTS: Final = (".c", ".h", ".html", ".md", ".xml", ".cpp", ".hpp", ".json")


@final
@dataclass(frozen=True)
class Link:
    """One file of the chain.

    Parameters
    ----------
    file
        Path in the folder.
    kind
        ``graph``, ``certificate``, ``robot``, ``sealed folder``, ``code``, or ``record``.
    model
        Hash of the model that the file names; empty if it names none.
    fault
        What is wrong; empty if nothing is.
    """

    file: str
    kind: str
    model: str
    fault: str = ""


@final
@dataclass(frozen=True)
class Audit:
    """All links, and the model of the folder's graph."""

    folder: Path
    model: str
    links: tuple[Link, ...]

    @property
    def holds(self) -> bool:
        """True if no link is broken."""
        return not any(link.fault for link in self.links)

    @property
    def summary(self) -> dict[str, Any]:
        """JSON data."""
        rows = [{"file": x.file, "kind": x.kind, "model": x.model, "fault": x.fault or None} for x in self.links]
        return {"folder": str(self.folder), "model": self.model, "holds": self.holds, "links": rows}

    def __str__(self) -> str:
        broken = [link for link in self.links if link.fault]
        head = "every link holds" if not broken else f"{len(broken)} of {len(self.links)} links broken"
        wide = max((len(link.file) for link in self.links), default=0)
        lines = [f"{self.folder}: {head}", f"  model {self.model[:12]}"]
        for link in self.links:
            lines.append(f"  {link.file:<{wide}}  {link.kind:<13}  {link.fault or 'holds'}")
        return "\n".join(lines)


def audit(folder: str | Path, *, trust: bool = False) -> Audit:
    """Compare the files of a folder with the model of its graph.

    They are certificates, graphs, robot files, exported code, rehearsals, runs and drives.

    Parameters
    ----------
    folder
        The folder, with at least one graph file.
    trust
        Run the code of blocks in the folder, even if written by others.

    Raises
    ------
    ValueFault
        It is no folder, or contains no graph.
    """
    root = Path(folder)
    if not root.is_dir():
        raise ValueFault(f"audit: expected a folder, found {root}")
    files = sorted((path for path in root.rglob("*") if path.is_file()), key=lambda path: (len(path.parts), path))
    graphs = dict(_graphs(files, trust))
    if not graphs:
        raise ValueFault(f"audit: expected a graph file in {root}, such as graph.yaml; found none")
    model, first = next((found.diagram.fingerprint, path) for path, found in graphs.items())
    links = list[Link]()
    for path, graph in graphs.items():
        own = graph.diagram.fingerprint
        other = "" if own == model else f"another model than that of {first.relative_to(root)}: {own[:12]}"
        links.append(Link(str(path.relative_to(root)), "graph", own, other))
    for path in files:
        if path not in graphs:
            links += _links(root, path, model)
    for path, graph in graphs.items():
        links += _code(root, path, graph)
        links += _robot(root, path, graph)
    return Audit(root, model, tuple(links))


def _graphs(files: Sequence[Path], trust: bool) -> Iterator[tuple[Path, Graph]]:
    for path in files:
        if path.suffix in (".yaml", ".yml") and re.search(rb"^dmframe:\s*\d", _content(path), re.MULTILINE):
            yield path, load(path, trust=trust)


def _content(path: Path) -> bytes:
    return path.read_bytes() if path.stat().st_size <= LARGEST else b""


def _links(root: Path, path: Path, model: str) -> Iterator[Link]:
    name = str(path.relative_to(root))
    if path.name == SEAL:
        yield Link(name, "sealed folder", "", "; ".join(faults(path.parent)))
        return
    if path.suffix not in TEXTS:
        return
    content = _content(path)
    if path.suffix == ".json" and b'"dmframe-certificate"' in content[:200]:
        yield _certificate(name, content, model)
        return
    if path.suffix in (".c", ".h") and (path.parent / "replay.c").is_file() and (path.parent / "graph.yaml").is_file():
        return  # exported code is compared with a new export
    named = {found.decode() for found in re.findall(NAMED.pattern.encode(), content)}
    for hash_ in sorted(named):
        fault = "" if hash_ == model else f"made from another model: {hash_[:12]}"
        yield Link(name, "record", hash_, fault)


def _certificate(name: str, content: bytes, model: str) -> Link:
    """A certificate, checked by the independent checker; its model's hash is a text of the file."""
    try:
        data = json.loads(content)
        own, found = str(data["about"]["model"]), check(data)
    except Exception as error:  # of data that are not a certificate
        return Link(name, "certificate", "", f"refused by the checker: {error}")
    if found["status"] != "re-proved":
        return Link(name, "certificate", "", f"{found['status']} by the checker: {found['reason']}")
    return Link(name, "certificate", own, "" if own == model else f"of another model: {own[:12]}")


def _code(root: Path, path: Path, graph: Graph) -> Iterator[Link]:
    """Exported C next to its graph: it has to be that which the graph exports now."""
    if path.name != "graph.yaml" or not (path.parent / "replay.c").is_file():
        return
    names = [header.stem for header in path.parent.glob("*.h") if header.name != "samples.h"]
    with tempfile.TemporaryDirectory() as place:
        try:
            graph = replace(graph, name=names[0]) if len(names) == 1 else graph
            written = graph.export(Path(place) / "export", "c")
        except DmframeError as error:
            yield Link(str(path.parent.relative_to(root)), "code", "", f"the graph cannot be exported: {error}")
            return
        for new in written:
            old = path.parent / new.name
            if new.suffix in (".c", ".h"):
                same = old.is_file() and old.read_bytes() == new.read_bytes()
                fault = "" if same else "not the code that this release exports from the graph"
                yield Link(str(old.relative_to(root)), "code", graph.diagram.fingerprint, fault)


def _robot(root: Path, path: Path, graph: Graph) -> Iterator[Link]:
    """The robot's file that a record of the same folder names, by its digest."""
    record = path.parent / "provenance.json"
    try:
        known = json.loads(record.read_text("utf-8")).get("urdf_sha256") if record.is_file() else None
    except (ValueError, AttributeError):
        yield Link(str(record.relative_to(root)), "record", "", "expected a JSON object")
        return
    source = robot_source(graph)
    if known and source is not None:
        same = sha256(source.urdf.read_bytes()).hexdigest() == known
        fault = "" if same else f"{source.urdf.name} is not the file that was used: its digest differs"
        yield Link(str(record.relative_to(root)), "robot", "", fault)
