from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from dmframe.build import library
from dmframe.common.errors import ValueFault
from dmframe.graph.graph import Graph
from dmframe.simulate import Recording, simulate

sys.path.insert(0, str(Path(__file__).parent))  # shared by several folders

Runner = Callable[..., Recording]


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An empty cache folder, in a process with nothing loaded yet."""
    folder = tmp_path / "cache"
    monkeypatch.setenv("DMFRAME_CACHE", str(folder))
    forget()
    yield folder
    forget()


def forget() -> None:
    """State that a new process does not have."""
    library._kept.clear()
    library._reported.clear()


@pytest.fixture
def pendulum() -> Runner:
    """A short run of the smallest graph."""
    graph = Graph.read("pendulum")
    diagram = graph.diagram

    def run(engine: str = "compiled", **options: object) -> Recording:
        given = {"clock": graph.file.clock, "solver": graph.solver, "start": graph.start} | options
        return simulate(diagram, 0.2, engine=engine, **given)  # type: ignore[arg-type]

    return run


@pytest.fixture(scope="session")
def chromium_tab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """One Chromium for all tests of a worker, since its start takes a second."""
    from in_chromium import chromium

    with chromium(tmp_path_factory.mktemp("profile")) as found:
        yield found


@pytest.fixture
def tab(chromium_tab: Any) -> Any:
    """Its tab, at the size of the window."""
    chromium_tab.sized(None)
    return chromium_tab


@pytest.fixture
def without_v(monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs without V, which takes most of a short run's time; `results/test_storage.py` tests V."""

    def refuse(*_: object) -> None:
        raise ValueFault("V is left out of this test")

    monkeypatch.setattr("dmframe.results.run.storage_of", refuse)
