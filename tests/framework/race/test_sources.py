"""Keys of runs: they depend on the code that determines the runs, and on no other code."""

from __future__ import annotations

import importlib
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from dmframe.catalogue import find_block
from dmframe.race import read
from dmframe.race.plan import Race
from dmframe.race.sources import Sources

Make = Callable[..., Race]
LAW = """\
{imports}
from dmframe_blocks.known_tracking import KnownTracking

class {name}(KnownTracking):
    pass
"""
PACKAGE = {
    "__init__": "",
    "first_law": LAW.format(name="FirstLaw", imports="from . import _alone\nfrom ._shared import VALUE"),
    "second_law": LAW.format(name="SecondLaw", imports="import laws_of_tests._shared as shared"),
    "_alone": "def late():\n    from laws_of_tests._deep import VALUE\n    return VALUE\n",
    "_deep": "VALUE = 1\n",
    "_shared": "VALUE = 1\n",
    "_unused": "VALUE = 1\n",
}
FILES = {
    "first_law": PACKAGE["first_law"].replace("from . import", "import").replace("._shared", "shared_of_tests"),
    "second_law": PACKAGE["second_law"].replace("laws_of_tests._shared", "shared_of_tests"),
    "_alone": "def late():\n    import deep_of_tests\n",
    "deep_of_tests": "VALUE = 1\n",
    "shared_of_tests": "VALUE = 1\n",
    "unused_of_tests": "VALUE = 1\n",
}
BOTH = {"first", "second"}


def installed(folder: Path) -> None:
    """A registered package with two laws."""
    place = folder / "laws_of_tests"
    place.mkdir()
    for name, text in PACKAGE.items():
        (place / f"{name}.py").write_text(text)
    info = folder / "laws_of_tests-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: laws_of_tests\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[dmframe.blocks]\nlaws_of_tests = laws_of_tests\n")
    importlib.invalidate_caches()


@pytest.fixture
def edited(race: Make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[bool, str], set[str]]:
    """Edits a module of two laws, in a package or in files, and returns the laws whose keys have changed."""
    installed(tmp_path)
    for name in [name for name in sys.modules if name.startswith("laws_of_tests")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.syspath_prepend(str(tmp_path))
    race()
    graph = (tmp_path / "law.yaml").read_text()

    def keys(types: tuple[str, str]) -> dict[str, set[str]]:
        for law, kind in zip(("first", "second"), types, strict=True):
            (tmp_path / f"{law}.yaml").write_text(graph.replace("known_tracking", kind))
        found = race(("tuned: {graph: law", "tuned: {graph: first"), ("weak:  {graph: law", "weak:  {graph: second"))
        of = {"tuned": "first", "weak": "second"}
        return {of[law]: {found.key(run) for run in found.trials(law, 0.02, found.laws[law, 0.02].own)} for law in of}

    def edit(packaged: bool, module: str) -> set[str]:
        if packaged:
            types, folder = ("first_law", "second_law"), tmp_path / "laws_of_tests"
        else:
            for name, text in FILES.items():
                (tmp_path / f"{name}.py").write_text(text)
            types, folder = ("first_law.py:FirstLaw", "second_law.py:SecondLaw"), tmp_path
        before = keys(types)
        with (folder / f"{module}.py").open("a") as file:
            file.write("# edited\n")
        after = keys(types)
        assert all(before[law] == after[law] or not before[law] & after[law] for law in before)
        return {law for law in before if before[law] != after[law]}

    return edit


CASES = {
    (True, "first_law"): {"first"},
    (True, "_deep"): {"first"},
    (True, "_alone"): {"first"},
    (True, "_shared"): BOTH,
    (True, "__init__"): BOTH,
    (True, "_unused"): set[str](),
    (False, "second_law"): {"second"},
    (False, "deep_of_tests"): {"first"},
    (False, "shared_of_tests"): BOTH,
    (False, "unused_of_tests"): set[str](),
}


@pytest.mark.parametrize("case", CASES, ids=str)
def test_an_edited_module_changes_the_keys_of_the_laws_that_import_it(
    case: tuple[bool, str], edited: Callable[[bool, str], set[str]]
) -> None:
    assert edited(*case) == CASES[case]


@pytest.mark.parametrize("module", ["_deep", "_shared"])
def test_a_digest_without_imported_modules_is_detected(
    module: str, edited: Callable[[bool, str], set[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Sources, "_modules_imported_by", lambda self, of: [])
    assert edited(True, module) != CASES[True, module]


@pytest.mark.parametrize("name", ["sampled_inverse", "expert_aggregation", "loaded_manipulator", "circle"])
def test_the_modules_of_a_block_are_those_that_its_import_loads(name: str) -> None:
    code = f"import sys, dmframe_blocks.{name}; print(*(m for m in sys.modules if m.split('.')[0] == 'dmframe_blocks'))"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert {module.name for module in Sources().modules([find_block(name)])} == set(loaded)


def test_channel_models_and_packaged_sets_decide_the_keys(
    race: Make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = race(("realities: {ideal: {}}", "realities: {ideal: {}, ur: ur}"))
    digest, files = Sources.digest, list[Path]()
    kinds = set[str]()

    def seen(self: Sources, of: object, others: object = ()) -> str:
        kinds.update(kind.__name__ for kind in of)  # type: ignore[attr-defined]
        files.extend(others)  # type: ignore[call-overload]
        return digest(self, of, others)  # type: ignore[arg-type]

    monkeypatch.setattr(Sources, "digest", seen)
    copy = tmp_path / "ur.yaml"
    copy.write_bytes(read.find_reality("ur").read_bytes() + b"# edited\n")
    monkeypatch.setattr(read, "find_reality", lambda name: copy)
    again = race(("realities: {ideal: {}}", "realities: {ideal: {}, ur: ur}"))
    assert {place for place in made.sources if made.sources[place] != again.sources[place]} == {("realities", "ur")}
    assert {"TransportDelay", "CommandGain", "Epicycles", "PiServo", "Manipulator"} <= kinds
    assert files == [copy]
