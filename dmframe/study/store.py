"""The folder of a study: one Parquet file a chunk, written by one process alone, and never half.

A chunk's file is built beside its place, forced to the disk and moved there; a line of ``chunks.jsonl``, written before
the move, holds its digest and what made it. A file that is not what its line says is computed again.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final, final

import numpy as np

from dmframe.errors import MissingError, OutputError, ValueFault, visible
from dmframe.files import append, encoded, expanded, put, writing
from dmframe.study.chunks import Chunk, Extent
from dmframe.study.computed import Computable, Computed, Table, versions
from dmframe.study.disk import CHUNKS, Kept, end_line, is_partial, kept_in, put_below
from dmframe.study.lock import LOCK, difference, plain, read_lock

RUNS: Final = "runs"
PROVENANCE: Final = "provenance.json"
PROCESSES: Final = "processes.jsonl"
_HELD: Final = ".dmframe-study.lock"
_FIXED: Final = ("run", "point", "sample")


def polars() -> Any:
    """The library of tables. Raises `MissingError` where it is not installed."""
    try:
        import polars
    except ImportError:
        raise MissingError('study: polars is not installed; pip install "dmframe[study]"') from None
    return polars


@final
class Store:
    """A folder that is held for one study; see `opened`.

    Attributes
    ----------
    extents, each
        How the runs are cut, as `Sizes` has them.
    done
        Chunks whose rows are there.
    notices
        What a user should know of the folder as it was found.
    """

    def __init__(self, path: Path, study: Computable) -> None:
        self.path, self.key, self.points = path, study.key, len(study.points)
        self.extents: list[Extent] = []
        self.each: tuple[int, int] | None = None
        self.done = set[Chunk]()
        self.kept = dict[str, Kept]()
        self.notices: list[str] = []
        self._columns = {column.name: column.unit for column in (*study.varied, *study.measures)}
        self._types: dict[str, str] | None = None
        self._study = study

    @property
    def seed(self) -> int | None:
        """Of what is drawn; None where nothing is."""
        found: int | None = self._study.identity.get("sample", {}).get("seed")
        return found

    @property
    def runs_done(self) -> int:
        """How many rows are there."""
        return sum(chunk.runs for chunk in self.done)

    def file(self, chunk: Chunk) -> Path:
        """Where the rows of a chunk lie."""
        return self.path / RUNS / f"{chunk.name(self.key)}.parquet"

    def cut(self, extents: Sequence[Extent], each: tuple[int, int] | None) -> None:
        """Fix boundaries of chunks: before any chunk of theirs is computed."""
        if self.extents != list(extents) or self.each != each:
            self.extents, self.each = list(extents), each
            self._write_lock()

    def write(self, chunk: Chunk, computed: Computed) -> None:
        """Keep the rows of a chunk.

        Raises
        ------
        ValueFault
            They are not those of the chunk: a fault of the study.
        OutputError
            They cannot be written; what was written before stays.
        """
        frame = self._frame(chunk, computed.table)
        told = {name: str(kind) for name, kind in frame.schema.items()}
        if self._types is None:
            self._types = told
            self._write_lock()
        elif told != self._types:
            raise ValueFault(f"{chunk}: expected the columns {_listing(self._types)}, found {_listing(told)}")
        buffer = io.BytesIO()
        frame.write_parquet(buffer)
        content, target = buffer.getvalue(), self.file(chunk)
        kept = Kept(target.name, _digest(content), chunk.runs, computed.seconds, computed.made)
        with writing(self.path, "folder"):
            append(self.path / CHUNKS, json.dumps(asdict(kept), sort_keys=True) + "\n")
            put(target, content)
        self.kept[kept.file] = kept
        self.done.add(chunk)

    def _frame(self, chunk: Chunk, table: Table) -> Any:
        library = polars()
        try:
            frame = library.DataFrame({name: _series(library, name, column) for name, column in table.items()})
        except library.exceptions.PolarsError as error:
            raise ValueFault(
                f"{chunk}: expected {chunk.runs} numbers or texts a column: {visible(str(error))}"
            ) from None
        point, sample = (
            part.ravel()
            for part in np.meshgrid(
                np.arange(chunk.point, chunk.end), np.arange(chunk.first, chunk.stop), indexing="ij"
            )
        )
        expected = {"run": sample * self.points + point, "point": point, "sample": sample}
        for name, values in expected.items():
            if name not in frame.columns or not np.array_equal(frame[name].to_numpy(), values):
                raise ValueFault(f"{chunk}: expected a column {name} that numbers its {chunk.runs} runs")
        return frame.with_columns(
            library.col("run", "sample").cast(library.Int64), library.col("point").cast(library.Int32)
        )

    def _write_lock(self) -> None:
        lock = {
            "dmframe-study-lock": 1,
            "study": self._study.name,
            "key": self.key,
            "versions": dict(versions()),
            "identity": plain(self._study.identity),
            "points": self.points,
            "samples": self._study.samples,
            "each": self.each,
            "extents": [list(asdict(extent).values()) for extent in self.extents],
            "units": self._columns,
            "types": self._types,
        }
        with writing(self.path, "folder"):
            put(self.path / LOCK, encoded(json.dumps(lock, indent=1, ensure_ascii=False) + "\n"))

    def _begin(self, files: Mapping[str, bytes]) -> None:
        with writing(self.path, "folder"):
            (self.path / RUNS).mkdir(exist_ok=True)
            for name, content in files.items():
                put_below(self.path, name, content)
        self._write_lock()

    def _found(self) -> None:
        """Look at every chunk that should be there."""
        held = kept_in(self.path)
        end_line(self.path / CHUNKS)
        wanted = {f"{chunk.name(self.key)}.parquet": chunk for extent in self.extents for chunk in extent}
        wrong = list[str]()
        for item in sorted((self.path / RUNS).iterdir()):
            if is_partial(item.name) and item.is_file():
                item.unlink()  # of a process that was ended while it wrote
                continue
            chunk, kept = wanted.get(item.name), held.get(item.name)
            if chunk is not None and kept is not None and _is(item, kept.sha256):
                self.done.add(chunk)
                self.kept[item.name] = kept
            elif item.suffix == ".parquet":
                wrong.append(item.name)
                item.rename(item.with_suffix(".refused"))  # a reader of the table takes every .parquet
        if wrong:
            others = f" and {len(wrong) - 3} more" if len(wrong) > 3 else ""
            self.notices.append(
                f"{self.path / RUNS}: {', '.join(wrong[:3])}{others}: not what this study has written; set aside as "
                ".refused, and computed again where it is one of its chunks"
            )


@contextmanager
def opened(path: str | Path, study: Computable, files: Mapping[str, bytes], *, force: bool = False) -> Iterator[Store]:
    """Hold a folder for a study, new or begun before.

    Parameters
    ----------
    files
        What lies beside the runs, by name: the study, its graph.
    force
        Where the folder holds another study, throw its runs away.

    Raises
    ------
    OutputError
        Another process holds it, it holds something else, or it cannot be written.
    ValueFault
        It holds another study, or more samples of this one; the fault tells the difference.
    """
    polars()
    path = expanded(path)
    with writing(path, "folder"):
        path.mkdir(parents=True, exist_ok=True)
    with _held(path):
        store = Store(path, study)
        lock = read_lock(path)
        if lock is None:
            ours = {_HELD, RUNS, CHUNKS, PROVENANCE, PROCESSES, *(Path(name).parts[0] for name in files)}
            # partial ones are of a process that was ended while it began
            strangers = [item.name for item in path.iterdir() if item.name not in ours and not is_partial(item.name)]
            if strangers:
                raise OutputError(
                    f"{path}: expected an empty or a new folder, or one of this study, found {strangers[0]}; name "
                    "another folder"
                )
        elif changed := difference(lock, study.identity):
            if not force:
                raise ValueFault(
                    f"{path}: {changed}; name another folder, or take --force, which throws those runs away"
                )
            _clear(path)
        else:
            if study.samples < lock["samples"]:
                raise ValueFault(
                    f"{path}: holds a study of {lock['samples']} runs a point, found {study.samples}; it can grow, "
                    "not shrink; name another folder"
                )
            store.extents = [Extent(*numbers) for numbers in lock["extents"]]
            store.each = tuple(lock["each"]) if lock["each"] else None
            store._types = lock["types"]
        store._begin(files)
        with writing(path, "folder"):
            store._found()
        yield store


def _is(path: Path, sha256: str) -> bool:
    try:
        return _digest(path.read_bytes()) == sha256
    except OSError:  # a folder
        return False


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _series(library: Any, name: str, column: Any) -> Any:
    """A column of one of few kinds, the same in every chunk, whether or not a fault is among its texts."""
    if isinstance(column, np.ndarray) and column.dtype.kind in "biuf":
        if column.dtype.kind == "b":
            return library.Series(name, column, dtype=library.Boolean)
        kind = library.Int64 if name in _FIXED else library.Float64
        return library.Series(name, column).cast(kind)
    values = [None if value is None else value for value in column]
    if values and all(isinstance(value, bool | np.bool_) for value in values):
        return library.Series(name, [bool(value) for value in values], dtype=library.Boolean)
    if any(value is not None for value in values) and all(
        value is None or isinstance(value, int | float | np.number) for value in values
    ):
        return library.Series(name, values, dtype=library.Int64 if name in _FIXED else library.Float64)
    return library.Series(name, [None if value is None else str(value) for value in values], dtype=library.String)


def _listing(types: Mapping[str, str]) -> str:
    return ", ".join(f"{name} {kind}" for name, kind in types.items())


def _clear(path: Path) -> None:
    """Throw away the runs of another study, and nothing else."""
    with writing(path, "folder"):
        (path / CHUNKS).unlink(missing_ok=True)
        for item in (path / RUNS).iterdir() if (path / RUNS).is_dir() else ():
            if (item.suffix in (".parquet", ".refused") or is_partial(item.name)) and item.is_file():
                item.unlink()
        (path / LOCK).unlink(missing_ok=True)


@contextmanager
def _held(path: Path) -> Iterator[None]:
    """Hold a folder as long as this process lives, where the system can."""
    try:
        import fcntl
    except ImportError:
        yield
        return
    with writing(path, "folder"):
        descriptor = os.open(path / _HELD, os.O_RDWR | os.O_CREAT, 0o666)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise OutputError(
                f"{path}: another study runs there; wait until it has ended, or name another folder"
            ) from None
        except OSError:  # some network drives have no locks
            pass
        yield
    finally:
        os.close(descriptor)
