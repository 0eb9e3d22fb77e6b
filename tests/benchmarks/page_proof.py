"""The time that Chromium takes for a graph's certificate: ``python -m tests.benchmarks.page_proof [GRAPH] [RUNS]``.

Each run starts Chromium with a new profile and opens a page with the certificate and `check.js` alone, under the
content security policy of a live page, so that nothing is compiled or cached. `check` is the wall time from the
certificate's text to the result. `script` is the CPU time of all scripts, on Chromium's clock of the thread.
"""

from __future__ import annotations

import base64
import hashlib
import sys
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

sys.path.append(str(Path(__file__).parents[1] / "framework"))

from in_chromium import chromium

import dmframe as dm
from dmframe.certify.published import certificate_text
from dmframe.page.proof import checker_script

RUN = (
    ";const begin = performance.now(), text = document.getElementById('file').textContent;"
    "const result = checker.check(JSON.parse(text));"
    "globalThis.answer = { ms: performance.now() - begin, ...result };"
)


def page(certificate: str) -> str:
    """The page."""
    script = checker_script() + RUN
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    return (
        "<!doctype html><meta http-equiv='Content-Security-Policy' "
        f"content=\"default-src 'none'; script-src 'sha256-{digest}'\">"
        f"<script type='application/json' id='file'>{certificate.replace('<', chr(92) + 'u003c')}</script>"
        f"<script>{script}</script>"
    )


def cold(certificate: str, runs: int) -> Iterator[tuple[float, float]]:
    """Wall time of the check and CPU time of the scripts of each run, in seconds."""
    for _ in range(runs):
        with TemporaryDirectory(ignore_cleanup_errors=True) as folder:
            path = Path(folder, "page.html")
            path.write_text(page(certificate), encoding="utf-8")
            with chromium(Path(folder, "profile")) as tab:
                tab.ask("Performance.enable", timeDomain="threadTicks")
                tab.opened(path)
                found = tab.until("globalThis.answer")
                if found["status"] != "re-proved":
                    raise RuntimeError(f"{found['status']}: {found['reason']}")
                metrics = {item["name"]: item["value"] for item in tab.ask("Performance.getMetrics")["metrics"]}
                yield found["ms"] / 1e3, metrics["ScriptDuration"]


def main(name: str = "ur10_fast", runs: str = "5") -> None:
    """Print both times of each run, and the least."""
    graph = dm.load(name)
    times = []
    for check, script in cold(certificate_text(graph.verify().verdict, {"graph": name}, graph.intervals()), int(runs)):
        times.append((check, script))
        sys.stdout.write(f"{name}: check {check:.3f} s, script {script:.3f} s of CPU\n")
    least = [min(column) for column in zip(*times, strict=True)]
    sys.stdout.write(f"least of {runs}: check {least[0]:.3f} s, script {least[1]:.3f} s of CPU\n")


if __name__ == "__main__":
    main(*sys.argv[1:])
