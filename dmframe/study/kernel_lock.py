"""Locks among processes that the operating system releases when their owner ends, however it ends."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, final

from dmframe.errors import OutputError
from dmframe.files import writing

FOLDER_LOCK: Final = ".dmframe-study.lock"
"""The file that is locked while a process writes to a study's folder."""


@final
class KernelLock:
    """``flock`` on a file next to the locked one, with Optuna's interface: `acquire` and `release`.

    Optuna's own lock is a file that exists while the lock is taken: the file of a killed process stays, and delays the
    next one for half a minute. Here the file may stay.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._descriptor = path, -1

    def acquire(self) -> bool:
        """Wait for the lock."""
        import fcntl

        with writing(self._path, "file"):
            file = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        try:
            fcntl.flock(file, fcntl.LOCK_EX)
        except BaseException:
            os.close(file)
            raise
        self._descriptor = file
        return True

    def release(self) -> None:
        """Release the lock."""
        file, self._descriptor = self._descriptor, -1
        os.close(file)


def journal_lock(path: Path) -> Any:
    """The lock of a journal: the system's, or Optuna's own on a system without ``flock``."""
    try:
        import fcntl  # noqa: F401 - not on Windows
    except ImportError:
        from optuna.storages.journal import JournalFileOpenLock

        return JournalFileOpenLock(str(path))
    return KernelLock(path.with_name(f"{path.name}.flock"))


@contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """Lock a folder while this process uses it, if the system has ``flock``. Raises `OutputError` if it is locked."""
    try:
        import fcntl
    except ImportError:
        yield
        return
    with writing(folder, "folder"):
        descriptor = os.open(folder / FOLDER_LOCK, os.O_RDWR | os.O_CREAT, 0o666)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise OutputError(
                f"{folder}: another study runs there; wait until it has ended, or name another folder"
            ) from None
        except OSError:  # some network drives have no locks
            pass
        yield
    finally:
        os.close(descriptor)
