from __future__ import annotations

import gc
import os
from collections.abc import Iterator
from pathlib import Path

import pytest


@pytest.fixture(scope="session", autouse=True)
def _compiled_once(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """One cache of compiled loops for the whole session and all its workers, and never the user's own."""
    base = tmp_path_factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "compiled"
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("DMFRAME_CACHE", str(folder))
        yield folder


def pytest_collection_finish() -> None:
    """Rubbish is looked for less often, and not among what stays: a proof makes 10^5 small things and no rubbish."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(200_000, 20, 20)
