"""Ours, as generated C."""

from __future__ import annotations

import inspect
import shutil
from typing import ClassVar

from tests.benchmarks.peers import ours_interpreted


class Loop(ours_interpreted.Loop):
    """The graph itself."""

    title: ClassVar[str] = "dmframe, compiled"
    engine: ClassVar[str] = "compiled"

    @classmethod
    def missing(cls) -> str:
        from dmframe.simulate import simulate

        if "engine" not in inspect.signature(simulate).parameters:
            return "missing: this dmframe has one engine only"
        if not any(shutil.which(name) for name in ("cc", "gcc", "clang")):
            return "missing: a C compiler"
        return ""
