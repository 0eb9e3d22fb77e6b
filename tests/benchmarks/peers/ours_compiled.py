"""dmframe, with generated C."""

from __future__ import annotations

from typing import ClassVar, Literal

from tests.benchmarks.peers import ours_interpreted


class Loop(ours_interpreted.Loop):
    """The graph itself."""

    title: ClassVar[str] = "dmframe, compiled"
    engine: ClassVar[Literal["interpreted", "compiled"]] = "compiled"

    @classmethod
    def missing(cls) -> str:
        from dmframe.build.compiler import find_compiler

        return "" if find_compiler() else "missing: a C compiler, or the package ziglang"
