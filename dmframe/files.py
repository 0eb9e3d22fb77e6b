"""Files that a user names: written in full or not at all, and every fault names its file."""

from __future__ import annotations

import errno
import os
import stat
import uuid
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from typing import IO, Final

from dmframe.errors import OutputError

FULL: Final = (errno.ENOSPC, getattr(errno, "EDQUOT", errno.ENOSPC), errno.EFBIG)


def encoded(text: str) -> bytes:
    r"""A text as UTF-8; what is none, such as a byte of a file's name that nobody can decode, becomes ``\udcff``."""
    return text.encode("utf-8", "backslashreplace")


def printable(text: str) -> str:
    """A text that every library can encode."""
    return encoded(text).decode("utf-8")


def hidden_name() -> str:
    """A name for what is not whole yet: short, whatever the name that it will bear."""
    return f".dmframe-{uuid.uuid4().hex[:8]}.part"


def is_hidden(name: str) -> bool:
    """True for one of `hidden_name`."""
    return name.startswith(".dmframe-") and name.endswith(".part")


def told_apart(names: Iterable[str], numbered: Callable[[str, int], str]) -> list[str]:
    """The names, each `numbered` from 2 on that is one before it, also on systems that do not tell capitals apart."""
    taken = dict[str, str]()
    for first in names:
        name, count = first, 2
        while name.casefold() in taken:
            name, count = numbered(first, count), count + 1
        taken[name.casefold()] = name
    return list(taken.values())


def reason(error: OSError) -> str:
    """What the operating system says, without the name."""
    return (error.strerror or str(error)).lower()


def expanded(path: str | Path) -> Path:
    """A path with ``~`` as the user's home. Raises `OutputError` for one of a user that there is not."""
    if not isinstance(path, str | Path) or "\0" in str(path):
        raise OutputError(f"expected a path, found {path!r:.60}")
    try:
        return Path(path).expanduser()
    except RuntimeError:
        raise OutputError(f"{path}: found no home of that user; name the whole path") from None


def check_place(path: str | Path) -> None:
    """Raise `OutputError` where no file of that name can be: to be asked before anything is computed."""
    path = Path(path)
    with writing(path):
        try:
            there, mode = path, path.stat().st_mode
        except (FileNotFoundError, NotADirectoryError):
            # of a link, the folder to which it leads
            there = path.parent if not path.parent.is_dir() else Path(os.path.realpath(path)).parent
            mode = 0
        if stat.S_ISDIR(mode):
            raise OutputError(f"{path}: expected a file, found a folder; name a file in it")
        if not mode and not there.is_dir():
            raise OutputError(f"{path}: the folder {there} does not exist; make it first, or name another")
        if not os.access(there, os.W_OK):  # of a file, too: its folder's rights alone would let it be replaced
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))


def is_file(path: str | Path) -> bool:
    """True for a file that is there. Never raises, as `Path.is_file` does for a name that is too long."""
    try:
        return Path(path).is_file()
    except OSError:
        return False


def write_text(path: str | Path, text: str, *, new: bool = False) -> None:
    """Write a text; see `write_bytes`."""
    write_bytes(path, encoded(text), new=new)


def write_bytes(path: str | Path, content: bytes, *, new: bool = False) -> None:
    """Write a file in one step, so that there is never half a one, and the old one stays where writing fails.

    A link is followed, and a file that was there keeps its mode. What is no regular file, such as a device or a pipe,
    is written to and not replaced.

    Parameters
    ----------
    new
        The file must not be there yet.

    Raises
    ------
    OutputError
        It cannot be written.
    """
    path = Path(path)
    check_place(path)
    with _claimed(path) if new else nullcontext(), writing(path):
        if path.is_file() or not path.exists():
            put(Path(os.path.realpath(path)), content)
        else:
            with path.open("wb") as device:
                device.write(content)


def put(target: Path, content: bytes) -> None:
    """Put a regular file in the place of the one that is there, if any, and force it to the disk.

    The content is on the disk before the name is, so that a power cut leaves the old file or the new one.
    """
    old = target.stat() if target.exists() else None
    beside = target.with_name(hidden_name())
    try:
        with os.fdopen(os.open(beside, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666), "wb") as file:
            file.write(content)
            forced(file)
        if old is not None:
            with suppress(OSError, AttributeError):  # only root may, and not on every system
                os.chown(beside, old.st_uid, old.st_gid)
            beside.chmod(stat.S_IMODE(old.st_mode))
        beside.replace(target)
    except BaseException:
        with suppress(OSError):
            beside.unlink()
        raise
    sync(target.parent)


def append(target: Path, line: str) -> None:
    """Add a line to a file, and force it to the disk."""
    with target.open("ab") as file:
        file.write(encoded(line))
        forced(file)


def forced(file: IO[bytes]) -> None:
    """Force what was written to an open file to the disk."""
    file.flush()
    os.fsync(file.fileno())


def sync(folder: Path) -> None:
    """Force the names in a folder to the disk, where the system can."""
    if hasattr(os, "O_DIRECTORY"):
        with suppress(OSError):  # some network drives refuse it of folders, and a user may write to one and not read it
            descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
            try:
                os.fsync(descriptor)
            finally:
                os.close(descriptor)


def sync_below(folder: Path) -> None:
    """Force all files and names below a folder to the disk."""
    for place, _, names in os.walk(folder, topdown=False):
        for name in names:
            with Path(place, name).open("rb+") as file:
                os.fsync(file.fileno())
        sync(Path(place))


@contextmanager
def _claimed(path: Path) -> Iterator[None]:
    """Hold the name of a new file with an empty one, which vanishes when it is not written."""
    with writing(path):
        try:
            os.close(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666))
        except FileExistsError:
            raise OutputError(f"{path}: expected a new file, found one; name another") from None
    try:
        yield
    except BaseException:
        with suppress(OSError):
            path.unlink()
        raise


@contextmanager
def writing(path: str | Path, kind: str = "file") -> Iterator[None]:
    """A fault of the operating system as an `OutputError` that names what was to be written, `kind`."""
    try:
        yield
    except OSError as error:
        thing = "file" if kind == "file" else "folder"
        hint = f"name another {thing}"
        if error.errno in FULL:
            hint = f"free some space, or name a {thing} on another disk"
        elif error.errno == errno.ENAMETOOLONG:
            hint = "name a shorter one"
        what = {"file": "", "folder": "the results ", "figures": "signals and summary are written, the figures "}[kind]
        raise OutputError(f"{path}: {what}cannot be written: {reason(error)}; {hint}") from error
