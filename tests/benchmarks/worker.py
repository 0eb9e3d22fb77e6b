"""One measurement in a separate process: ``python -m tests.benchmarks.worker JOB ARGUMENTS-AS-JSON FILE``.

If a tool crashes, hangs or loads a library that conflicts with another one, the table still completes. Each process
uses one core. The result of a job is written to FILE in NumPy's npz format: numbers and one text.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from tests.benchmarks.machine import environment


class Failed(RuntimeError):
    """The process failed, or exceeded its time limit."""


def measure(job: str, limit: float, *, cores: int = 1, **arguments: Any) -> dict[str, Any]:
    """Run ``tests.benchmarks.MODULE:FUNCTION`` in a separate process; return its result, arrays as arrays.

    Parameters
    ----------
    job : "module:function" in this package; a function of keywords that returns names with numbers or arrays
    limit : s, after which the process is stopped
    """
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "found.npz"
        command = [sys.executable, "-m", "tests.benchmarks.worker", job, json.dumps(arguments), str(file), str(cores)]
        try:
            found = subprocess.run(
                command, capture_output=True, text=True, timeout=limit, env=environment(single=cores == 1), check=False
            )
        except subprocess.TimeoutExpired:
            raise Failed(f"no result within {limit:g} s") from None
        if found.returncode != 0 or not file.exists():
            lines = [line for line in found.stderr.strip().splitlines() if line.strip()]
            raise Failed(lines[-1][:200] if lines else f"ended with status {found.returncode}")
        with np.load(file) as data:
            return {key: data[key].item() if data[key].ndim == 0 else data[key] for key in data.files}


def main(job: str, arguments: str, file: str, cores: str) -> None:
    """The part that runs in the separate process."""
    if hasattr(os, "sched_setaffinity"):
        allowed = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, allowed[-int(cores) :] if int(cores) else allowed)
    module, function = job.split(":")
    found = getattr(import_module(f"tests.benchmarks.{module}"), function)(**json.loads(arguments))
    np.savez(file, **found)


if __name__ == "__main__":
    main(*sys.argv[1:])
