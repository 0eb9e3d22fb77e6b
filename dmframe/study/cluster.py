"""Executor with the workers of a dask scheduler, on one machine or many.

Each chunk is sent with the study, packed with the files that its graphs name: a worker needs dmframe, but neither the
user's folder nor a shared disk. A worker with other versions, or for which the study has another key, is refused.
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
from typing import TYPE_CHECKING, Any, Final, final

from dmframe.common.errors import DmframeError, MissingError, visible
from dmframe.common.interrupts import in_child
from dmframe.common.version import installing
from dmframe.study.chunks import Chunk
from dmframe.study.executor import Answer, Computed, Executor, Failed, compute, machine, versions
from dmframe.study.packing import packed, unpacked

if TYPE_CHECKING:
    from dmframe.study.plan import Study

_FRESH: Final = 2.0
"""Time for which the number of workers is cached [s]."""
_CONNECT: Final = 10.0
"""Timeout of the connection to a scheduler [s]."""


@final
class WorkersLost(DmframeError):
    """Connection to the scheduler lost; the rows computed so far are kept."""


def exposed(address: str) -> list[str]:
    """A warning if a scheduler accepts connections of other machines without authentication."""
    kind, _, place = address.rpartition("://")
    host = place.rpartition(":")[0].strip("[]")
    if not address or kind not in ("", "tcp", "ws") or host in ("localhost", "::1") or host.startswith("127."):
        return []
    return [f"{address}: anyone who can reach this scheduler can run programs as you; bind to 127.0.0.1, or use tls://"]


@final
class Cluster(Executor):
    """The workers of a dask scheduler.

    Parameters
    ----------
    address
        Address of the scheduler, ``tcp://127.0.0.1:8786``; for ``tls://`` the keys and certificates are those of dask's
        configuration.

    Raises
    ------
    MissingError
        dask.distributed is not installed.
    """

    def __init__(self, study: Study, address: str) -> None:
        try:
            import distributed
        except ImportError:
            raise MissingError(f"--scheduler: dask.distributed is not installed; {installing('study')}") from None
        self._library, self._address = distributed, address
        self._parcel, self._key = packed(study), study.key
        self._client: Any = None
        self._answers: Queue[tuple[Chunk, Any]] = Queue()
        self._out: dict[Any, Chunk] = {}
        self._count, self._counted = 0, 0.0

    @property
    def count(self) -> int:
        """How many threads the connected workers have. Raises `WorkersLost`."""
        now = time.monotonic()
        if self._client is not None and now - self._counted > _FRESH:
            self._counted = now
            try:
                self._count = sum(self._client.nthreads().values())
            except Exception:  # of any type, from a closed connection
                raise self._lost() from None
        return self._count

    def submit(self, chunk: Chunk) -> None:
        """Queue a chunk. Raises `WorkersLost`."""
        try:
            future = self._client.submit(
                work, self._parcel, self._key, versions(), chunk, key=f"dmframe-{uuid.uuid4().hex}", pure=False
            )
        except Exception:
            raise self._lost() from None
        self._out[future] = chunk
        future.add_done_callback(lambda done: self._answers.put((chunk, done)))

    def ended(self, timeout: float) -> Answer | None:
        """A finished chunk. Raises `WorkersLost`."""
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
            if kind == "KilledWorker":  # raised for every chunk that waited at a lost worker
                return Failed("each worker that computed it was ended", alone=True)
            if isinstance(error, ModuleNotFoundError) or "No module named 'dmframe" in str(error):
                raise WorkersLost("a worker has no dmframe; install the same version there") from None
            return Failed(f"{kind}: {visible(str(error))}")
        finally:
            future.release()
        if isinstance(answer, Refused):
            raise WorkersLost(answer.text)
        assert isinstance(answer, Computed | Failed)  # what `work` returns
        return answer

    def __enter__(self) -> Cluster:
        for name in ("distributed", *logging.root.manager.loggerDict):
            if name.partition(".")[0] == "distributed":  # a lost connection is reported in one sentence
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
        with suppress(Exception):  # the scheduler may have ended
            self._client.cancel(list(self._out), force=True)
        with suppress(Exception):
            self._client.close(timeout=2)

    def _lost(self) -> WorkersLost:
        return WorkersLost(f"--scheduler {self._address}: the scheduler has gone")


def _client(library: Any) -> Any:
    """Dask's client without its destructor, which waits and then warns if the connection failed."""

    class Client(library.Client):  # type: ignore[misc]
        def __del__(self) -> None:
            pass

    return Client


@final
class Refused:
    """Reason for which a worker must not compute."""

    def __init__(self, text: str) -> None:
        self.text = text


_studies: dict[str, Study] = {}
_one = threading.Lock()


def _renew() -> None:
    """Reset the state in a forked copy of a worker."""
    global _one
    _one = threading.Lock()
    _studies.clear()


in_child(_renew)


def work(parcel: bytes, key: str, wanted: Mapping[str, str], chunk: Chunk) -> Computed | Failed | Refused:
    """Task of a worker: the rows of a chunk. The worker keeps the study with its closed loops."""
    here = versions()
    other = [
        f"{name} {here.get(name)} where the client has {its}" for name, its in wanted.items() if here.get(name) != its
    ]
    if other:
        return Refused(f"a worker on {machine()['host']} has {', '.join(other)}; install the same versions there")
    digest = hashlib.sha256(parcel).hexdigest()
    with _one:  # a worker with several threads computes one chunk at a time
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
