"""Former paths of public modules import the same module."""

import subprocess
import sys
from importlib import import_module

import pytest

from dmframe.common.former import FORMER


@pytest.mark.parametrize("module", FORMER)
def test_a_former_path_gives_the_same_module_with_a_notice(module: str) -> None:
    sys.modules.pop(f"dmframe.{module}", None)
    now = f"dmframe.{FORMER[module]}.{module}"
    with pytest.warns(DeprecationWarning, match=f"dmframe.{module} is now {now}"):
        former = import_module(f"dmframe.{module}")
    assert former is import_module(now)
    assert former.__spec__ is not None
    assert former.__spec__.name == now


def test_no_module_of_the_package_has_a_former_path() -> None:
    with pytest.raises(ModuleNotFoundError):
        import_module("dmframe.block.errors")
    with pytest.raises(ModuleNotFoundError):
        import_module("dmframe.nosuch")


def test_a_module_of_block_loads_without_pydantic_and_casadi() -> None:
    code = "import sys, dmframe.block.port; print(*({'pydantic', 'casadi'} & sys.modules.keys()))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []
