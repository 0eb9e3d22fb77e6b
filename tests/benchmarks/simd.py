"""(h): runs in SIMD batches on one core, compared with the peak rate of the processor."""

from __future__ import annotations

import ctypes
import os
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from tests.benchmarks.machine import of
from tests.benchmarks.table import Row, Section
from tests.benchmarks.worker import Failed, measure

GRAPHS = ("ur10_fast", "ur10_full")
WIDTHS = {1: "", 2: "-mno-avx", 4: "-mno-avx512f", 8: ""}
"""Runs at once, and the compiler option that limits registers to that size."""

SECONDS = 20.0
"""Simulated time of each run: figures are accumulated over 2500 samples."""

SINE, TANH = 52, 46
"""Operations of a sine with its cosine and of a tanh, as in arithmetic.h."""

PEAK = """
typedef double real __attribute__((vector_size(64)));
void peak(long rounds, double *out) {
  real a[12], b, c;
  for (int i = 0; i < 8; i++) b[i] = out[0], c[i] = out[1];
  for (int k = 0; k < 12; k++) a[k] = b + k;
  for (long n = 0; n < rounds; n++)
    for (int k = 0; k < 12; k++) a[k] = a[k] * b + c;
  for (int k = 0; k < 12; k++) for (int i = 0; i < 8; i++) out[2] += a[k][i];
}
"""
"""Multiply-adds of full vectors, twelve of them independent: the peak rate of a processor in double precision."""


def timed(graph: str, width: int) -> dict[str, Any]:
    """Simulated seconds per second on one core, operations per simulated second, and the peak rate per second."""
    import dmframe as dm

    if width == 1:
        loaded = dm.load(graph).until(SECONDS)
        loaded.run(engine="compiled")
        best = min(loaded.run(engine="compiled").recording.wall_time for _ in range(5))
        return {"rate": SECONDS / best}
    from dmframe.batch.batch import Batch

    os.environ["CC"] = f"cc {WIDTHS[width]}".strip()
    loaded = dm.load(graph)
    batch = Batch.of(loaded.diagram, SECONDS, engine="compiled", **loaded.settings)
    runs = 8 * width
    block = next(name for name, held in loaded.blocks.items() if hasattr(held, "Gamma"))
    values = {f"{block}.Gamma": np.linspace(0.9, 1.1, runs)}
    found = batch.measure(values)
    if found.engine != f"SIMD batch of {width}":
        raise RuntimeError(f"this machine runs {found.engine}")
    walls = list[float]()
    for _ in range(5):
        begin = time.perf_counter()
        batch.measure(values)
        walls.append(time.perf_counter() - begin)
    return {"rate": runs * SECONDS / min(walls), "operations": operations(batch), "peak": peak()}


def operations(batch: Any) -> float:
    """Floating-point operations per simulated second: those of the formulas, with one for a division or a root."""
    from dmframe.program import CONST, INPUT, OPERATIONS, read

    weights = {"sin": SINE / 2, "cos": SINE / 2, "tanh": TANH}  # a sine and its cosine are usually computed together
    step = batch.prepared.step
    parts = batch._parts.hoisted

    def of(function: Any) -> float:
        codes = [node.code for node in read(function).nodes if node.code not in (CONST, INPUT)]
        return sum(weights.get(OPERATIONS[code].name, 1) for code in codes)

    tick = of(parts.trajectory) + of(parts.sample) + of(parts.clip) + 4 * step.substeps * of(parts.rate)
    return float(tick / step.period)


def peak() -> float:
    """Peak rate on this core in operations per second; a multiply-add counts twice."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "peak.c").write_text(PEAK, encoding="utf-8")
        command = ["cc", "-O3", "-march=native", "-fPIC", "-shared", "peak.c", "-o", "peak.so"]
        subprocess.run(command, cwd=folder, check=True)
        library = ctypes.CDLL(f"{folder}/peak.so")
    rounds, out, best = 2_000_000, np.array([1.0 - 1e-9, 1e-9, 0.0]), np.inf
    for _ in range(5):
        begin = time.perf_counter()
        library.peak(ctypes.c_long(rounds), ctypes.c_void_p(out.ctypes.data))
        best = min(best, time.perf_counter() - begin)
    return rounds * 12 * 8 * 2 / best


def section(limit: float, report: Callable[[str], None] = lambda text: None) -> Section:
    """For each graph a row for each vector width of the machine."""
    rows = list[Row]()
    for graph in GRAPHS:
        first = None
        for width in WIDTHS:
            name = f"{graph}, {width} at once" if width > 1 else f"{graph}, one run"
            report(f"(h) {name}")
            try:
                found = measure("simd:timed", limit, graph=graph, width=width)
            except Failed as failure:
                rows.append(Row("h", name, status="missing", agreement=str(failure), version=of("dmframe")))
                continue
            first = first or found["rate"]
            share = found["operations"] * found["rate"] / found["peak"] if width > 1 else None
            note = "" if share is None else f"{share:.0%} of what the processor could do"
            ratio = found["rate"] / first if width > 1 else None
            rows.append(Row("h", name, found["rate"], "x real time", ratio, "ok", of("dmframe"), note))
    return Section(
        "h",
        f"runs in SIMD batches, in vector registers, {SECONDS:g} s each, on one core; figures in the loop",
        "how many times as fast as one run",
        tuple(rows),
        (
            "What the processor could do: multiply-adds of its widest vectors only, measured on the same core. The "
            "operations are those of the formulas, a division or a root counted as one.",
        ),
    )
