"""A lock among processes that the system gives back when its holder dies, however it dies."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, final

from dmframe.files import writing


@final
class KernelLock:
    """``flock`` on a file beside what is locked, in the form that Optuna asks for: `acquire` and `release`.

    Optuna's own lock is a file that exists while it is held. That of a killed process stays, and stalls the next for
    half a minute. Here the file may stay: only its lock counts.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._held = path, -1

    def acquire(self) -> bool:
        """Wait for it."""
        import fcntl

        with writing(self._path, "file"):
            file = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        try:
            fcntl.flock(file, fcntl.LOCK_EX)
        except BaseException:
            os.close(file)
            raise
        self._held = file
        return True

    def release(self) -> None:
        """Give it back."""
        file, self._held = self._held, -1
        os.close(file)


def journal_lock(path: Path) -> Any:
    """Of a journal: the system's, or Optuna's own where the system has none such."""
    try:
        import fcntl  # noqa: F401 - none on Windows
    except ImportError:
        from optuna.storages.journal import JournalFileOpenLock

        return JournalFileOpenLock(str(path))
    return KernelLock(path.with_name(f"{path.name}.flock"))
