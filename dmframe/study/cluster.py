"""Workers of a dask scheduler, on one machine or many.

With each chunk goes the study itself, packed with the files that its graph names: a worker needs dmframe, and neither
the user's folder nor a shared disk. What computes must be the same everywhere: a worker with other versions, or for
which the study has another key, is refused.
"""

from __future__ import annotations

import hashlib
import logging
import threading
import time
import uuid
from collections.abc import Mapping
from contextlib import suppress
from queue import Empty, Queue
from typing import Any, Final, final

from dmframe.errors import DmframeError, MissingError, visible
from dmframe.interrupts import in_child
from dmframe.study.beside import packed, unpacked
from dmframe.study.chunks import Chunk
from dmframe.study.computed import Computable, Computed, Failed, compute, versions
from dmframe.study.pool import Answer

_FRESH: Final = 2.0
"""For so long the number of workers is not asked for again [s]."""
_CONNECT: Final = 10.0
"""How long a scheduler may take to answer [s]."""


@final
class WorkersLost(DmframeError):
    """The scheduler cannot be reached, or has gone: what was computed stays."""


def exposed(address: str) -> list[str]:
    """A notice where a scheduler listens to others than this machine, and to everybody."""
    kind, _, place = address.rpartition("://")
    host = place.rpartition(":")[0].strip("[]")
    if not address or kind not in ("", "tcp", "ws") or host in ("localhost", "::1") or host.startswith("127."):
        return []
    return [f"{address}: whoever reaches this scheduler can run programs as you; listen on 127.0.0.1, or use tls://"]


@final
class Cluster:
    """The workers of a dask scheduler, as `Workers`.

    Parameters
    ----------
    address
        Of the scheduler, ``tcp://127.0.0.1:8786``; with ``tls://`` keys and certificates are those of dask's own
        configuration.

    Raises
    ------
    MissingError
        dask.distributed is not installed.
    """

    def __init__(self, study: Computable, address: str) -> None:
        try:
            import distributed
        except ImportError:
            raise MissingError('--scheduler: dask.distributed is not installed; pip install "dmframe[study]"') from None
        self._library, self._address = distributed, address
        self._parcel, self._key = packed(study), study.key
        self._client: Any = None
        self._answers: Queue[tuple[Chunk, Any]] = Queue()
        self._out: dict[Any, Chunk] = {}
        self._count, self._asked = 0, 0.0

    @property
    def count(self) -> int:
        """How many threads the workers have that are there now. Raises `WorkersLost`."""
        now = time.monotonic()
        if self._client is not None and now - self._asked > _FRESH:
            self._asked = now
            try:
                self._count = sum(self._client.nthreads().values())
            except Exception:  # whatever a connection raises that has ended
                raise self._lost() from None
        return self._count

    def submit(self, chunk: Chunk) -> None:
        """Let a chunk be computed. Raises `WorkersLost`."""
        try:
            future = self._client.submit(
                work, self._parcel, self._key, versions(), chunk, key=f"dmframe-{uuid.uuid4().hex}", pure=False
            )
        except Exception:
            raise self._lost() from None
        self._out[future] = chunk
        future.add_done_callback(lambda done: self._answers.put((chunk, done)))

    def ended(self, timeout: float) -> Answer | None:
        """A chunk that has ended. Raises `WorkersLost`."""
        try:
            chunk, future = self._answers.get(timeout=timeout)
        except Empty:
            if self._client.status != "running":
                raise self._lost() from None
            return None
        self._out.pop(future, None)
        return chunk, self._answer(future)

    def _answer(self, future: Any) -> Computed | Failed:
        try:
            answer = future.result(timeout=_CONNECT)
        except Exception as error:
            if future.status in ("cancelled", "lost") or self._client.status != "running":
                raise self._lost() from None
            kind = type(error).__name__
            if kind == "KilledWorker":  # of several workers, and of each all chunks that waited there
                return Failed("each worker that computed it was ended", alone=True)
            if isinstance(error, ModuleNotFoundError) or "No module named 'dmframe" in str(error):
                raise WorkersLost("a worker has no dmframe; install the same version there") from None
            return Failed(f"{kind}: {visible(str(error))}")
        finally:
            future.release()
        if isinstance(answer, Refused):
            raise WorkersLost(answer.text)
        assert isinstance(answer, Computed | Failed)  # that is what `work` returns
        return answer

    def __enter__(self) -> Cluster:
        for name in ("distributed", *logging.root.manager.loggerDict):
            if name.partition(".")[0] == "distributed":  # what is lost is told in one sentence
                logging.getLogger(name).setLevel(logging.CRITICAL)
        try:
            self._client = _client(self._library)(
                self._address, timeout=_CONNECT, set_as_default=False, name="dmframe-study"
            )
        except Exception as error:
            reason = visible((str(error).splitlines() or [type(error).__name__])[0])
            raise WorkersLost(f"--scheduler {self._address}: no scheduler answers there: {reason}") from None
        return self

    def __exit__(self, *_: object) -> None:
        with suppress(Exception):  # of a scheduler that has gone
            self._client.cancel(list(self._out), force=True)
        with suppress(Exception):
            self._client.close(timeout=2)

    def _lost(self) -> WorkersLost:
        return WorkersLost(f"--scheduler {self._address}: the scheduler has gone")


def _client(library: Any) -> Any:
    """Dask's client, but for its end where it could not connect: there it waits, and then complains."""

    class Client(library.Client):  # type: ignore[misc]
        def __del__(self) -> None:
            pass

    return Client


@final
class Refused:
    """A worker that must not compute, and why."""

    def __init__(self, text: str) -> None:
        self.text = text


_studies: dict[str, Computable] = {}
_one = threading.Lock()


def _renew() -> None:
    """In a copy of a worker: no chunk is computed there, and what one has begun to prepare is not used."""
    global _one
    _one = threading.Lock()
    _studies.clear()


in_child(_renew)


def work(parcel: bytes, key: str, wanted: Mapping[str, str], chunk: Chunk) -> Computed | Failed | Refused:
    """In a worker: the rows of a chunk. The study stays in the process, with the diagrams that it has prepared."""
    here = versions()
    other = [
        f"{name} {here.get(name)} where the client has {its}" for name, its in wanted.items() if here.get(name) != its
    ]
    if other:
        from dmframe.study.computed import machine

        return Refused(f"a worker on {machine()['host']} has {', '.join(other)}; install the same versions there")
    digest = hashlib.sha256(parcel).hexdigest()
    with _one:  # a worker of several threads computes one chunk after another
        if digest not in _studies:
            try:
                study = unpacked(parcel)
            except Exception as error:
                return Failed(
                    f"the study cannot be read by a worker: {type(error).__name__}: {visible(str(error))}", final=True
                )
            if study.key != key:
                return Refused(
                    "a worker reads another study than the client: a block's source, or the robot's file differs there"
                )
            _studies.clear()  # one study at a time: diagrams are large
            _studies[digest] = study
        return compute(_studies[digest], chunk)
