"""What happened at each sample of a drive: rows of numbers, in memory or in a file that grows while the robot moves."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue
from typing import Any, Final, final

import numpy as np

from dmframe.errors import OutputError
from dmframe.files import encoded, forced, reason, sync
from dmframe.runtime.robot import Sample
from dmframe.runtime.steered import Steered
from dmframe.seal import SEAL, digest

BLOCK: Final = 512
"""Rows that are handed over together."""
OLDEST: Final = 0.4
"""A block is handed over after so long at the latest [s]."""
MOST_PENDING: Final = 64 * 2**20
"""Bytes that wait for the disk; with more of them a drive is stopped."""
NUMBERS: Final = ("time", "reference", "scale", "answer", "age", "missed")
"""Columns of one number: the robot's time and the controller's [s], how fast that ran, how long the answer took [s]."""
SHOWN: Final = ("q", "dq", "q_c", "x")
_VERSION: Final = 2
_DIGEST: Final = "sha256"
"""Of the first line, which names what the rows hold: a slip in it would make other signals of them."""


@final
@dataclass(frozen=True)
class Columns:
    """The names and widths of a row's parts; a state is called ``state:`` and its label."""

    widths: Mapping[str, int]

    @property
    def width(self) -> int:
        """Of a row."""
        return sum(self.widths.values())

    def slices(self) -> dict[str, slice]:
        """Where each part is."""
        found, first = dict[str, slice](), 0
        for name, width in self.widths.items():
            found[name], first = slice(first, first + width), first + width
        return found

    @classmethod
    def of(cls, steered: Steered, sample: Sample) -> Columns:
        """Those of a drive, from its first sample."""
        shown = {name: getattr(sample, name) for name in SHOWN}
        states = {f"state:{label}": values.size for label, values in steered.controller.states.items()}
        n = steered.command.size
        return cls(
            dict.fromkeys(NUMBERS, 1)
            | {name: 0 if values is None else values.size for name, values in shown.items()}
            | states
            | {"command": n, "sent": n}
        )


@final
class Spool:
    """A file that grows by rows while a robot is driven, written and forced to the disk by a thread of its own.

    Its first line is JSON, with the columns and what is known of the drive; rows of doubles follow. A program that is
    killed loses what it has not handed over yet, half a second, and what the disk is writing.
    """

    def __init__(self, path: Path, about: Mapping[str, Any]) -> None:
        self.path, self.about, self.fault = path, dict(about), ""
        self._queue: SimpleQueue[bytes | None] = SimpleQueue()
        self._thread: threading.Thread | None = None
        self._handed = self._written = self._begin = 0

    def open(self, columns: Columns) -> None:
        """Begin the file; called from the loop of a drive, so that the thread does it."""
        head = {"dmframe-samples": _VERSION, "columns": columns.widths, **self.about}
        line = _signed(head)
        self._begin = len(line)
        self._thread = threading.Thread(target=self._work, name="dmframe record", daemon=True)
        self._thread.start()
        self.put(line)

    def put(self, content: bytes) -> None:
        """Hand over bytes. It does not wait for the disk."""
        self._handed += len(content)
        if self._handed - self._written > MOST_PENDING:
            self.fault = self.fault or f"{self.path}: the disk is too slow"
        self._queue.put(content)

    def close(self) -> None:
        """Wait until all is on the disk."""
        if self._thread is not None:
            self._queue.put(None)
            self._thread.join()
            self._thread = None

    def rows(self, width: int, every: int) -> np.ndarray:
        """Each `every`-th row; the file is read in parts, so that the others take no memory."""
        found, first = [np.zeros((0, width))], 0
        with self.path.open("rb") as file:
            file.seek(self._begin)
            while len(part := np.fromfile(file, dtype=float, count=BLOCK * width)) >= width:
                part = part[: len(part) // width * width].reshape(-1, width)
                found.append(part[-first % every :: every].copy())  # a view would keep the whole part
                first += len(part)
        return np.concatenate(found)

    def _work(self) -> None:
        try:
            with self.path.open("wb") as file:
                self.path.with_name(SEAL).unlink(missing_ok=True)  # of results of before, which had another record
                sync(self.path.parent)
                last = False
                while not last:
                    parts = [self._queue.get()]
                    while not self._queue.empty():  # what came meanwhile is forced to the disk together
                        parts.append(self._queue.get())
                    last = parts[-1] is None
                    content = b"".join(part for part in parts if part is not None)
                    file.write(content)
                    forced(file)
                    self._written += len(content)
        except OSError as error:
            self.fault = f"{self.path}: {reason(error)}"


@final
class Journal:
    """A row for each sample; in memory, or in a `Spool`."""

    def __init__(self, spool: Spool | None = None) -> None:
        self.spool, self.columns = spool, Columns({})
        self._blocks, self._block, self._used = list[np.ndarray](), np.zeros((0, 0)), 0
        self._slices, self._since, self._count, self._open = dict[str, slice](), 0.0, 0, False

    def __len__(self) -> int:
        return self._count

    @property
    def fault(self) -> str:
        """Why the record cannot go on; empty where it can."""
        return self.spool.fault if self.spool is not None else ""

    def begin(self, sample: Sample, steered: Steered, since: float, reference: float, scale: float) -> None:
        """What a sample shows, and the controller's states before it answers."""
        if not self._slices:
            self.columns = Columns.of(steered, sample)
            self._slices = self.columns.slices()
            if self.spool is not None:
                self.spool.open(self.columns)
        if self._used == len(self._block):
            self._block, self._used = np.full((BLOCK, self.columns.width), np.nan), 0
            self._since = time.perf_counter()
        row, at = self._block[self._used], self._slices
        row[:6] = since, reference, scale, np.nan, np.nan if sample.age is None else sample.age, sample.missed
        for name in SHOWN:
            values = getattr(sample, name)
            row[at[name]] = np.nan if values is None else values
        for label, values in steered.controller.states.items():
            row[at[f"state:{label}"]] = values

    def commanded(self, command: np.ndarray, sent: np.ndarray) -> None:
        """What the controller commands and the gate lets through: now the row counts."""
        row = self._block[self._used]
        row[self._slices["command"]], row[self._slices["sent"]] = command, sent
        self._used, self._count = self._used + 1, self._count + 1

    def answered(self, seconds: float) -> None:
        """How long the last answer took; rows that are full or old go to the disk."""
        self._block[self._used - 1, 3] = seconds
        if self._used == len(self._block) or time.perf_counter() - self._since > OLDEST:
            self._hand_over()

    def close(self) -> None:
        """All rows are where they belong."""
        self._hand_over()
        if self.spool is not None:
            self.spool.close()

    def rows(self, every: int = 1) -> np.ndarray:
        """Each `every`-th row, of a drive that is over. Raises `OutputError` where they are not all on the disk."""
        if self.fault:
            raise OutputError(f"{self.fault}; what was written before lies there, and dmframe replay reads it")
        width = self.columns.width
        if self.spool is not None and self._count:
            return self.spool.rows(width, every)
        return np.concatenate([np.zeros((0, width)), *self._blocks])[::every]

    def parts(self, every: int = 1) -> dict[str, np.ndarray]:
        """The same by column."""
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

    # Lists, for who looks at a short drive.

    def _numbers(self, name: str) -> list[float]:
        return [float(value) for value in self.parts()[name][:, 0]] if self._count else []

    @property
    def time(self) -> list[float]:
        """Of the robot's clock since the first sample [s]."""
        return self._numbers("time")

    @property
    def reference(self) -> list[float]:
        """Time of the controller [s]."""
        return self._numbers("reference")

    @property
    def scale(self) -> list[float]:
        """How fast the controller's time ran by the robot's."""
        return self._numbers("scale")

    @property
    def commands(self) -> list[np.ndarray]:
        """What the controller commanded [rad/s]."""
        return list(self.parts()["command"]) if self._count else []

    @property
    def sent(self) -> list[np.ndarray]:
        """What the gate let through [rad/s]."""
        return list(self.parts()["sent"]) if self._count else []

    @property
    def states(self) -> list[dict[str, np.ndarray]]:
        """Of the controller, before it answered."""
        names = [name for name in self._slices if name.startswith("state:")]
        return [{name.partition(":")[2]: row[self._slices[name]] for name in names} for row in self._each()]

    @property
    def samples(self) -> list[Sample]:
        """What the robot showed; its scaling is part of `scale`."""
        return [self._sample(row) for row in self._each()]

    def _each(self) -> Iterator[np.ndarray]:
        yield from self.rows() if self._count else ()

    def _sample(self, row: np.ndarray) -> Sample:
        parts: dict[str, Any] = {name: row[self._slices[name]] if self.columns.widths[name] else None for name in SHOWN}
        age = None if np.isnan(row[4]) else float(row[4])
        return Sample(time=float(row[0]), **parts, age=age, missed=int(row[5]))


def _signed(head: Mapping[str, Any]) -> bytes:
    """The first line of a file of samples, with its own digest."""
    return encoded(json.dumps({**head, _DIGEST: digest(encoded(json.dumps(head)))}) + "\n")


def read_samples(path: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """The first line of a `Spool` and its rows by column, mapped from the file; a row that was cut off is left out.

    Raises
    ------
    OSError
        It cannot be read.
    ValueError, KeyError
        It is none, or its first line is not as it was written.
    """
    with path.open("rb") as file:
        line = file.readline(2**20)
    head = json.loads(line.decode("utf-8"))
    if not isinstance(head, dict) or head.get("dmframe-samples") != _VERSION:
        raise ValueError("it is of another version")
    if line != _signed({name: value for name, value in head.items() if name != _DIGEST}):
        raise ValueError("its first line is not what was written: its digest is another")
    columns = Columns({str(name): int(width) for name, width in head["columns"].items()})
    count = (path.stat().st_size - len(line)) // (8 * columns.width)
    shape = (count, columns.width)
    rows = np.memmap(path, dtype=float, mode="r", offset=len(line), shape=shape) if count else np.zeros(shape)
    return head, {name: rows[:, part] for name, part in columns.slices().items() if columns.widths[name]}
