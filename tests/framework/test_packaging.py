"""The distribution as a user gets it: the wheel, built from the sdist, installed next to a folder `blocks/`."""

from __future__ import annotations

import subprocess
import sys
import tarfile
import tomllib
import zipfile
from importlib.metadata import distributions
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGES = {"dmframe": "dmframe", "dmframe_blocks": "blocks/dmframe_blocks", "dmframe_plants": "plants/dmframe_plants"}
COURSE = {"dmframe/lessons/course": "docs/course"}
PROBE = """
import importlib, importlib.metadata as metadata, os, sys
site = os.environ["PYTHONPATH"]
for name in ("dmframe", "dmframe_blocks", "dmframe_plants"):
    module = importlib.import_module(name)
    assert module.__file__.startswith(site + os.sep), module.__file__
distribution, = metadata.distributions(path=[site])
for point in distribution.entry_points:
    if point.group.startswith("dmframe."):
        print(point.group, point.load().__name__)
print(importlib.import_module("dmframe").__version__)
import blocks
print(blocks.__file__)
from dmframe.lessons import lessons
print(*lessons(), lessons()[0].path)
"""


def run(*command: str, cwd: Path, **environment: str) -> str:
    # an isolated environment: no user site, no path of the checkout
    clean = {"PATH": "/usr/bin:/bin", "HOME": str(cwd), "LANG": "C.UTF-8", "PYTHONNOUSERSITE": "1", **environment}
    done = subprocess.run(
        [sys.executable, *command], cwd=cwd, env=clean, check=False, capture_output=True, text=True, timeout=120
    )
    if done.returncode:
        pytest.fail(done.stdout + done.stderr)
    return done.stdout


@pytest.fixture(scope="module")
def sdist(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sdist")
    run("-m", "hatchling", "build", "-t", "sdist", "-d", str(folder), cwd=ROOT)
    (archive,) = folder.glob("*.tar.gz")
    return archive


@pytest.fixture(scope="module")
def wheel(sdist: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    with tarfile.open(sdist) as archive:
        archive.extractall(folder, filter="data")
    (source,) = folder.iterdir()
    run("-m", "hatchling", "build", "-t", "wheel", "-d", str(folder), cwd=source)
    (built,) = folder.glob("*.whl")
    return built


def wanted() -> set[str]:
    """Every file of the three packages and of the course, under its name in the wheel."""
    return {
        f"{name}/{file.relative_to(ROOT / folder).as_posix()}"
        for name, folder in (PACKAGES | COURSE).items()
        for file in (ROOT / folder).rglob("*")
        if file.is_file() and "__pycache__" not in file.parts and file.suffix != ".pyc"
    }


def test_the_wheel_from_the_sdist_holds_every_file_of_the_three_packages_and_nothing_else(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
    assert {f"{name}/py.typed" for name in PACKAGES} <= names
    assert {name for name in names if ".dist-info/" not in name} == wanted()
    assert "dmframe/lessons/course/00_whole_idea.md" in names
    assert any(name.endswith("dist-info/licenses/LICENSE") for name in names)


def test_the_sdist_holds_the_tests_and_the_lock(sdist: Path) -> None:
    with tarfile.open(sdist) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    assert {"requirements.lock", "LICENSE", "README.md", "tests/framework/test_packaging.py"} <= names
    assert not [name for name in names if name.startswith((".venv", ".git/", "dist"))]


def test_the_installed_packages_are_independent_of_a_users_folder_called_blocks(wheel: Path, tmp_path: Path) -> None:
    site = tmp_path / "site"
    options = ("-q", "--no-index", "--no-deps", "--no-compile", "--target", str(site))
    run("-m", "pip", "install", *options, str(wheel), cwd=tmp_path)
    work = tmp_path / "work"
    for name in ("blocks", "plants"):
        (work / name).mkdir(parents=True)
        (work / name / "__init__.py").write_text("")
    lines = run("-c", PROBE, cwd=work, PYTHONPATH=str(site)).splitlines()
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert lines == [
        "dmframe.blocks dmframe_blocks",
        "dmframe.robots dmframe_plants",
        version,
        str(work / "blocks" / "__init__.py"),
        f"{' '.join(map(str, range(11)))} {site / 'dmframe' / 'lessons' / 'course' / '00_whole_idea.md'}",
    ]
    scripts = (site / "bin" / "dmframe").read_text()
    assert "from dmframe.cli import main" in scripts


def test_the_lock_pins_every_package_by_hash_and_names_no_place() -> None:
    lines = (ROOT / "requirements.lock").read_text().splitlines()
    requirements = [line for line in lines if line and not line.startswith((" ", "#"))]
    assert len(requirements) > 30
    assert all("==" in line and line.endswith("\\") for line in requirements)
    assert not [line for line in lines if "://" in line or line.startswith(("-i", "-f", "--"))]


def test_every_dependency_is_locked() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    needed = {text.partition(">=")[0] for text in project["project"]["dependencies"]}
    needed |= {text.partition(">=")[0] for text in project["dependency-groups"]["dev"]}
    lock = (ROOT / "requirements.lock").read_text()
    assert [name for name in needed if f"\n{name.replace('.', '-')}==" not in lock] == []


def test_an_unknown_attribute_of_the_package_is_an_attribute_error() -> None:
    import dmframe

    with pytest.raises(AttributeError, match="module 'dmframe' has no attribute 'versoin'"):
        _ = dmframe.versoin  # type: ignore[attr-defined]


def test_the_head_of_the_metadata_has_the_version_that_importlib_parses() -> None:
    from dmframe.common.version import version_of

    installed = {found.metadata["Name"]: found.version for found in distributions()}
    assert len(installed) > 30
    assert {name: version_of(name) for name in installed} == installed
    assert version_of("no-such-distribution") is None
