"""``dmframe audit DIR``: each broken link of a folder is named."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import dmframe as dm
from dmframe.certify.published import certificate_text


@pytest.fixture(scope="module")
def chain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a graph, a certificate, exported C and a run."""
    folder = tmp_path_factory.mktemp("chain")
    graph = dm.load("pendulum").set({"clock": "2 ms"})
    graph.export(folder / "code", "c")
    (folder / "graph.yaml").write_bytes((folder / "code" / "graph.yaml").read_bytes())
    found = graph.verify()
    about = {"graph": "pendulum", "model": graph.diagram.fingerprint}
    (folder / "certificate.json").write_text(certificate_text(found.verdict, about))
    graph.run(until="0.1 s").save(folder / "run")
    return folder


def _certificate(folder: Path) -> None:
    path = folder / "certificate.json"
    data = json.loads(path.read_text())
    (gain,) = (item for item in data["symbols"] if item["label"] == "inverse.Lambda")
    gain["numbers"] = [["-1", "-1"]]
    path.write_text(json.dumps(data))


def _other_model(folder: Path) -> None:
    path = folder / "certificate.json"
    data = json.loads(path.read_text())
    data["about"]["model"] = "0" * 64
    path.write_text(json.dumps(data))


def _edited(name: str) -> Callable[[Path], None]:
    def edit(folder: Path) -> None:
        path = folder / name
        path.write_text(path.read_text().replace("0", "1", 1))

    return edit


@pytest.mark.parametrize(
    ("broken", "says"),
    [
        (_certificate, "refuted by the checker: "),
        (_other_model, "of another model: 000000000000"),
        (_edited("code/pendulum.c"), "not the code that this release exports from the graph"),
        (_edited("run/summary.json"), "summary.json was changed: its digest does not match"),
    ],
)
def test_a_broken_link_is_named(
    dmframe: Any, chain: Path, tmp_path: Path, broken: Callable[[Path], None], says: str
) -> None:
    shutil.copytree(chain, tmp_path / "chain")
    broken(tmp_path / "chain")
    said = dmframe("audit", "chain")
    assert said.status == 1
    assert says in said.out
    assert "1 of " in said.out


def test_a_whole_chain_holds_and_a_folder_without_a_graph_is_an_error(
    dmframe: Any, chain: Path, tmp_path: Path
) -> None:
    said = dmframe("audit", str(chain), "--json")
    assert said.status == 0, said.out
    found = json.loads(said.out)
    assert found["holds"]
    assert {link["kind"] for link in found["links"]} >= {"graph", "certificate", "code", "sealed folder", "record"}
    (tmp_path / "empty").mkdir()
    assert "expected a graph file in" in dmframe("audit", "empty").err
    assert "expected a folder" in dmframe("audit", "none").err
