from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from functools import wraps
from pathlib import Path
from typing import Any, ClassVar
from weakref import WeakSet

import pytest

from dmframe.build import library
from dmframe.certify import laws
from dmframe.common.errors import ValueFault
from dmframe.config.graph import BaseGraph
from dmframe.diagram import Diagram
from dmframe.graph.graph import Graph
from dmframe.simulate import Recording, simulate

sys.path.insert(0, str(Path(__file__).parent))  # shared by several folders

Runner = Callable[..., Recording]

GIVEN = set(
    "analysis batch bounds checker cli codegen drawing drive export graph identify page race report results runtime "
    "simulate studio study".split()
)
"""Folders of tests that take diagrams and verdicts as given; those of the others test how these are made."""

_patches = WeakSet[pytest.MonkeyPatch]()


def pytest_runtest_setup(item: pytest.Item) -> None:
    folder = item.path.parent.name
    if folder != _Kept.folder:
        _Kept.forget()
    _Kept.folder, _Kept.given = folder, folder in GIVEN


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_teardown() -> None:
    _Kept.known()  # forgets what was evaluated under a patch


class _Kept:
    """Diagrams of packaged blocks by their content and their verdicts, of one folder, until something is patched."""

    folder, given = "", False
    ours: ClassVar[WeakSet[pytest.MonkeyPatch]] = WeakSet()
    """Patches of the whole session."""
    diagrams: ClassVar[dict[Any, Diagram]] = {}
    results: ClassVar[dict[int, dict[Any, Any]]] = {}
    """By the identity of a diagram that is kept."""

    @classmethod
    def known(cls) -> bool:
        """True if results may be kept: a patch of a class or module makes other ones, and may remain in those kept."""
        if any(
            patch._setattr or any(changed is not os.environ for changed, *_ in patch._setitem)
            for patch in _patches
            if patch not in cls.ours
        ):
            cls.forget()
            return False
        return cls.given

    @classmethod
    def forget(cls) -> None:
        cls.diagrams.clear()
        cls.results.clear()

    @classmethod
    def of(cls, diagram: Diagram, key: Any, make: Callable[[], Any]) -> Any:
        """A result for a diagram, which is kept if the diagram is."""
        found = cls.results.get(id(diagram), {})
        if key not in found:
            found[key] = make()
        return found[key]

    @classmethod
    def diagram(cls, key: Any, make: Callable[[], Diagram]) -> Diagram:
        """A diagram; the one that was used least recently is forgotten for the hundredth."""
        if key in cls.diagrams:
            cls.diagrams[key] = cls.diagrams.pop(key)
            return cls.diagrams[key]
        while len(cls.diagrams) > 100:
            del cls.results[id(cls.diagrams.pop(next(iter(cls.diagrams))))]
        made = cls.diagrams[key] = make()
        cls.results[id(made)] = {}
        return made


@pytest.fixture(scope="session", autouse=True)
def _made_once(_compiled_once: Path, _checked_once: None, _probable_primes: None) -> Iterator[None]:
    """Tests of the `GIVEN` folders share diagrams, verdicts and checks of laws with equal content."""
    build, verdict, check = Diagram.build.__func__, BaseGraph.verdict, laws.check_laws  # type: ignore[attr-defined]

    def kept_build(cls: Any, blocks: Any, wires: Any = None, robot: Any = None) -> Any:
        packaged = all(type(block).__module__.startswith("dmframe_blocks.") for block in blocks.values())
        if not packaged or not _Kept.known():
            return build(cls, blocks, wires, robot)
        own = tuple((name, type(block), repr(block.model_dump())) for name, block in blocks.items())
        key = (own, tuple((wires or {}).items()), robot)
        return _Kept.diagram(key, lambda: build(cls, blocks, wires, robot))

    @wraps(verdict)
    def kept_verdict(graph: BaseGraph, diagram: Diagram | None = None, **given: Any) -> Any:
        if not _Kept.known():
            return verdict(graph, diagram, **given)
        key = repr((sorted(given.items()), graph.start, graph.file.uncertain))
        return _Kept.of(diagram or graph.diagram, ("verdict", key), lambda: verdict(graph, diagram, **given))

    def kept_check(diagram: Diagram) -> tuple[str, ...]:
        if not _Kept.known():
            return check(diagram)
        return _Kept.of(diagram, "laws", lambda: check(diagram))  # type: ignore[no-any-return]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Diagram, "build", classmethod(kept_build))
        patch.setattr(BaseGraph, "verdict", kept_verdict)
        patch.setattr(laws, "check_laws", kept_check)
        _Kept.ours = WeakSet(_patches)
        yield


def _noted(patch: pytest.MonkeyPatch, init: Callable[[pytest.MonkeyPatch], None] = pytest.MonkeyPatch.__init__) -> None:
    init(patch)
    _patches.add(patch)


pytest.MonkeyPatch.__init__ = _noted  # type: ignore[assignment]


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
