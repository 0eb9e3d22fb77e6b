"""The lock of a search's journal ends with its holder."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from dmframe.study.kernel_lock import KernelLock

fcntl = pytest.importorskip("fcntl")
HOLDER = """
import sys, time
from pathlib import Path
from dmframe.study.kernel_lock import journal_lock
journal_lock(Path(sys.argv[1])).acquire()
print("held", flush=True)
time.sleep(600)
"""


def busy(path: Path) -> bool:
    """True if another process has the lock now."""
    file = os.open(path, os.O_RDWR | os.O_CREAT)
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    finally:
        os.close(file)
    return False


def test_a_killed_holder_leaves_no_lock(tmp_path: Path) -> None:
    journal = tmp_path / "tune.journal"
    lock = tmp_path / "tune.journal.flock"
    holder = subprocess.Popen([sys.executable, "-c", HOLDER, str(journal)], stdout=subprocess.PIPE, text=True)
    with holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "held\n"
        assert busy(lock)
        holder.send_signal(signal.SIGKILL)
    assert not busy(lock)
    own = KernelLock(lock)
    assert own.acquire()
    assert busy(lock)
    own.release()
    assert not busy(lock)


def test_a_search_takes_it_for_each_entry_of_its_journal(tmp_path: Path) -> None:
    pytest.importorskip("optuna")
    from optuna.storages.journal import JournalFileBackend

    from dmframe.study.kernel_lock import journal_lock

    path = tmp_path / "tune.journal"
    path.touch()
    held, seen = journal_lock(path), list[bool]()
    release = held.release
    held.release = lambda: (seen.append(busy(tmp_path / "tune.journal.flock")), release())[1]
    JournalFileBackend(str(path), lock_obj=held).append_logs([{"entry": 1}])
    assert seen == [True]
    assert not path.with_name("tune.journal.lock").exists()
