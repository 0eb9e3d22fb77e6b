"""The machine and the software versions of a table."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from tests.benchmarks.peers.cpp_pinocchio import compiler


def describe() -> dict[str, str]:
    """Processor, load, interpreter, and the versions of the packages that dmframe requires."""
    load = f"{os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else "unknown"
    return {
        "machine": f"{processor()}, {os.cpu_count()} cores, {platform.system()}",
        "load when it began": f"{load} (above 0.5, other programs were running too)",
        "compiler": compiler_version(),
        "versions": ", ".join(
            [
                f"Python {platform.python_version()}",
                *(f"{name} {of(name)}" for name in ("dmframe", "casadi", "numpy", "pin")),
            ]
        ),
    }


def of(package: str) -> str:
    """The version of a distribution."""
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


def processor() -> str:
    """Name of the processor, if the system reports one."""
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


def compiler_version() -> str:
    """The first line of the C++ compiler's version."""
    command = compiler()
    if command is None:
        return "none"
    found = subprocess.run([command, "--version"], capture_output=True, text=True, check=False)
    return found.stdout.splitlines()[0] if found.stdout else command


def environment(*, single: bool = True) -> dict[str, str]:
    """Environment of a measured process: the import path of this process, and one thread if it has one core."""
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    one = dict.fromkeys(names, "1")
    one["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
    paths = os.pathsep.join(path for path in sys.path if path)
    return {**os.environ, **(one if single else {}), "PYTHONPATH": paths, "JAX_PLATFORMS": "cpu"}
