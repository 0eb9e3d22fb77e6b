"""Process with all modules loaded, which forks for each text: ``python -m dmframe.studio.worker FILE``.

It reads one JSON object a line: ``{"job": 3, "part": "drawn", "text": ..., "base": ...}`` draws a text, and ``"part":
"proved"`` proves it; with ``"graph": NAME`` instead of a text, a packaged graph. ``{"job": 3, "part": "list"}`` lists
these and returns the schema, and ``{"cancel": 3}`` stops a job. It writes a stage of a job a line, with the keys
``job`` and ``stage``; the last one is ``done``. A job runs in a process group of its own, so that an edit stops a long
proof, and a crash ends one job only.
"""

from __future__ import annotations

import gc
import json
import os
import selectors
import signal
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import IO, Any, Final, final

from dmframe.catalogue import graphs
from dmframe.config.schema import json_schema
from dmframe.studio.examine import Stage, drawn, graph_of, opened_files, proved

CHUNK: Final = 1 << 20
ALLOCATIONS: Final = 500_000
"""Allocations between two garbage collections, as in the command line."""


def main(name: str) -> None:
    """Answer requests until the end of standard input."""
    gc.set_threshold(ALLOCATIONS)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the server ends this process
    results = os.dup(1)
    os.dup2(2, 1)  # what a user's block prints is not a result
    with suppress(OSError, UnicodeDecodeError):
        warm(Path(name).read_text("utf-8"), name)
    gc.freeze()
    Worker(name, 0, results).run()


def warm(text: str, name: str) -> None:
    """Load the modules and the robot of a text, which its examination in a fork then shares."""
    try:
        import dmframe.analysis  # the live page imports it
        import dmframe.certify
        import dmframe.codegen.wasm  # noqa: F401

        graph_of(text, name)
    except (KeyboardInterrupt, MemoryError):
        raise
    except BaseException:  # faults of the text are reported when it is examined
        return


@final
class Worker:
    """The jobs of a process, one fork each."""

    def __init__(self, name: str, requests: int, results: int) -> None:
        self.name, self.requests, self.results = name, requests, results
        self.jobs = dict[int, tuple[int, int]]()  # process and pipe by job
        self.rest = dict[int, bytes]()  # incomplete line by descriptor
        self.selector = selectors.DefaultSelector()

    def run(self) -> None:
        """Serve until the requests end; running jobs are stopped."""
        self.selector.register(self.requests, selectors.EVENT_READ, None)
        try:
            while True:
                for key, _ in self.selector.select():
                    if key.data is not None:
                        if self.jobs.get(key.data, (0, -1))[1] == key.fd:  # else it was just stopped
                            self.forward(key.fd, key.data)
                        continue
                    lines = self.lines(self.requests)
                    if lines is None:
                        return
                    for line in lines:
                        self.take(json.loads(line))
        except BrokenPipeError:  # the server has ended
            return
        finally:
            for job in list(self.jobs):
                self.stop(job)

    def lines(self, descriptor: int) -> list[bytes] | None:
        """Complete lines that a descriptor has; None at its end."""
        found = os.read(descriptor, CHUNK)
        if not found:
            return None
        *lines, self.rest[descriptor] = (self.rest.get(descriptor, b"") + found).split(b"\n")
        return lines

    def take(self, request: dict[str, Any]) -> None:
        """Start or stop a job."""
        if "cancel" in request:
            self.stop(request["cancel"])
            return
        job, (read, write) = request["job"], os.pipe()
        process = os.fork()
        if process == 0:
            self.work(request, write)
        os.close(write)
        self.jobs[job] = process, read
        self.selector.register(read, selectors.EVENT_READ, job)

    def forward(self, descriptor: int, job: int) -> None:
        """Pass on the results of a job, and its end."""
        lines = self.lines(descriptor)
        if lines:
            self.send(b"".join(line + b"\n" for line in lines))
        if lines is not None:
            return
        process, _ = self.jobs[job]
        self.close(job)
        _, status = os.waitpid(process, 0)
        if status != 0:
            code = os.waitstatus_to_exitcode(status)
            reason = f"by signal {-code}" if code < 0 else f"with status {code}"
            ended = f"the examination ended {reason}; another edit starts it again"
            self.send(json.dumps({"job": job, "stage": "ended", "reason": ended}).encode() + b"\n")

    def send(self, content: bytes) -> None:
        """Write all of it."""
        while content:
            content = content[os.write(self.results, content) :]

    def stop(self, job: int) -> None:
        """End a job with its own forks, if it still runs."""
        if job not in self.jobs:
            return
        process, _ = self.jobs[job]
        with suppress(OSError):
            os.killpg(process, signal.SIGKILL)
        with suppress(OSError):  # before the fork has made its group
            os.kill(process, signal.SIGKILL)
        os.waitpid(process, 0)
        self.close(job)

    def close(self, job: int) -> None:
        """Forget a job."""
        _, read = self.jobs.pop(job)
        self.selector.unregister(read)
        self.rest.pop(read, None)
        os.close(read)

    @staticmethod
    def put(file: IO[bytes], request: dict[str, Any], stage: Stage) -> None:
        """Write a stage."""
        file.write(json.dumps({**stage, "job": request["job"]}).encode() + b"\n")
        file.flush()

    def work(self, request: dict[str, Any], write: int) -> None:
        """Do a job in the fork; never returns."""
        status = 1
        try:
            os.setpgid(0, 0)
            for end in (self.requests, self.results, *(read for _, read in self.jobs.values())):
                os.close(end)
            os.open(os.devnull, os.O_RDONLY)  # the lowest free number, that of standard input
            with open(write, "wb") as file:
                try:
                    for stage in stages(request, self.name):
                        self.put(file, request, stage)
                except (MemoryError, OSError) as error:
                    reason = f"the examination ended: {type(error).__name__} {error}".rstrip()
                    self.put(file, request, {"stage": "ended", "reason": reason})
            status = 0
        finally:
            os._exit(status)


def stages(request: dict[str, Any], name: str) -> Iterator[Stage]:
    """The stages of a request; the last one lists the files that were read, with their times and sizes."""
    opened = list[str]()

    def note(event: str, arguments: tuple[Any, ...]) -> None:
        if event == "open" and isinstance(arguments[0], str | os.PathLike):
            opened.append(os.path.abspath(os.fspath(arguments[0])))  # noqa: PTH100 - the hook must be quick

    sys.addaudithook(note)
    text, place, part = request.get("text", ""), name, request["part"]
    if "graph" in request:
        path = graphs().get(request["graph"])
        if path is None:
            yield {"stage": "ended", "reason": "there is no such packaged graph"}
            return
        text, place = path.read_text("utf-8"), str(path)
    if part == "list":
        yield {"stage": "list", "graphs": list(graphs()), "schema": json_schema()}
    elif part == "proved":
        yield from proved(text, place)
    else:
        if "graph" in request:
            yield {"stage": "text", "text": text}
        yield from drawn(text, place, request.get("base"))
    yield {"stage": "done", "files": opened_files(opened)}


if __name__ == "__main__":
    main(sys.argv[1])
