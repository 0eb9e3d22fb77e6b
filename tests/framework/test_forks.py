"""Forks of a process in which another thread held a lock."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

pytestmark = pytest.mark.skipif(not hasattr(os, "pidfd_open"), reason="needs Linux")

BUSY = """
import os, select, signal, threading, time, warnings
from functools import cached_property
{before}
import dmframe.common.interrupts as own
from dmframe.common.interrupts import Insistent
warnings.simplefilter("ignore")

class Kept:
    @cached_property
    def slow(self):
        time.sleep(0.0005)
        return 1

own.Kept = Kept
lock, going = Insistent(), True

def busy():
    while going:
        with lock:
            Kept().slow

threads = [threading.Thread(target=busy) for _ in range(2)]
for thread in threads:
    thread.start()
hung = 0
for _ in range(200):
    child = os.fork()
    if child == 0:
        with lock:
            Kept().slow
        os._exit(0)
    watch = os.pidfd_open(child)
    if not select.select([watch], [], [], {patience})[0]:
        hung += 1
        os.kill(child, signal.SIGKILL)
        print(hung, flush=True)
        os._exit(0)
    os.waitpid(child, 0)
    os.close(watch)
print(hung, flush=True)
os._exit(0)
"""


def hung(before: str = "", patience: float = 3.0) -> int:
    """1 if one of 200 forked processes did not end."""
    words = [sys.executable, "-c", BUSY.format(before=before, patience=patience)]
    return int(subprocess.run(words, capture_output=True, text=True, check=True).stdout)


def test_200_forks_with_running_threads_end() -> None:
    assert hung() == 0


def test_without_new_locks_a_copy_hangs() -> None:
    assert hung("os.register_at_fork = lambda **_: None", patience=1.5) == 1


def test_the_thread_that_makes_a_copy_keeps_what_it_holds() -> None:
    source = """
import os
from dmframe.common.interrupts import Insistent
lock = Insistent()
with lock:
    child = os.fork()
if child == 0:
    with lock:
        os._exit(7)
print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""
    done = subprocess.run([sys.executable, "-c", source], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "7"


def test_the_lock_of_a_worker_is_free_in_a_copy() -> None:
    source = """
import os, threading
from dmframe.study import cluster
held = threading.Event()

def hold():
    with cluster._one:
        held.set()
        threading.Event().wait()

threading.Thread(target=hold, daemon=True).start()
held.wait()
child = os.fork()
if child == 0:
    os._exit(0 if cluster._one.acquire(timeout=5) else 1)
print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""
    done = subprocess.run([sys.executable, "-W", "ignore", "-c", source], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "0"
