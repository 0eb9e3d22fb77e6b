"""(e): the time to a first result, as whole processes."""

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
OTHERS = {
    "import numpy, casadi": "what any tool on CasADi needs",
    "import numpy, pinocchio": "what any tool on Pinocchio needs",
}
BASE = "import numpy, casadi"


def seconds(code: str, folder: Path, cache: Path) -> float:
    """Of a whole process that runs this code."""
    begin = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=folder,
        env={**environment(), "DMFRAME_CACHE": str(cache)},
        capture_output=True,
        text=True,
        check=False,
    )
    wall = time.perf_counter() - begin
    if done.returncode != 0:
        raise RuntimeError((done.stderr or done.stdout).strip().splitlines()[-1][:200])
    return wall


def section(graph: str = "ur10_fast", told: Callable[[str], None] = lambda text: None) -> Section:
    """Cold and warm cache, and imports."""
    told(f"(e) {graph}, cold and warm")
    code = RUN.format(["run", graph])
    found: dict[str, float] = {}
    with TemporaryDirectory() as place:
        folder, cache = Path(place), Path(place, "cache")
        seconds("import dmframe.cli", folder, cache)  # so that Python's own byte code is there
        cold = [seconds(code, folder, Path(place, f"cold_{k}")) for k in range(REPEATS)]
        seconds(code, folder, cache)
        found[f"dmframe run {graph}, cold cache"] = min(cold)
        found[f"dmframe run {graph}, warm cache"] = min(seconds(code, folder, cache) for _ in range(REPEATS))
        for what in ("import dmframe", "import dmframe.cli", *OTHERS):
            found[what] = min(seconds(what, folder, cache) for _ in range(REPEATS))
    rows = tuple(
        Row("e", name, value, "s", None if name == BASE else found[BASE] / value, note=OTHERS.get(name, ""))
        for name, value in found.items()
    )
    return Section(
        "e",
        f"time to first result, whole processes, the best of {REPEATS}",
        f"the time of `{BASE}`, divided by this time",
        rows,
        ("Cold: no compiled code. Python's own byte code and the disk's pages are there in both cases.",),
    )
