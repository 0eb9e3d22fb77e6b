"""The loop in hand-written C++ with Pinocchio's headers, compiled for this machine, run by one call."""

from __future__ import annotations

import ctypes
import hashlib
import importlib.util
import os
import platform
import shutil
import subprocess
from pathlib import Path
from typing import ClassVar

import numpy as np

from tests.benchmarks.controller import STATES
from tests.benchmarks.loop import Array
from tests.benchmarks.peer import Peer

SOURCE = Path(__file__).with_name("loop.cpp")
FLAGS = ("-O3", "-march=native", "-std=c++17", "-DNDEBUG", "-shared", "-fPIC", "-w")
# Pinocchio needs longer type lists than Boost's default.
LISTS = (
    "-DBOOST_MPL_CFG_NO_PREPROCESSED_HEADERS",
    "-DBOOST_MPL_LIMIT_LIST_SIZE=30",
    "-DBOOST_MPL_LIMIT_VECTOR_SIZE=30",
    "-DBOOST_FUSION_INVOKE_MAX_ARITY=10",
)
FRAMES = {(1.0, 0.0, 0.0): 0.0, (0.0, 1.0, 0.0): 1.0, (0.0, 0.0, 1.0): 2.0}


def headers() -> list[Path]:
    """Folders with the headers of Pinocchio, Boost and Eigen; empty if one is missing."""
    spec = importlib.util.find_spec("pinocchio")
    if spec is None or spec.origin is None:
        return []
    include = next((p / "include" for p in Path(spec.origin).parents if (p / "include/pinocchio").is_dir()), None)
    if include is None or not (include / "boost").is_dir():
        return []
    eigen = next((p for p in (include / "eigen3", Path("/usr/include/eigen3")) if p.is_dir()), None)
    return [include, eigen] if eigen else []


def compiler() -> str | None:
    """A C++ compiler."""
    return next((path for name in ("c++", "g++", "clang++") if (path := shutil.which(name))), None)


def numbers(robot: list[dict[str, Array]], loop: Array) -> Array:
    """Links in the format of loop.cpp: axis kind, axis, R, r, m, c, I; then the remaining numbers."""
    rows = [
        np.concatenate(
            [[FRAMES.get(tuple(link["axis"]), 3.0)], link["axis"], link["R"].ravel(), link["r"], link["m"], link["c"],
             link["I"].ravel()]
        )
        for link in robot
    ]  # fmt: skip
    return np.ascontiguousarray(np.concatenate([*rows, loop]))


def library(n: int) -> ctypes.CDLL:
    """loop.cpp, compiled for n joints; cached for the next run, since compilation takes more than a minute."""
    command = compiler()
    if command is None:
        raise RuntimeError("no C++ compiler")
    include = [part for path in headers() for part in ("-isystem", str(path))]
    line = [command, *FLAGS, *LISTS, f"-DJOINTS={n}", *include, str(SOURCE)]
    digest = hashlib.sha256("\0".join([*line, platform.processor(), SOURCE.read_text("utf-8")]).encode()).hexdigest()
    folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "dmframe-benchmarks"
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    file = folder / f"{digest[:32]}.so"
    if not file.exists():
        new = folder / f"{digest[:32]}.{os.getpid()}"
        subprocess.run([*line, "-o", str(new)], check=True)
        new.replace(file)
    return ctypes.CDLL(str(file))


def pointer(array: Array) -> object:
    """For C."""
    return array.ctypes.data_as(ctypes.POINTER(ctypes.c_double))


class Loop(Peer):
    """Sizes fixed at compile time where Pinocchio allows it; no allocation in the loop."""

    title: ClassVar[str] = "C++ on Pinocchio"
    package: ClassVar[str] = "pin"
    module: ClassVar[str] = "pinocchio"
    note: ClassVar[str] = "without more than a minute of compilation; headers of Pinocchio, Boost and Eigen, g++ -O3"

    @classmethod
    def missing(cls) -> str:
        if not headers():
            return "missing: headers of Pinocchio, Boost or Eigen; pip install --group peers"
        return "" if compiler() else "missing: a C++ compiler"

    def build(self) -> None:
        loop = self.loop
        self.library = library(loop.n)
        gain = loop.gains
        self.numbers = numbers(
            loop.links,
            np.concatenate(
                [loop.model.gravity.linear, loop.point, [loop.v_0, loop.T], loop.center, [loop.radius, loop.rate],
                 [float(gain["gamma"])], gain["K_c"], gain["Lambda"], gain["Lambda_P"], gain["Lambda_I"], loop.K_D,
                 loop.K_P, loop.K_I, loop.B, loop.D, *(end for box in loop.boxes.values() for end in box),
                 gain["Gamma"]]
            ),
        )  # fmt: skip
        self.start = np.concatenate([loop.start[name] for name in (*STATES, "q_c", "i", "q", "dq")])

    def run(self, seconds: float) -> Array:
        ticks = self.loop.ticks(seconds)
        q = np.empty((ticks + 1, self.loop.n))
        substeps = self.loop.substeps(self.step)
        self.library.run(pointer(self.numbers), pointer(self.start), ticks, substeps, pointer(q))
        return q

    def calls(self, repeats: int) -> dict[str, float]:
        """Seconds of each of Pinocchio's calls, and of the whole controller step."""
        seconds = np.zeros(5)
        self.library.calls(pointer(self.numbers), pointer(self.start), repeats, pointer(seconds))
        names = ("regressor", "polarised in 5", "polarised in 2", "aba", "controller")
        return dict(zip(names, seconds.tolist(), strict=True))
