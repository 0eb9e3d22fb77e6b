"""Folder of a study: one Parquet file per chunk, written atomically by one process at a time.

A chunk's file is written under a temporary name, flushed to disk and renamed; a line of ``chunks.jsonl``, written
before the renaming, holds its digest and what made it. A file that does not match its line is computed again.
"""

from __future__ import annotations

import io
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np

from dmframe.common.errors import MissingError, OutputError, ValueFault, visible
from dmframe.common.files import append, encoded, expanded, put, writing
from dmframe.common.seal import digest
from dmframe.common.version import installing
from dmframe.study.chunks import Chunk, Extent
from dmframe.study.executor import Computed, versions
from dmframe.study.journal import (
    CHUNKS,
    LOCK,
    ChunkEntry,
    difference,
    end_line,
    entries_in,
    is_partial,
    plain,
    put_below,
    read_lock,
)
from dmframe.study.kernel_lock import FOLDER_LOCK, exclusive

if TYPE_CHECKING:
    from dmframe.study.plan import Study

RUNS: Final = "runs"
PROVENANCE: Final = "provenance.json"
PROCESSES: Final = "processes.jsonl"
ROW: Final = ("run", "point", "sample")
"""Columns of integers that identify a run."""


def polars() -> Any:
    """The package of tables. Raises `MissingError` if it is not installed."""
    try:
        import polars
    except ImportError:
        raise MissingError(f"study: polars is not installed; {installing('study')}") from None
    return polars


@final
class Store:
    """A folder opened for one study; see `opened`.

    Attributes
    ----------
    extents, each
        Division of the runs into chunks, see `Sizes`.
    done
        Chunks whose rows are in the folder.
    notices
        Warnings about existing files of the folder.
    """

    def __init__(self, path: Path, study: Study) -> None:
        self.path, self.key, self.points = path, study.key, len(study.points)
        self.extents: list[Extent] = []
        self.each: tuple[int, int] | None = None
        self.done = set[Chunk]()
        self.kept = dict[str, ChunkEntry]()
        self.notices: list[str] = []
        self._columns = {column.name: column.unit for column in (*study.varied, *study.measures)}
        self._types: dict[str, str] | None = None
        self._study = study

    @property
    def seed(self) -> int | None:
        """Seed of the samples; None if nothing is sampled."""
        found: int | None = self._study.identity.get("sample", {}).get("seed")
        return found

    @property
    def runs_done(self) -> int:
        """Number of rows in the folder."""
        return sum(chunk.runs for chunk in self.done)

    def file(self, chunk: Chunk) -> Path:
        """File of a chunk."""
        return self.path / RUNS / f"{chunk.name(self.key)}.parquet"

    def cut(self, extents: Sequence[Extent], each: tuple[int, int] | None) -> None:
        """Fix the boundaries of chunks, before any of them is computed."""
        if self.extents != list(extents) or self.each != each:
            self.extents, self.each = list(extents), each
            self._write_lock()

    def write(self, chunk: Chunk, computed: Computed) -> None:
        """Write the rows of a chunk.

        Raises
        ------
        ValueFault
            They are not the rows of that chunk: a fault of the study.
        OutputError
            They cannot be written; earlier chunks are not affected.
        """
        frame = self._frame(chunk, computed.table)
        types = {name: str(kind) for name, kind in frame.schema.items()}
        if self._types is None:
            self._types = types
            self._write_lock()
        elif types != self._types:
            raise ValueFault(f"{chunk}: expected the columns {_listing(self._types)}, found {_listing(types)}")
        buffer = io.BytesIO()
        frame.write_parquet(buffer)
        content, target = buffer.getvalue(), self.file(chunk)
        kept = ChunkEntry(target.name, digest(content), chunk.runs, computed.seconds, computed.made)
        with writing(self.path, "folder"):
            append(self.path / CHUNKS, json.dumps(asdict(kept), sort_keys=True) + "\n")
            put(target, content)
        self.kept[kept.file] = kept
        self.done.add(chunk)

    def _frame(self, chunk: Chunk, table: Mapping[str, Any]) -> Any:
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
        """Check every chunk against its line in the journal."""
        lines = entries_in(self.path)
        end_line(self.path / CHUNKS)
        wanted = {f"{chunk.name(self.key)}.parquet": chunk for extent in self.extents for chunk in extent}
        wrong = list[str]()
        for item in sorted((self.path / RUNS).iterdir()):
            if is_partial(item.name) and item.is_file():
                item.unlink()  # of a process that was ended
                continue
            chunk, kept = wanted.get(item.name), lines.get(item.name)
            if chunk is not None and kept is not None and _is(item, kept.sha256):
                self.done.add(chunk)
                self.kept[item.name] = kept
            elif item.suffix == ".parquet":
                wrong.append(item.name)
                item.rename(item.with_suffix(".refused"))  # readers of the table take every .parquet
        if wrong:
            others = f" and {len(wrong) - 3} more" if len(wrong) > 3 else ""
            self.notices.append(
                f"{self.path / RUNS}: {', '.join(wrong[:3])}{others}: not written by this study; renamed to "
                ".refused, and recomputed if a chunk of the study"
            )


@contextmanager
def opened(path: str | Path, study: Study, files: Mapping[str, bytes], *, force: bool = False) -> Iterator[Store]:
    """Open a new or existing folder of a study, and lock it against other processes.

    Parameters
    ----------
    files
        Files next to the runs, by name: the study, its graphs.
    force
        Delete the runs of another study in the folder.

    Raises
    ------
    OutputError
        Another process uses the folder, it contains other files, or it cannot be written.
    ValueFault
        It contains another study, or more samples of this one; the message names the difference.
    """
    polars()
    path = expanded(path)
    with writing(path, "folder"):
        path.mkdir(parents=True, exist_ok=True)
    with exclusive(path):
        store = Store(path, study)
        lock = read_lock(path)
        if lock is None:
            ours = {FOLDER_LOCK, RUNS, CHUNKS, PROVENANCE, PROCESSES, *(Path(name).parts[0] for name in files)}
            # partial files are of processes that were ended
            others = [item.name for item in path.iterdir() if item.name not in ours and not is_partial(item.name)]
            if others:
                raise OutputError(
                    f"{path}: expected an empty or a new folder, or one of this study, found {others[0]}; name "
                    "another folder"
                )
        elif changed := difference(lock, study.identity):
            if not force:
                raise ValueFault(f"{path}: {changed}; name another folder, or use --force, which deletes those runs")
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
        return digest(path.read_bytes()) == sha256
    except OSError:  # a folder
        return False


def _series(library: Any, name: str, column: Any) -> Any:
    """A column with a type that does not depend on the chunk, nor on whether there is a fault among its texts."""
    values = np.asarray(column)
    if values.dtype.kind not in "biuf":
        return library.Series(name, [None if item is None else str(item) for item in column], dtype=library.String)
    kind = library.Int64 if name in ROW else library.Boolean if values.dtype.kind == "b" else library.Float64
    return library.Series(name, values).cast(kind)


def _listing(types: Mapping[str, str]) -> str:
    return ", ".join(f"{name} {kind}" for name, kind in types.items())


def _clear(path: Path) -> None:
    """Delete the runs of another study, and nothing else."""
    with writing(path, "folder"):
        (path / CHUNKS).unlink(missing_ok=True)
        for item in (path / RUNS).iterdir() if (path / RUNS).is_dir() else ():
            if (item.suffix in (".parquet", ".refused") or is_partial(item.name)) and item.is_file():
                item.unlink()
        (path / LOCK).unlink(missing_ok=True)
