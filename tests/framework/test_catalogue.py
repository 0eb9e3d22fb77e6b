"""Sources of blocks and graphs: registered packages, a user's own file, and the faults of either."""

from __future__ import annotations

import importlib
import re
import subprocess
import sys
from pathlib import Path

import pytest

from dmframe.catalogue import block_modules, block_types, find_block, find_graph, graphs
from dmframe.common.errors import BlockError, DmframeError, MissingError, UnknownNameError, ValueFault

BLOCK = """\
from typing import ClassVar
from dmframe.block import AbstractBlock, Equations
from dmframe.block.parameter import Scalar, Positive
from dmframe.block.port import Input, Output, State

class {name}(AbstractBlock):
    inputs = (Input("q", "n", "rad"),)
    outputs = (Output("y", "n", "rad"),)
    states = (State("y", "n", "rad"),)
    rate: Scalar = Positive("", "1/s", default=1.0)

    def equations(self, u, x, p):
        return Equations(outputs={{"y": x.y}}, rates={{"y": p.rate * (u.q - x.y)}})
"""


def install(folder: Path, package: str, modules: dict[str, str], value: str = "") -> None:
    """A package with its entry point, in the layout of an installer."""
    (folder / package).mkdir(parents=True)
    (folder / package / "__init__.py").write_text(modules.pop("__init__", ""))
    for name, text in modules.items():
        (folder / package / f"{name}.py").write_text(text)
    info = folder / f"{package}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[dmframe.blocks]\n{package} = {value or package}\n")


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.syspath_prepend(str(tmp_path))
    importlib.invalidate_caches()
    return tmp_path


def complaint(name: str, base: Path | None = None) -> DmframeError:
    with pytest.raises(DmframeError) as caught:
        find_block(name, base)
    return caught.value


def test_a_type_finds_its_class() -> None:
    assert find_block("pid_inverse").__name__ == "PidInverse"
    assert set(block_types()) == set(block_modules())


def test_an_unknown_type_names_the_nearest() -> None:
    found = complaint("pid_invers")
    assert isinstance(found, UnknownNameError)
    assert str(found) == "type: pid_invers: unknown block type; did you mean pid_inverse?"


def test_a_packaged_graph_is_found_by_name_and_a_file_by_its_path() -> None:
    assert find_graph("pendulum") == graphs()["pendulum"]
    assert find_graph("some/own.yaml") == Path("some/own.yaml")
    with pytest.raises(UnknownNameError, match="pendulun: unknown graph; did you mean pendulum"):
        find_graph("pendulun")


@pytest.mark.parametrize("name", ["ur5e", "arm.urdf", "cell/arm.xacro"])
def test_a_robot_where_a_graph_is_expected_names_the_command_that_writes_one(name: str) -> None:
    says = f"{name}: expected a graph, found a robot; `dmframe new {name}` writes a graph of it"
    with pytest.raises(ValueFault, match=f"^{re.escape(says)}$"):
        find_graph(name)


def test_letters_of_another_case_are_the_spelling_of_a_name() -> None:
    with pytest.raises(UnknownNameError, match=r"PENDULUM: unknown graph; did you mean pendulum\?$"):
        find_graph("PENDULUM")


def test_a_graph_without_its_ending_names_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "u2.yaml").touch()
    with pytest.raises(UnknownNameError, match=r"u2: unknown graph; did you mean u2\.yaml\?$"):
        find_graph("u2")


def test_an_installed_package_joins_with_its_blocks_and_graphs(site: Path) -> None:
    install(site, "acme_blocks", {"slow_filter": BLOCK.format(name="SlowFilter"), "_helper": ""})
    (site / "acme_blocks" / "graphs").mkdir()
    (site / "acme_blocks" / "graphs" / "acme.yaml").write_text("dmframe: 1\n")
    assert find_block("slow_filter").__name__ == "SlowFilter"
    assert "_helper" not in block_modules()
    assert "circle" in block_modules()
    assert find_graph("acme") == site / "acme_blocks" / "graphs" / "acme.yaml"


def test_two_packages_with_one_block_are_an_error(site: Path) -> None:
    install(site, "twin_blocks", {"circle": BLOCK.format(name="Circle")})
    assert str(complaint("circle")) == "two packages hold a block circle: dmframe_blocks.circle and twin_blocks.circle"


def test_a_package_listed_twice_counts_once(site: Path) -> None:
    install(site, "twice_blocks", {"thing": BLOCK.format(name="Thing")})
    other = site / "twice_copy-1.0.dist-info"
    other.mkdir()
    (other / "METADATA").write_text("Metadata-Version: 2.1\nName: twice_copy\nVersion: 1.0\n")
    (other / "entry_points.txt").write_text("[dmframe.blocks]\ncopy = twice_blocks\n")
    assert find_block("thing").__name__ == "Thing"


@pytest.mark.parametrize(
    ("package", "modules", "value", "text"),
    [
        ("gone_blocks", {}, "gone_elsewhere", "the block package gone_elsewhere (gone_blocks) cannot be imported: "),
        (
            "sick_blocks",
            {"__init__": "1 / 0"},
            "",
            "the block package sick_blocks (sick_blocks) cannot be imported: Zero",
        ),
        ("flat_blocks", {"inner": ""}, "flat_blocks.inner", "the entry point flat_blocks names flat_blocks.inner; "),
        (
            "bare_blocks",
            {"bare": ""},
            "",
            "bare_blocks.bare: expected a class Bare, the file's name in CamelCase, found none",
        ),
        ("ill_blocks", {"bare": "import nosuchthing"}, "", "the block bare cannot be imported: ModuleNotFoundError: "),
    ],
)
def test_a_bad_package_is_named(package: str, modules: dict[str, str], value: str, text: str, site: Path) -> None:
    install(site, package, dict(modules), value)
    found = complaint("bare")
    assert isinstance(found, BlockError)
    assert str(found).startswith(text)


def test_a_users_file_gives_its_class_and_is_read_again_when_it_changes(tmp_path: Path) -> None:
    file = tmp_path / "my_block.py"
    file.write_text(BLOCK.format(name="Leaky"))
    first = find_block("my_block.py:Leaky", tmp_path)
    assert find_block("my_block.py:Leaky", tmp_path) is first
    file.write_text(BLOCK.format(name="Leaky").replace("1.0", "2.0"))
    assert find_block("my_block.py:Leaky", tmp_path)().rate == 2.0  # type: ignore[attr-defined]


def test_a_users_file_without_a_block_is_refused_with_the_reason(tmp_path: Path) -> None:
    (tmp_path / "own.py").write_text(BLOCK.format(name="Leaky"))
    (tmp_path / "bad.py").write_text("import casadi\n\nx = 1 / 0\n")
    (tmp_path / "odd.py").write_text("def f(:\n")
    assert isinstance(complaint("lost.py:Leaky", tmp_path), MissingError)
    assert str(complaint("own.py:Leeky", tmp_path)) == "type: own.py:Leeky: unknown class; did you mean Leaky?"
    assert str(complaint("own.py", tmp_path)).startswith("type: expected own.py:MyBlock, a file and a class in it")
    assert str(complaint("own.py:Input", tmp_path)).startswith("type: own.py:Input is no block")
    assert str(complaint("bad.py:X", tmp_path)) == "type: bad.py:3: ZeroDivisionError: division by zero"
    assert str(complaint("odd.py:X", tmp_path)) == "type: odd.py:1: SyntaxError: invalid syntax"


def test_folders_named_as_ours_next_to_the_graph_break_nothing(tmp_path: Path) -> None:
    for name in ("blocks", "plants", "tests", "graphs"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text("raise RuntimeError('shadowed')\n")
    code = "import dmframe as dm; print(len(dm.load('pendulum').diagram.blocks))"
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.stdout.strip(), done.stderr) == ("7", "")
