"""Files shown on a page of the documentation, for tests of the reader's code."""

from __future__ import annotations

import importlib.util
import re
import sys
from pathlib import Path
from types import ModuleType

ROOT = Path(__file__).parents[1]
FILE = re.compile(r"^```python\n# (\w+\.py)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def page_file(page: str, name: str) -> str:
    """Text of the file in a snippet of a page."""
    found = dict(FILE.findall((ROOT / page).read_text(encoding="utf-8")))
    return str(found[name])


def page_module(page: str, name: str, folder: Path) -> ModuleType:
    """That file as a module, written to a folder; it is not added to `sys.modules`."""
    file = folder / name
    file.write_text(page_file(page, name), encoding="utf-8")
    spec = importlib.util.spec_from_file_location(file.stem, file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert file.stem not in sys.modules
    return module
