"""Recorder of the inputs of a proof, by Python's audit events and by the loaded modules.

A verdict is stored only if all its inputs could be recorded. It is not if the process started another program or opened
a connection, read something that is not a regular file, or read a file that changed after the proof began.
"""

from __future__ import annotations

import importlib.util
import os
import stat
import sys
import sysconfig
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import Any, Final, final

from dmframe.common import copies
from dmframe.remembered import store
from dmframe.remembered.front import Call
from dmframe.remembered.inputs import ABSENT, states_of

PROBE: Final = "dmframe.probe"
"""The audit event of an existence check of a file, for which Python itself has none."""

OWN: Final = ("dmframe", "dmframe_blocks", "dmframe_plants")
"""Packages whose files are compared by content, wherever they are installed."""

VARIABLES: Final = (
    *("PYTHONPATH", "PYTHONHOME", "PYTHONSTARTUP", "PYTHONOPTIMIZE", "PYTHONHASHSEED", "PYTHONUTF8"),
    *("LANG", "LC_ALL", "LC_CTYPE", "LC_NUMERIC", "TZ", "HOME", "XDG_CONFIG_HOME"),
    *("LD_LIBRARY_PATH", "LD_PRELOAD", "DYLD_LIBRARY_PATH", "CASADIPATH", "ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH"),
    *("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "OPENBLAS_CORETYPE", "MKL_NUM_THREADS", "MKL_CBWR"),
)
"""Variables that libraries read without Python, or that Python read before the recorder was active."""

_REFUSED: Final = frozenset(
    (
        *(
            "subprocess.Popen",
            "os.system",
            "os.exec",
            "os.posix_spawn",
            "os.spawn",
            "os.forkpty",
            "pty.spawn",
        ),
        *("socket.connect", "socket.bind", "socket.getaddrinfo", "socket.gethostbyname", "socket.gethostname"),
        *("urllib.Request", "sqlite3.connect", "os.startfile", "winreg.OpenKey"),
    )
)
_COPIES: Final = copies.__file__
"""The module whose forked processes return a list of what they read."""
_METADATA: Final = os.path.join("importlib", "metadata", "")  # noqa: PTH118 - see front

Noted = tuple[tuple[tuple[str, str], ...], str]
"""Kind and name of each input of a job, and the reason why some are unknown, which may be empty."""

_watching: list[Any] = copies.watchers
"""Stack of recorders; the last one is active."""
_hooked: list[bool] = []


@final
class Recorder:
    """Inputs of one call, from `begin` on."""

    def __init__(self, call: Call, place: str) -> None:
        self.call, self.place = call, place
        self.refused = ""
        self.aside = list[str]()
        self._began = time.time_ns()
        self._seen, self._written = dict[tuple[str, str], None](), set[str]()
        self._known = set[tuple[str, str]]()  # what a forked process does not have to return
        self._library, self._cache = _libraries(), os.path.join(os.path.dirname(place), "")  # noqa: PTH118, PTH120

    def add(self, kind: str, name: str) -> None:
        """Record an input."""
        self._seen[kind, name] = None

    def refuse(self, reason: str) -> None:
        """Record that some inputs are unknown; the first reason is kept."""
        self.refused = self.refused or reason

    def start_in_copy(self) -> None:
        """Record in a forked process what it reads in addition."""
        self._known = set(self.names())

    def noted(self) -> Noted:
        """Inputs since the last call in a forked process."""
        new = tuple(name for name in self.names() if name not in self._known)
        self._known.update(new)
        return new, self.refused

    def adopt(self, noted: Noted) -> None:
        """Record the inputs of a forked process."""
        names, refused = noted
        for kind, name in names:
            self.add(kind, name)
        if refused:
            self.refuse(refused)

    def names(self) -> Iterator[tuple[str, str]]:
        """Kind and name of all recorded inputs."""
        with paused():
            loaded = list(_loaded(self._cache))
        yield from (*self._seen, *loaded)

    def opened(self, path: Any, flags: int) -> None:
        """Record an opened file; descriptors were opened by name before."""
        if isinstance(path, int):
            return
        name = _absolute(path)
        if flags & (os.O_WRONLY | os.O_RDWR):
            self._written.add(name)
        elif name not in self._written and not name.startswith(self._cache):
            self.add("opened", name)

    def entry(self) -> dict[str, Any] | None:
        """The inputs in their present states; None if some are unknown."""
        names = dict.fromkeys(name for key in self.names() for name in self._named(*key))
        names |= dict.fromkeys(("variable", name) for name in VARIABLES)
        for kind, name in names:
            if kind == "content" and not self.refused:
                self._check(name)
        return None if self.refused else {"inputs": states_of(names), "aside": self.aside}

    def _named(self, kind: str, name: str) -> Iterator[tuple[str, str]]:
        """An input as it is stored: the source of a compiled module, a library's file by size and time."""
        if kind != "opened":
            yield kind, name
            return
        if name.endswith(".pyc"):
            with suppress(ValueError):
                name = importlib.util.source_from_cache(name)
        place = self._library(name)
        if place != "standard":
            yield ("library" if place else "content"), name

    def _check(self, path: str) -> None:
        """Refuse anything but a regular file, and files that changed after the proof began."""
        try:
            status = os.stat(path)  # noqa: PTH116 - see front
        except OSError:
            return  # it was searched and is absent, which is a state too
        if not stat.S_ISREG(status.st_mode) and path != os.devnull:
            self.refused = f"{path} is no regular file"
        elif max(status.st_mtime_ns, status.st_ctime_ns) >= self._began:
            self.refused = f"{path} has changed since"


def _absolute(path: Any) -> str:
    return os.path.abspath(os.fsdecode(path))  # noqa: PTH100 - see front


def _libraries() -> Callable[[str], str]:
    """Owner of a file: ``library``, ``standard`` for Python's own modules, or neither."""
    paths = sysconfig.get_paths()
    standard = tuple(os.path.join(paths[key], "") for key in ("stdlib", "platstdlib"))  # noqa: PTH118 - see front
    sites = tuple(os.path.join(paths[key], "") for key in ("purelib", "platlib"))  # noqa: PTH118 - see front
    own = tuple(f"{os.sep}site-packages{os.sep}{name}{os.sep}" for name in OWN)

    def place(path: str) -> str:
        installed = f"{os.sep}site-packages{os.sep}" in path or f"{os.sep}dist-packages{os.sep}" in path
        if installed or path.startswith(sites):
            return "" if any(part in path for part in own) else "library"
        return "standard" if path.startswith(standard) else ""

    return place


def _loaded(cache: str) -> Iterator[tuple[str, str]]:
    """The files of all modules, the folders that imports searched, some of them before recording, and the shared
    libraries of the process, except those that dmframe compiled.
    """
    for folder in sys.path_importer_cache:
        yield "modules", _absolute(folder)
    yield "library", _absolute(os.__file__)
    for module in list(sys.modules.values()):
        path = vars(module).get("__file__") if hasattr(module, "__dict__") else None
        if isinstance(path, str) and not path.startswith("<"):
            yield "opened", _absolute(path)
    with suppress(OSError), open("/proc/self/maps", encoding="utf-8", errors="surrogateescape") as maps:  # noqa: PTH123
        mapped = {line.split(maxsplit=5)[-1].strip() for line in maps if "/" in line}
    for path in sorted(path for path in mapped if ".so" in path and not path.startswith(cache)):
        yield "library", path


@final
class _Watched(type(os.environ)):  # type: ignore[misc]  # the class of the environment has no public name
    """The environment of the process, in texts or bytes, which records each variable that is read."""

    def __getitem__(self, key: Any) -> Any:
        for recorder in _watching:
            recorder.add("variable", os.fsdecode(key))
        return super().__getitem__(key)

    def __iter__(self) -> Iterator[Any]:
        for recorder in _watching:
            recorder.add("variable", "")
        names: Iterator[Any] = super().__iter__()
        return names


def _watch(kind: Any) -> None:
    """Set the class of the environment, also of that in bytes, which only some systems have."""
    for environment in (os.environ, getattr(os, "environb", os.environ)):
        environment.__class__ = kind


def _hook(event: str, arguments: tuple[Any, ...]) -> None:
    if not _watching or event not in _EVENTS:
        return
    recorder, caller = _watching[-1], sys._getframe(1)
    _EVENTS[event](recorder, event, arguments, caller.f_code.co_filename)


def _open(recorder: Recorder, _: str, arguments: tuple[Any, ...], caller: str) -> None:
    recorder.opened(arguments[0], arguments[2])


def _list(recorder: Recorder, _: str, arguments: tuple[Any, ...], caller: str) -> None:
    path = arguments[0]
    if isinstance(path, int):
        recorder.refuse("a folder was listed by its descriptor")
        return
    kind = "modules" if caller.startswith("<frozen importlib") else "packages" if _METADATA in caller else "names"
    recorder.add(kind, _absolute("." if path is None else path))


def _look(recorder: Recorder, _: str, arguments: tuple[Any, ...], caller: str) -> None:
    recorder.add("probe", _absolute(arguments[0]))


def _fork(recorder: Recorder, event: str, arguments: tuple[Any, ...], caller: str) -> None:
    if caller != _COPIES:
        _refuse(recorder, event, arguments, caller)


def _refuse(recorder: Recorder, event: str, _: tuple[Any, ...], caller: str) -> None:
    recorder.refuse(f"the proof called {event}")


_EVENTS: Final[Mapping[str, Callable[[Recorder, str, tuple[Any, ...], str], None]]] = {
    "open": _open,
    "os.listdir": _list,
    "os.scandir": _list,
    PROBE: _look,
    "os.fork": _fork,
    **dict.fromkeys(_REFUSED, _refuse),
}


def begin(call: Call) -> Recorder | None:
    """Record this process from now on; None if verdicts cannot be stored."""
    place = store.folder()
    if place is None:
        return None
    recorder = Recorder(call, place)
    _watching.append(recorder)
    _watch(_Watched)
    if not _hooked:
        sys.addaudithook(_hook)
        _hooked.append(True)
    return recorder


def current() -> Recorder | None:
    """The active recorder of this process."""
    return _watching[-1] if _watching else None


@contextmanager
def paused() -> Iterator[None]:
    """Context for inputs that this process needs only to write its results."""
    watching = _watching[:]
    _watching.clear()
    try:
        yield
    finally:
        _watching[:] = watching


def end() -> Recorder | None:
    """Stop recording; return the record, or None if the recorder was not active."""
    _watch(_Watched.__base__)
    return _watching.pop() if _watching else None


def finish(text: str, summaries: list[dict[str, Any]], status: int, proved_at: str) -> bool:
    """Store the verdict of the recorded call; returns True if it was stored."""
    recorder = end()
    entry = recorder.entry() if recorder is not None else None
    if recorder is None or entry is None:
        return False
    entry |= {"text": text, "summaries": summaries, "status": status, "proved_at": proved_at}
    return store.keep(recorder.place, recorder.call.key, entry)


__all__ = ["ABSENT", "PROBE", "Recorder", "begin", "current", "end", "finish", "paused"]
