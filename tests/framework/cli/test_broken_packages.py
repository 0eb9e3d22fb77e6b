"""Messages of the command line if a package that dmframe needs is missing or broken."""

from __future__ import annotations

import importlib
import subprocess
import sys
from pathlib import Path

import pytest

from dmframe.cli import _unexpected

WITHOUT = """
import sys
sys.modules[{name!r}] = None
from dmframe.cli import main
sys.argv = ["dmframe", "check", "arm2_joint"]
main()
"""


@pytest.mark.parametrize(
    ("name", "package", "reason"),
    [
        ("casadi", "casadi", "dmframe: the package casadi, which dmframe needs, cannot be imported: "),
        ("pinocchio", "pin", "robots need the package pin (Pinocchio), which is not installed"),
        ("ruamel.yaml", "ruamel.yaml", "dmframe: the package ruamel.yaml, which dmframe needs, cannot be imported: "),
    ],
    ids=["casadi-casadi", "pinocchio-pin", "ruamel.yaml-ruamel.yaml"],
)
def test_a_missing_package_is_named_with_the_way_to_install_it(name: str, package: str, reason: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT.format(name=name)], capture_output=True, text=True, check=False, timeout=120
    )
    assert done.returncode == 2
    assert reason in done.stderr
    assert f"; pip install {package}" in done.stderr
    assert "defect" not in done.stderr


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (
            "raise AttributeError('no float_')",
            "h5netcdf, which dmframe needs, cannot be imported: AttributeError: no float_",
        ),
        ("import there_is_no_such", "h5netcdf, which dmframe needs, cannot be imported: No module named 'there_is_no"),
        (
            "def File(): raise TypeError('no mode')",
            "TypeError: no mode; a broken installation of h5netcdf, or a defect of",
        ),
    ],
)
def test_a_broken_package_is_no_defect_of_dmframe_alone(
    text: str, expected: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package = tmp_path / "site-packages" / "h5netcdf"
    package.mkdir(parents=True)
    (package / "__init__.py").write_text(text, encoding="utf-8")
    monkeypatch.delitem(sys.modules, "h5netcdf", raising=False)
    monkeypatch.syspath_prepend(str(package.parent))
    with pytest.raises(Exception) as caught:  # noqa: PT011 - whatever a broken package raises
        importlib.import_module("h5netcdf").File()
    monkeypatch.delitem(sys.modules, "h5netcdf", raising=False)
    assert expected in _unexpected(caught.value)


def test_an_error_of_our_own_is_a_defect_and_no_packages_fault() -> None:
    error = RuntimeError("seeded")
    assert _unexpected(error).endswith("RuntimeError: seeded; a defect of dmframe or of a block, please report it")


def test_a_system_that_fails_without_a_files_name_is_no_defect() -> None:
    assert _unexpected(OSError(5, "Input/output error")) == (
        "the system failed: input/output error; check disks and limits"
    )
