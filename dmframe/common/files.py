"""Atomic writing of files, with errors that name the file."""

from __future__ import annotations

import errno
import os
import stat
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from typing import IO, Final

from dmframe.common.errors import OutputError

FULL: Final = (errno.ENOSPC, getattr(errno, "EDQUOT", errno.ENOSPC), errno.EFBIG)
EXISTS: Final = "exists already; choose a new file"
ROBOT_FILES: Final = (".urdf", ".xacro", ".xml", ".mjcf")
"""Endings of the names of robot files."""


def encoded(text: str) -> bytes:
    r"""UTF-8 of a text; lone surrogates, as of an undecodable byte in a file name, become ``\udcff``."""
    return text.encode("utf-8", "backslashreplace")


def printable(text: str) -> str:
    """A text that every library can encode."""
    return encoded(text).decode("utf-8")


def hidden_name() -> str:
    """Short temporary name of an incomplete file or folder."""
    return f".dmframe-{os.urandom(4).hex()}.part"


def is_hidden(name: str) -> bool:
    """True for a name of `hidden_name`."""
    return name.startswith(".dmframe-") and name.endswith(".part")


def made_distinct(names: Iterable[str], numbered: Callable[[str, int], str]) -> list[str]:
    """Make names unique, case-insensitively: repetitions are `numbered` from 2 on."""
    taken = dict[str, str]()
    for first in names:
        name, count = first, 2
        while name.casefold() in taken:
            name, count = numbered(first, count), count + 1
        taken[name.casefold()] = name
    return list(taken.values())


def reason(error: OSError) -> str:
    """Message of the operating system, without the file name."""
    return (error.strerror or str(error)).lower()


def probed(path: Path) -> None:
    """Announce a look whether a file is there, for `dmframe.remembered`: the look itself raises no audit event."""
    sys.audit("dmframe.probe", str(path))


def expanded(path: str | Path) -> Path:
    """A path with ``~`` expanded. Raises `OutputError` for an unknown user."""
    if not isinstance(path, str | Path) or "\0" in str(path):
        raise OutputError(f"expected a path, found {path!r:.60}")
    try:
        return Path(path).expanduser()
    except RuntimeError:
        raise OutputError(f"{path}: unknown user; give the full path") from None


def check_place(path: str | Path) -> None:
    """Raise `OutputError` if the file cannot be written; call it before long computations."""
    path = Path(path)
    with writing(path):
        try:
            there, mode = path, path.stat().st_mode
        except (FileNotFoundError, NotADirectoryError):
            # for a link, the folder of its target
            there = path.parent if not path.parent.is_dir() else Path(os.path.realpath(path)).parent
            mode = 0
        if stat.S_ISDIR(mode):
            raise OutputError(f"{path}: expected a file, found a folder; choose a file in it")
        if not mode and not there.is_dir():
            raise OutputError(f"{path}: the folder {there} does not exist; create it first, or choose another")
        if not os.access(there, os.W_OK):  # also for a file, which could be replaced with the folder's permissions only
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))


def is_file(path: str | Path) -> bool:
    """True for an existing file; unlike `Path.is_file`, also False for a name that is too long."""
    try:
        return Path(path).is_file()
    except OSError:
        return False


def write_text(path: str | Path, text: str, *, new: bool = False) -> None:
    """Write a text; see `write_bytes`."""
    write_bytes(path, encoded(text), new=new)


def write_bytes(path: str | Path, content: bytes, *, new: bool = False) -> None:
    """Write a file atomically; the old one stays if writing fails.

    Links are followed, and an existing file keeps its mode. A device or a pipe is written to and not replaced.

    Parameters
    ----------
    new
        The file must not exist.

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    path = Path(path)
    check_place(path)
    with _claimed(path) if new else nullcontext(), writing(path):
        if path.is_file() or not path.exists():
            put(Path(os.path.realpath(path)), content)
        else:
            with path.open("wb") as device:
                device.write(content)


def check_new(path: Path) -> None:
    """Raise `OutputError` if the file exists already: before something else is written, as `write_text` does later."""
    if path.exists():
        raise OutputError(f"{path}: {EXISTS}")


def contains(path: Path, text: str) -> bool:
    """True if the file exists and its content is this text."""
    try:
        return path.read_bytes() == encoded(text)
    except OSError:
        return False


def put(target: Path, content: bytes) -> None:
    """Create or replace a regular file, and sync it to the disk.

    The content is on the disk before the name, so that a power failure leaves the old file or the new one.
    """
    old = target.stat() if target.exists() else None
    temporary = target.with_name(hidden_name())
    try:
        with os.fdopen(os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666), "wb") as file:
            file.write(content)
            forced(file)
        if old is not None:
            with suppress(OSError, AttributeError):  # only root may, and not on every system
                os.chown(temporary, old.st_uid, old.st_gid)
            temporary.chmod(stat.S_IMODE(old.st_mode))
        temporary.replace(target)
    except BaseException:
        with suppress(OSError):
            temporary.unlink()
        raise
    sync(target.parent)


def append(target: Path, line: str) -> None:
    """Append a line to a file, and sync it to the disk."""
    with target.open("ab") as file:
        file.write(encoded(line))
        forced(file)


def forced(file: IO[bytes]) -> None:
    """Sync an open file to the disk."""
    file.flush()
    os.fsync(file.fileno())


def sync(folder: Path) -> None:
    """Sync the names in a folder to the disk, if the system supports it."""
    if hasattr(os, "O_DIRECTORY"):
        with suppress(OSError):  # some network drives refuse it for folders, and a folder may be writable only
            descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
            try:
                os.fsync(descriptor)
            finally:
                os.close(descriptor)


def sync_below(folder: Path) -> None:
    """Sync all files and names below a folder to the disk."""
    for place, _, names in os.walk(folder, topdown=False):
        for name in names:
            with Path(place, name).open("rb+") as file:
                os.fsync(file.fileno())
        sync(Path(place))


@contextmanager
def _claimed(path: Path) -> Iterator[None]:
    """Reserve the name of a new file by an empty one, which is deleted if writing fails."""
    with writing(path):
        try:
            os.close(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666))
        except FileExistsError:
            raise OutputError(f"{path}: {EXISTS}") from None
    try:
        yield
    except BaseException:
        with suppress(OSError):
            path.unlink()
        raise


def flocked(path: Path, flags: int, busy: str = "") -> int | None:
    """Open a file or a folder, and lock it until the descriptor is closed or this process ends; None without locks.

    It waits for another process that has the lock or, with the message `busy`, raises `OutputError`.
    """
    try:
        import fcntl
    except ImportError:
        return None
    descriptor = os.open(path, flags, 0o666)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | (fcntl.LOCK_NB if busy else 0))
    except BlockingIOError:
        os.close(descriptor)
        raise OutputError(busy) from None
    except OSError:  # some network drives have no locks
        os.close(descriptor)
        return None
    except BaseException:
        os.close(descriptor)
        raise
    return descriptor


@contextmanager
def writing(path: str | Path, kind: str = "file") -> Iterator[None]:
    """Convert an error of the operating system to an `OutputError` that names the file and its `kind`."""
    try:
        yield
    except OSError as error:
        thing = "file" if kind == "file" else "folder"
        hint = f"choose another {thing}"
        if error.errno in FULL:
            hint = f"free some space, or choose a {thing} on another disk"
        elif error.errno == errno.ENAMETOOLONG:
            hint = "choose a shorter name"
        what = {"file": "", "folder": "the results ", "figures": "signals and summary are written, the figures "}[kind]
        raise OutputError(f"{path}: {what}cannot be written: {reason(error)}; {hint}") from error
