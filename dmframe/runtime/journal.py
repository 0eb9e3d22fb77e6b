"""Record of a drive: one row of numbers for each sample, in memory or in a file that is written during the drive."""

from __future__ import annotations

import json
import os
import tempfile
import threading
import time
import weakref
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue
from typing import IO, Any, Final, final

import numpy as np

from dmframe.common.errors import OutputError
from dmframe.common.files import encoded, forced, reason, sync
from dmframe.common.seal import SEAL, digest
from dmframe.runtime.robot import Sample
from dmframe.runtime.scaled import ScaledController
from dmframe.runtime.signals import FIELDS

BLOCK: Final = 512
"""Rows of a block, the unit of writing."""
OLDEST: Final = 0.4
"""Longest time until a block is written [s]."""
MOST_PENDING: Final = 64 * 2**20
"""Unwritten bytes above which a drive is stopped."""
NUMBERS: Final = ("time", "reference", "scale", "answer", "age", "missed")
"""Scalar columns: robot time and controller time [s], their ratio, response time [s], command age [s], lost samples."""
_VERSION: Final = 2
_COPIED: Final = 2**20
_DIGEST: Final = "sha256"
"""Key of the digest of the first line, which names the columns."""


@final
@dataclass(frozen=True)
class Columns:
    """Names and widths of a row's columns; states are named ``state:`` and their label."""

    widths: Mapping[str, int]

    @property
    def width(self) -> int:
        """Width of a row."""
        return sum(self.widths.values())

    def slices(self) -> dict[str, slice]:
        """Place of each column in a row."""
        found, first = dict[str, slice](), 0
        for name, width in self.widths.items():
            found[name], first = slice(first, first + width), first + width
        return found

    @classmethod
    def of(cls, scaled: ScaledController, sample: Sample) -> Columns:
        """Columns of a drive with this first sample."""
        shown = {name: getattr(sample, name) for name in FIELDS}
        states = {f"state:{label}": values.size for label, values in scaled.controller.states.items()}
        n = scaled.command.size
        return cls(
            dict.fromkeys(NUMBERS, 1)
            | {name: 0 if values is None else values.size for name, values in shown.items()}
            | states
            | {"command": n, "sent": n}
        )


@final
class Spool:
    """File of samples that a separate thread writes and syncs to the disk during a drive.

    Its first line is JSON with the columns and the drive's data; rows of doubles follow. If the program is killed, at
    most the last block (half a second) and the unwritten bytes are lost. Bytes that the disk does not take stay in
    memory, and the file remains open, so that the record stays complete if the disk is full or the folder was deleted.
    """

    def __init__(self, path: Path, about: Mapping[str, Any]) -> None:
        self.path, self.about, self.fault = path, dict(about), ""
        self._queue: SimpleQueue[bytes | None] = SimpleQueue()
        self._thread: threading.Thread | None = None
        self._file: IO[bytes] | None = None
        self._handed = self._written = self._begin = 0
        self._unwritten = b""

    def open(self, columns: Columns) -> None:
        """Start the thread, which creates the file."""
        head = {"dmframe-samples": _VERSION, "columns": columns.widths, **self.about}
        line = _signed(head)
        self._begin = len(line)
        self._thread = threading.Thread(target=self._work, name="dmframe record", daemon=True)
        self._thread.start()
        self.put(line)

    def put(self, content: bytes) -> None:
        """Queue bytes for the thread, without waiting for the disk."""
        self._handed += len(content)
        if self._handed - self._written > MOST_PENDING:
            self.fault = self.fault or f"{self.path}: the disk is too slow"
        self._queue.put(content)

    def close(self) -> None:
        """Wait until all bytes are on the disk; after a fault, keep them in memory."""
        if self._thread is not None:
            self._queue.put(None)
            self._thread.join()
            self._thread = None
            self._unwritten += b"".join(part for part in self._waiting() if part is not None)

    def rows(self, width: int, every: int) -> np.ndarray:
        """Read every `every`-th row, in parts to save memory."""
        found, first, size = [np.zeros((0, width))], 0, 8 * width * BLOCK
        for at in range(self._begin, self._handed, size):
            part = np.frombuffer(self._read(at, min(size, self._handed - at))).reshape(-1, width)
            found.append(part[-first % every :: every].copy())  # a view would keep the whole part
            first += len(part)
        return np.concatenate(found)

    def secured(self) -> str:
        """Complete the file, or write it again if it was moved or deleted; return a notice, empty if it is complete."""
        there = self._is_there()
        if there and self._written == self._handed:
            return ""
        why = self.fault or f"{self.path}: was moved or deleted during the drive"
        try:
            if there and self._file is not None:
                self._file.truncate(self._written)
                self._append(self._unwritten)
            else:
                self.path.parent.mkdir(parents=True, exist_ok=True)
                self._copy(self.path)
            return f"{why}; the record was written again"
        except OSError:
            try:
                spare = Path(tempfile.mkdtemp(prefix="dmframe-drive-"))
                self._copy(spare / self.path.name)
            except OSError as error:
                return f"{why}; the record could not be written to another place either: {reason(error)}"
            return f"{why}; the record is in {spare}"

    def _is_there(self) -> bool:
        try:
            return self._file is not None and os.path.samestat(os.fstat(self._file.fileno()), self.path.stat())
        except OSError:
            return False

    def _copy(self, path: Path) -> None:
        with path.open("xb") as file:
            for at in range(0, self._handed, _COPIED):
                file.write(self._read(at, min(_COPIED, self._handed - at)))
            forced(file)
        sync(path.parent)

    def _read(self, at: int, count: int) -> bytes:
        """Bytes of the record from the disk, and from memory."""
        there, found = max(0, min(count, self._written - at)), b""
        if there and self._file is not None:
            self._file.seek(at)
            found = self._file.read(there)
            if len(found) < there:
                raise OutputError(f"{self.path}: it was cut off at {at + len(found)} bytes during the drive")
        first = at + there - self._written
        return found + self._unwritten[first : first + count - there]

    def _work(self) -> None:
        try:
            self._file = self.path.open("w+b", buffering=0)
            weakref.finalize(self, self._file.close)
            self.path.with_name(SEAL).unlink(missing_ok=True)  # the seal of an earlier record
            sync(self.path.parent)
            last = False
            while not last:
                parts = [self._queue.get(), *self._waiting()]  # sync all queued bytes at once
                last = parts[-1] is None
                self._unwritten = b"".join(part for part in parts if part is not None)
                self._append(self._unwritten)
        except OSError as error:
            self.fault = f"{self.path}: {reason(error)}"

    def _waiting(self) -> list[bytes | None]:
        return [self._queue.get() for _ in range(self._queue.qsize())]

    def _append(self, content: bytes) -> None:
        """Write and sync bytes at the end; they count as written only then."""
        assert self._file is not None
        self._file.seek(self._written)
        view = memoryview(content)
        while view:
            view = view[self._file.write(view) :]
        forced(self._file)
        self._written += len(content)
        self._unwritten = b""


@final
class Journal:
    """Rows of a drive, one for each sample, in memory or in a `Spool`; `notice` names another location of the file."""

    def __init__(self, spool: Spool | None = None) -> None:
        self.spool, self.columns = spool, Columns({})
        self._blocks, self._block, self._used = list[np.ndarray](), np.zeros((0, 0)), 0
        self._slices, self._since, self._count, self.notice = dict[str, slice](), 0.0, 0, ""

    def __len__(self) -> int:
        return self._count

    @property
    def fault(self) -> str:
        """Reason for which recording failed; empty if it works."""
        return self.spool.fault if self.spool is not None else ""

    def begin(self, sample: Sample, scaled: ScaledController, since: float, reference: float, scale: float) -> None:
        """Begin a row with a sample, and the controller's states before its step."""
        if not self._slices:
            self.columns = Columns.of(scaled, sample)
            self._slices = self.columns.slices()
            if self.spool is not None:
                self.spool.open(self.columns)
        if self._used == len(self._block):
            self._block, self._used = np.full((BLOCK, self.columns.width), np.nan), 0
            self._since = time.perf_counter()
        row, at = self._block[self._used], self._slices
        row[:6] = since, reference, scale, np.nan, np.nan if sample.age is None else sample.age, sample.missed
        for name in FIELDS:
            values = getattr(sample, name)
            row[at[name]] = np.nan if values is None else values
        for label, values in scaled.controller.states.items():
            row[at[f"state:{label}"]] = values

    def commanded(self, command: np.ndarray, sent: np.ndarray) -> None:
        """Complete the row with the controller's command and the command after the gate."""
        row = self._block[self._used]
        row[self._slices["command"]], row[self._slices["sent"]] = command, sent
        self._used, self._count = self._used + 1, self._count + 1

    def answered(self, seconds: float) -> None:
        """Set the response time of the last row, and write the block if it is full or old."""
        self._block[self._used - 1, 3] = seconds
        if self._used == len(self._block) or time.perf_counter() - self._since > OLDEST:
            self._hand_over()

    def close(self) -> None:
        """Write the remaining rows."""
        self._hand_over()
        if self.spool is not None and self._slices:
            self.spool.close()
            self.notice = self.spool.secured()

    def rows(self, every: int = 1) -> np.ndarray:
        """Every `every`-th row of a finished drive. Raises `OutputError` if the file was changed."""
        width = self.columns.width
        if self.spool is not None and self._count:
            return self.spool.rows(width, every)
        return np.concatenate([np.zeros((0, width)), *self._blocks])[::every]

    def parts(self, every: int = 1) -> dict[str, np.ndarray]:
        """Rows by column."""
        rows = self.rows(every)
        return {name: np.ascontiguousarray(rows[:, part]) for name, part in self._slices.items()}

    def _hand_over(self) -> None:
        if not self._used:
            return
        part, self._block = self._block[: self._used], self._block[self._used :]
        self._used, self._since = 0, time.perf_counter()
        if self.spool is not None:
            self.spool.put(part.tobytes())
        else:
            self._blocks.append(part)

    def __getitem__(self, name: str) -> np.ndarray:
        """One column, (N,) for those of `NUMBERS` and (N, n) for others."""
        rows = self.parts()[name]
        return rows[:, 0] if name in NUMBERS else rows


def _signed(head: Mapping[str, Any]) -> bytes:
    """First line of a file of samples, with its own digest."""
    return encoded(json.dumps({**head, _DIGEST: digest(encoded(json.dumps(head)))}) + "\n")


def read_samples(path: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Read the first line of a `Spool`, and map its rows by column; an incomplete last row is skipped.

    Raises
    ------
    OSError
        The file cannot be read.
    ValueError, KeyError
        The file is not a `Spool`, or its first line was changed.
    """
    with path.open("rb") as file:
        line = file.readline(2**20)
    head = json.loads(line.decode("utf-8"))
    if not isinstance(head, dict) or head.get("dmframe-samples") != _VERSION:
        raise ValueError("its version is not supported")
    if line != _signed({name: value for name, value in head.items() if name != _DIGEST}):
        raise ValueError("its first line was changed: the digest does not match")
    columns = Columns({str(name): int(width) for name, width in head["columns"].items()})
    count = (path.stat().st_size - len(line)) // (8 * columns.width)
    shape = (count, columns.width)
    rows = np.memmap(path, dtype=float, mode="r", offset=len(line), shape=shape) if count else np.zeros(shape)
    return head, {name: rows[:, part] for name, part in columns.slices().items() if columns.widths[name]}
