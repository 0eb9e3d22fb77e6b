"""Client of the worker process: asynchronous jobs, and results that are remembered while their inputs last."""

from __future__ import annotations

import asyncio
import json
import os
import sys
from collections import OrderedDict
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any, Final, final

LONGEST: Final = 64 * 2**20
"""Longest line of the worker: a live page with its module [bytes]."""
MOST_REMEMBERED: Final = 30
Stage = dict[str, Any]


@final
class Worker:
    """The worker process; it is started at the first job, and again if it has ended."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._process: asyncio.subprocess.Process | None = None
        self._reader: asyncio.Task[None] | None = None
        self._starting = asyncio.Lock()
        self._jobs = dict[int, asyncio.Queue[Stage]]()
        self._count = 0
        self._remembered: OrderedDict[str, list[Stage]] = OrderedDict()

    async def start(self) -> asyncio.subprocess.Process:
        """The running process."""
        async with self._starting:
            if self._process is None or self._process.returncode is not None:
                self._process = await asyncio.create_subprocess_exec(
                    sys.executable,
                    *("-m", "dmframe.studio.worker", str(self.path)),
                    stdin=asyncio.subprocess.PIPE,
                    stdout=asyncio.subprocess.PIPE,
                    limit=LONGEST,
                )
                self._reader = asyncio.create_task(self._read(self._process))
            return self._process

    async def stages(self, request: Stage) -> AsyncIterator[Stage]:
        """The stages of a request; when this is closed before the end, its jobs are stopped.

        A text, or a packaged graph, is drawn and proved at the same time; results of the proof follow the diagram.
        """
        key = json.dumps({name: value for name, value in request.items() if name != "base"}, sort_keys=True)
        if (found := self._recalled(key)) is not None:
            for stage in found:
                yield stage
            return
        process, queue, kept = await self.start(), asyncio.Queue[Stage](), list[Stage]()
        parts = [request] if "part" in request else [{**request, "part": "drawn"}, {**request, "part": "proved"}]
        jobs = {job: part["part"] for job, part in enumerate(parts, self._count + 1)}
        self._count += len(parts)
        self._jobs |= dict.fromkeys(jobs, queue)
        try:
            for job, part in zip(jobs, parts, strict=True):
                self._send(process, {**part, "job": job})
            async for stage in self._in_order(process, queue, jobs):
                if stage["stage"] not in ("numbers", "done"):
                    kept.append(stage)
                yield stage
                if stage["stage"] == "done":
                    self._keep(key, [*kept, stage])
        finally:
            for job in jobs:
                del self._jobs[job]
                self._cancel(process, job)

    async def _in_order(
        self, process: asyncio.subprocess.Process, queue: asyncio.Queue[Stage], jobs: dict[int, str]
    ) -> AsyncIterator[Stage]:
        """Stages until the end of all jobs, with all their files; those of the proof follow those of the drawing."""
        open_jobs, held, files = dict(jobs), list[Stage](), list[Any]()
        while open_jobs:
            stage = await queue.get()
            job = stage.pop("job", None)
            if stage["stage"] == "done":
                part = open_jobs.pop(job, "")
                files += stage["files"]
                if part == "drawn":
                    for each in held:
                        yield each
                continue
            if "drawn" in open_jobs.values() and jobs.get(job) == "proved":
                held.append(stage)
                continue
            yield stage
            if stage["stage"] == "ended":
                return
            if stage["stage"] == "faults":
                for other in [each for each, part in open_jobs.items() if part == "proved" and each != job]:
                    self._cancel(process, other)
                    del open_jobs[other]
        yield {"stage": "done", "files": files}

    def _cancel(self, process: asyncio.subprocess.Process, job: int) -> None:
        if process.returncode is None:
            self._send(process, {"cancel": job})

    def _send(self, process: asyncio.subprocess.Process, request: Stage) -> None:
        assert process.stdin is not None
        process.stdin.write(json.dumps(request).encode() + b"\n")

    async def _read(self, process: asyncio.subprocess.Process) -> None:
        """Give results to their jobs; at the end of the process, end all jobs."""
        assert process.stdout is not None
        while line := await process.stdout.readline():
            stage = json.loads(line)
            if (queue := self._jobs.get(stage["job"])) is not None:
                queue.put_nowait(stage)
        await process.wait()
        self.end_jobs("the process that examines the text has ended; the next edit starts it again")

    def end_jobs(self, reason: str) -> None:
        """End all running jobs with a reason."""
        for queue in self._jobs.values():
            queue.put_nowait({"stage": "ended", "reason": reason})

    def _recalled(self, key: str) -> list[Stage] | None:
        """Earlier results, if all files that they were computed from are unchanged."""
        found = self._remembered.get(key)
        if found is None:
            return None
        if any(_state(path) != (time, size) for path, time, size in found[-1]["files"]):
            del self._remembered[key]
            return None
        self._remembered.move_to_end(key)
        return found

    def _keep(self, key: str, stages: list[Stage]) -> None:
        self._remembered[key] = stages
        while len(self._remembered) > MOST_REMEMBERED:
            self._remembered.popitem(last=False)

    async def close(self) -> None:
        """End the process; it stops its jobs."""
        process, reader = self._process, self._reader
        if process is None or reader is None:
            return
        if process.stdin is not None:
            process.stdin.close()
        try:
            await asyncio.wait_for(asyncio.shield(reader), 3)
        except TimeoutError:
            process.kill()
            await reader


def _state(path: str) -> tuple[int, int]:
    """Time of modification and size of a file; -1 without a file."""
    try:
        status = os.stat(path)  # noqa: PTH116 - called for each file at each edit
    except OSError:
        return -1, -1
    return status.st_mtime_ns, status.st_size
