"""Detection and call of a C compiler."""

from __future__ import annotations

import hashlib
import importlib.util
import os
import platform
import shlex
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final, final

from dmframe.common.cores import cores
from dmframe.common.errors import ValueFault

NAMES: Final = ("cc", "gcc", "clang")

TUNED: Final = tuple("-O2 -march=native -fno-tree-vectorize -fschedule-insns -fsched-pressure -fno-math-errno".split())
"""Without vectorisation, whose loops stall on values that straight-line code has just stored: 20 % faster."""

LIGHT: Final = ("-O1", "-march=native", "-fexpensive-optimizations", "-fno-math-errno")
"""For long sources: compiled in 60 % of the time, and as fast. As at -O2, products and sums are fused."""

LONG: Final = 20_000
"""Lines above which a source is long."""

FLAGS: Final = (TUNED, LIGHT, ("-O2", "-march=native", "-fno-math-errno"), ("-O2",))
"""Sets of flags: `LIGHT` for long sources and `TUNED` for others, then the rest in order. None reorders sums."""

MOST: Final = 8
"""Largest number of compilers at a time, each of which reads the whole source."""

PIECE: Final = b"\n#if DM_HERE("
"""Beginning of a part of a source that can be compiled apart, see `dmframe.codegen.function.UNITS`."""

PLAIN: Final = ("-std=c99", "-O2", "-ffp-contract=off", "-fno-tree-vectorize", "-fPIC", "-shared")
"""Flags without fused operations; some vectorisers fuse nevertheless."""

SHARED: Final = ("-std=gnu11", "-fPIC", "-shared", "-s", "-w")
LIMIT = 120.0
"""Timeout of the compiler [s]."""


class CompileFailed(Exception):
    """The compiler did not produce a working library; the text is its message, if it has one."""


@final
@dataclass(frozen=True)
class Compiler:
    """Command of a C compiler, and its identity, which differs for another or a newer one."""

    command: tuple[str, ...]
    identity: str

    def build(self, source: Path, library: Path) -> None:
        """Compile one file into a shared library in the same folder, its pieces in parallel.

        Raises `CompileFailed`.
        """
        first_error, text = "", source.read_bytes()
        units = min(cores(), text.count(PIECE), MOST)
        for flags in (FLAGS[text.count(b"\n") > LONG], *FLAGS[2:]):
            error = self._build(source, library, flags, units)
            if not error and library.is_file():
                return
            first_error = first_error or error
        raise CompileFailed(first_error)

    def _build(self, source: Path, library: Path, flags: Sequence[str], units: int) -> str:
        """The first error of a compilation in some units; empty without one."""
        words, linked = [*self.command, *SHARED, *flags], ["-o", library.name, "-lm"]
        if units < 2:
            return self._first_error([[*words, source.name, *linked]], source.parent)
        objects = [f"{source.stem}_{unit}.o" for unit in range(units)]
        calls = [
            [*words, "-c", f"-DDM_UNITS={units}", f"-DDM_UNIT={unit}", source.name, "-o", made]
            for unit, made in enumerate(objects)
        ]
        found = self._first_error(calls, source.parent)
        return found or self._first_error([[*words, *objects, *linked]], source.parent)

    def _first_error(self, calls: Sequence[Sequence[str]], folder: Path) -> str:
        for status, output in _called(calls, folder):
            if status != 0:
                lines = [line for line in output.splitlines() if "error" in line.lower()] or output.splitlines()
                return lines[0].strip() if lines else f"{self.command[0]}: status {status}"
        return ""

    def build_plain(self, sources: Sequence[Path], library: Path, define: str) -> None:
        """Compile files of one folder as C99 without fused operations: the same numbers on every processor."""
        words = [*self.command, *PLAIN, f"-D{define}", *(source.name for source in sources), "-o", library.name, "-lm"]
        ((status, output),) = _called([words], library.parent)
        if status != 0 or not library.is_file():
            raise CompileFailed(output.strip() or f"{self.command[0]}: status {status}")


def _called(calls: Sequence[Sequence[str]], folder: Path) -> list[tuple[int, str]]:
    """Status and error output of compilers that run at the same time; all are killed after the timeout."""
    running = list[subprocess.Popen[str]]()
    try:
        for words in calls:
            try:
                running.append(
                    subprocess.Popen(
                        words,
                        cwd=folder,
                        stdin=subprocess.DEVNULL,
                        stdout=subprocess.DEVNULL,
                        stderr=subprocess.PIPE,
                        text=True,
                        errors="replace",
                        start_new_session=True,
                    )
                )
            except OSError as error:
                raise CompileFailed(f"{words[0]}: {error.strerror}") from None
        end = time.monotonic() + LIMIT
        outputs = [process.communicate(timeout=max(0.0, end - time.monotonic()))[1] for process in running]
    except BaseException as error:  # also Ctrl-C
        for process in running:
            _kill(process)
        if isinstance(error, subprocess.TimeoutExpired):
            raise CompileFailed(f"{calls[0][0]} took more than {LIMIT:g} s, and was stopped") from None
        raise
    return [(process.returncode, output) for process, output in zip(running, outputs, strict=True)]


def _kill(process: subprocess.Popen[str]) -> None:
    """End a compiler and the processes that it started."""
    with suppress(OSError, AttributeError):  # Windows has no process groups
        os.killpg(process.pid, signal.SIGKILL)
    process.kill()
    with process:
        pass


def wanted_compiler() -> list[str]:
    """Words of ``$CC``. Raises `ValueFault` if they are not a command."""
    text = os.environ.get("CC", "")
    try:
        return shlex.split(text)
    except ValueError as error:
        problem = f"expected a command, found an invalid one: {str(error).lower()}"
        raise ValueFault(problem, location=f"CC={text}") from None


def find_compiler() -> Compiler | None:
    """$CC, cc, gcc or clang, else the `ziglang` package; None if there is none."""
    named = wanted_compiler()
    for words in ([named] if named else []) + [[name] for name in NAMES]:
        path = shutil.which(words[0])
        if path is not None:
            return Compiler((path, *words[1:]), _identity(Path(path), words[1:]))
    if importlib.util.find_spec("ziglang") is not None:
        from importlib.metadata import version

        return Compiler((sys.executable, "-m", "ziglang", "cc"), f"ziglang {version('ziglang')}")
    return None


def _identity(path: Path, options: Sequence[str]) -> str:
    """Resolved path, size and modification time, one of which differs for another or a newer compiler."""
    real = path.resolve()
    status = real.stat()
    return f"{real} {status.st_size} {status.st_mtime_ns} {shlex.join(options)}"


def processor() -> str:
    """Hash of the processor's model and instruction sets."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").split("\n\n")[0].splitlines()
    except OSError:
        lines = []
    kept = [line for line in lines if line.split(":")[0].strip() in ("model name", "flags", "Features", "CPU part")]
    known = kept or [platform.processor()]  # which starts a process
    text = "\n".join((platform.system(), platform.machine(), *known))
    return hashlib.sha256(text.encode()).hexdigest()
