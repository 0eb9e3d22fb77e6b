"""A process of the pool: it takes chunks from standard input, and answers with their rows on standard output.

It ends when its standard input does: with the process that started it, however that one ended.
"""

from __future__ import annotations

import os
import pickle
import signal
import sys
import threading
from queue import SimpleQueue
from typing import Any, Final

READY: Final = "ready"


def serve() -> None:
    """Work until nothing more comes: first a pickled study, then chunks."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the process that started this one
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a block prints must not fall among the answers
    inbox = SimpleQueue[Any]()
    threading.Thread(target=_listen, args=(inbox,), daemon=True).start()

    from dmframe.study.computed import compute

    try:
        study = pickle.loads(inbox.get())
    except Exception as error:
        sys.stderr.write(f"{type(error).__name__}: {' '.join(str(error).split())}\n")
        sys.stderr.flush()
        os._exit(1)  # Python's own end would wait for the thread that listens
    _answer(answers, READY)
    while True:
        _answer(answers, compute(study, inbox.get()))


def _answer(answers: Any, what: object) -> None:
    try:
        pickle.dump(what, answers, protocol=pickle.HIGHEST_PROTOCOL)
        answers.flush()
    except BrokenPipeError:
        os._exit(0)


def _listen(inbox: SimpleQueue[Any]) -> None:
    """In a thread of its own, so that the end of the input is heard while a chunk is computed."""
    while True:
        try:
            inbox.put(pickle.load(sys.stdin.buffer))
        except EOFError:
            os._exit(0)
        except pickle.UnpicklingError:  # cut off: whoever wrote was ended
            os._exit(1)
