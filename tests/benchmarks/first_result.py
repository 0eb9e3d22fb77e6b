"""(e): the time to a first result, each measured in a separate process."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.benchmarks.machine import environment
from tests.benchmarks.table import Row, Section

REPEATS = 3
RUN = "import sys; from dmframe.cli import main; sys.argv[1:] = {!r}; sys.exit(main())"
BASE = "import numpy, casadi"
OTHERS = {BASE: "what any tool on CasADi needs", "import numpy, pinocchio": "what any tool on Pinocchio needs"}
FIRST, WHOLE = "first numbers", "all files and figures written"


def seconds(code: str, folder: Path, cache: Path, word: str = "") -> tuple[float, float]:
    """Seconds until a process with this code prints a line that begins with `word`, and until its end."""
    begin, first = time.perf_counter(), float("nan")
    with subprocess.Popen(
        [sys.executable, "-c", code],
        cwd=folder,
        env={**environment(), "DMFRAME_CACHE": str(cache), "PYTHONDONTWRITEBYTECODE": ""},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    ) as process:
        assert process.stdout is not None
        line = ""
        for line in process.stdout:
            if word and line.startswith(word) and first != first:
                first = time.perf_counter() - begin
    whole = time.perf_counter() - begin
    if process.returncode != 0:
        raise RuntimeError(line.strip()[:200])
    return first, whole


def section(graph: str = "ur10_fast", progress: Callable[[str], None] = lambda text: None) -> Section:
    """Cold and warm cache, and imports."""
    progress(f"(e) {graph}, cold and warm")
    code = RUN.format(["run", graph])
    found: dict[str, float] = {}
    with TemporaryDirectory() as place:
        folder, cache = Path(place), Path(place, "cache")
        seconds(code, folder, cache)  # so that Python's bytecode exists
        caches = {"cold": [Path(place, f"cold_{k}") for k in range(REPEATS)], "warm": [cache] * REPEATS}
        for state, places in caches.items():
            first, whole = zip(*(seconds(code, folder, each, graph) for each in places), strict=True)
            found[f"dmframe run {graph}, {state} cache: {FIRST}"] = min(first)
            found[f"dmframe run {graph}, {state} cache: {WHOLE}"] = min(whole)
        for what in ("import dmframe", "import dmframe.cli", "import dmframe.cli.run", *OTHERS):
            found[what] = min(seconds(what, folder, cache)[1] for _ in range(REPEATS))
    rows = tuple(
        Row("e", name, value, "s", None if name in OTHERS else found[BASE] / value, note=OTHERS.get(name, ""))
        for name, value in found.items()
    )
    return Section(
        "e",
        f"time to first result, from the start of a process, the best of {REPEATS}",
        f"the time of `{BASE}`, divided by this time",
        rows,
        ("Cold: no compiled code. Python's own byte code and the disk's pages are there in both cases.",),
    )
