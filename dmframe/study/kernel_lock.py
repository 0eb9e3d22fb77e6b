"""File locks that the operating system releases when their process ends."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, final

from dmframe.common.files import flocked, writing

FOLDER_LOCK: Final = ".dmframe-study.lock"
"""The file that is locked while a process writes to a study's folder."""


@final
class KernelLock:
    """``flock`` on a file next to the locked one, with Optuna's interface: `acquire` and `release`.

    Optuna's lock is a file that exists while the lock is taken: after a killed process it remains, and delays the next
    one for half a minute. A `flock` is released with its process.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._descriptor: int | None = None

    def acquire(self) -> bool:
        """Wait for the lock."""
        with writing(self._path, "file"):
            self._descriptor = flocked(self._path, os.O_RDWR | os.O_CREAT)
        return True

    def release(self) -> None:
        """Release the lock."""
        file, self._descriptor = self._descriptor, None
        if file is not None:
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
def exclusive(folder: Path) -> Iterator[None]:
    """Lock a folder while this process uses it, if the system has ``flock``. Raises `OutputError` if it is locked."""
    busy = f"{folder}: another study or race runs there; wait until it has ended, or name another folder"
    with writing(folder, "folder"):
        descriptor = flocked(folder / FOLDER_LOCK, os.O_RDWR | os.O_CREAT, busy)
    try:
        yield
    finally:
        if descriptor is not None:
            os.close(descriptor)
