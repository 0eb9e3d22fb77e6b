"""`dmframe design` on many robots: ``python -m tests.benchmarks.designs ROBOT... --chains 100-119 --out DIR``.

Designs one robot after another, each within a time limit, then runs and verifies the graph that was handed over. A
robot is a name or a file; `--chains` adds random ones, by their seeds. Finished robots are kept in the folder, and the
table is printed as Markdown. The exit status is 1 if a design ended in another way than adaptive, simple or blocked,
took longer than its limit, or if its graph diverges or is not verified.
"""

from __future__ import annotations

import argparse
import json
import re
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

from tests.random_chains import random_chain

RESULTS: Final = "designs.jsonl"
OUTCOMES: Final = ("adaptive", "simple", "blocked")
HEADS: Final = ("robot", "axes", "outcome", "law", "error", "its run", "best of the other kind", "unit", "CPU s")
SLIDING: Final = 0.04


def parser() -> argparse.ArgumentParser:
    """The command line."""
    found = argparse.ArgumentParser("python -m tests.benchmarks.designs", description=__doc__)
    found.add_argument("robots", nargs="*", metavar="ROBOT", help="names or files")
    found.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder of the designs")
    found.add_argument(
        "--chains", type=_seeds, default=[], metavar="SEEDS", help="random chains, as 100-119 or 100,107"
    )
    found.add_argument("--limit", type=float, default=600.0, metavar="S", help="longest time of a design")
    found.add_argument("--workers", type=int, default=2, help="processes of a design")
    found.add_argument("--until", metavar="HH:MM", help="time of day (UTC) after which no design starts")
    return found


def main(words: Sequence[str]) -> int:
    """Design for all robots; returns the exit status."""
    chosen = parser().parse_args(words)
    chosen.out.mkdir(parents=True, exist_ok=True)
    kept = {row["name"]: row for row in _kept(chosen.out / RESULTS)}
    rows = list[dict[str, Any]]()
    for name, robot in _robots(chosen):
        if name not in kept:
            if chosen.until and f"{datetime.now(UTC):%H:%M}" >= chosen.until:
                break
            sys.stderr.write(f"{datetime.now(UTC):%H:%M} {name}\n")
            kept[name] = {"name": name, **designed(robot, chosen.out / name, chosen.limit, chosen.workers)}
            with (chosen.out / RESULTS).open("a", encoding="utf-8") as file:
                file.write(json.dumps(kept[name]) + "\n")
        rows.append(kept[name])
    print(table(rows))
    wrong = [f"{row['name']}: {fault}" for row in rows for fault in faults(row)]
    print("\n".join(wrong))
    return bool(wrong)


def designed(robot: str, out: Path, limit: float, workers: int) -> dict[str, Any]:
    """Result of a design, of a run and of a proof of its graph, with the processor time [s] of the first."""
    words = ["design", robot, "--out", str(out), "--workers", str(workers), "--json"]
    began, before = time.monotonic(), _processor_time()
    try:
        status, stdout, stderr = _dmframe(words, limit)
    except subprocess.TimeoutExpired:
        return {"outcome": "none", "reason": f"no end within {limit:g} s"}
    took = {"wall": time.monotonic() - began, "cpu": _processor_time() - before, "status": status}
    try:
        found = json.loads(stdout)
    except ValueError:
        return {"outcome": "none", "reason": stderr.strip()[-400:], **took}
    graph = found["graph"]
    more = {} if graph is None else {"run": _run(graph, limit), "proof": _dmframe(["verify", graph], limit)[0]}
    axes = _axes(out / "first.yaml")
    keys = ("outcome", "law", "error", "rival", "rival_error", "unit", "reason", "task")
    return {"axes": axes, **{key: found[key] for key in keys}, **more, **took}


def faults(row: dict[str, Any]) -> Iterator[str]:
    """What is wrong with a result."""
    if row["outcome"] not in OUTCOMES:
        yield row["reason"]
        return
    if row["status"] != (row["outcome"] == "blocked"):
        yield f"outcome {row['outcome']} with exit status {row['status']}"
    if row["outcome"] == "blocked":
        return
    if row["run"] is None or not row["run"] <= 2 * row["error"]:
        yield f"the run of its graph has an error of {row['run']}, the design states {row['error']}"
    if row["outcome"] == "adaptive" and row["proof"] != 0:
        yield f"dmframe verify ends with status {row['proof']}"


def table(rows: Sequence[dict[str, Any]]) -> str:
    """The results as Markdown, and the reasons of blocked designs."""
    lines = [f"| {' | '.join(HEADS)} |", f"|{'---|' * len(HEADS)}"]
    for row in rows:
        rival = f"{_number(row.get('rival_error'))} ({row['rival']})" if row.get("rival") else ""
        numbers = _number(row.get("error")), _number(row.get("run")), rival
        words = row["name"], row.get("axes") or "", row["outcome"], row.get("law") or ""
        unit = row["unit"] if row.get("error") is not None else ""
        lines.append(f"| {' | '.join(map(str, (*words, *numbers, unit, _number(row.get('cpu')))))} |")
    lines += ["", *(f"- {row['name']}: {row['reason']}" for row in rows if row["outcome"] not in OUTCOMES[:2])]
    return "\n".join(lines)


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.2g}" if value < 100 else f"{value:.0f}"


def _seeds(text: str) -> list[int]:
    """Numbers, as 100-119 or 100,107."""
    ends = [[int(end) for end in part.split("-")] for part in text.split(",")]
    return [seed for first, *last in ends for seed in range(first, (last[0] if last else first) + 1)]


def _robots(chosen: argparse.Namespace) -> Iterator[tuple[str, str]]:
    stems = [Path(robot).name.partition(".")[0] for robot in chosen.robots]
    for robot, stem in zip(chosen.robots, stems, strict=True):
        yield (stem if stems.count(stem) == 1 else f"{Path(robot).parent.name}_{stem}"), robot
    for seed in chosen.chains:
        with tempfile.TemporaryDirectory() as folder:
            made = random_chain(Path(folder), seed, sliding=SLIDING, untidy=True)
            text = made.read_text(encoding="utf-8")
        file = chosen.out / f"chain_{seed}.urdf"
        file.write_text(text, encoding="utf-8")
        yield f"chain_{seed}", str(file)


def _run(graph: str, limit: float) -> float | None:
    """Error of a run over its last eighth [mrad, mm]; None if it diverged or ended with an error."""
    with tempfile.TemporaryDirectory() as place:
        words = ["run", graph, "--json", "--no-plots", "--force", "--out", place]
        status, stdout, _ = _dmframe(words, limit)
    found = {} if status else json.loads(stdout)
    return None if found.get("diverged", True) else 1e3 * found["error"]["rms_final"]


def _dmframe(words: list[str], limit: float) -> tuple[int, str, str]:
    command = [sys.executable, "-m", "dmframe", *words]
    done = subprocess.run(command, capture_output=True, text=True, timeout=limit, check=False)
    return done.returncode, done.stdout, done.stderr


def _axes(first: Path) -> int | None:
    found = re.search(r"start: \{q: \[(.*?)\]", first.read_text(encoding="utf-8")) if first.exists() else None
    return None if found is None else found[1].count(",") + 1


def _kept(file: Path) -> Iterator[dict[str, Any]]:
    if file.exists():
        yield from map(json.loads, file.read_text(encoding="utf-8").splitlines())


def _processor_time() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
