"""The table of packages in CONTRIBUTING agrees with the import contract."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[2]


def layers() -> list[set[str]]:
    """The layers of the import contract, the highest first."""
    contracts = tomllib.loads(ROOT.joinpath("pyproject.toml").read_text("utf-8"))["tool"]["importlinter"]["contracts"]
    (contract,) = (item for item in contracts if item["type"] == "layers")
    assert contract["exhaustive"]
    return [set(line.split(" | ")) for line in contract["layers"]]


def rows() -> list[set[str]]:
    """The packages of each row of the table."""
    text = ROOT.joinpath("CONTRIBUTING.md").read_text("utf-8").partition("## Packages\n")[2].partition("\n## ")[0]
    table = [line for line in text.splitlines() if line.startswith("| `")]
    return [set(re.findall(r"`(\w+)`", line.split(" | ")[0])) for line in table]


def test_the_table_of_packages_has_the_order_of_the_import_contract() -> None:
    level = {package: place for place, layer in enumerate(layers()) for package in layer}
    places = [{level[package] for package in row} for row in rows()]
    assert all(len(place) == 1 for place in places)
    order = [min(place) for place in places]
    assert order == sorted(order)


def test_every_package_has_a_row() -> None:
    packages = {path.parent.name for path in ROOT.glob("dmframe/*/__init__.py")}
    modules = {path.stem for path in ROOT.glob("dmframe/*.py")}
    listed = [package for row in rows() for package in row]
    assert sorted(listed) == sorted(packages | set(listed) & modules)
