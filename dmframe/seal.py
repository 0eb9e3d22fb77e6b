"""Digests of what was written: of a JSON file's own content, and of every file of a folder.

A folder of results holds ``seal.json``: the SHA-256 of each of its files, and whether all that was to be written is
there. It is written with the data, and again, as the last file, when figures and pages have followed. Digests guard
against damage and slips, not against intent.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, final

from dmframe.files import encoded

SEAL: Final = "seal.json"
_KEY: Final = "seal"
_BLOCK: Final = 2**20


class BrokenSeal(ValueError):
    """A text that `sealed` did not write."""


@final
@dataclass(frozen=True)
class FolderSeal:
    """What ``seal.json`` says.

    Parameters
    ----------
    files
        SHA-256 of each file, by its path in the folder.
    complete
        Whether the process that wrote the folder came to its end.
    """

    files: Mapping[str, str]
    complete: bool

    @property
    def text(self) -> str:
        """The content of ``seal.json``."""
        return sealed({"version": 1, "complete": self.complete, "files": dict(sorted(self.files.items()))})


def digest(content: bytes) -> str:
    """SHA-256 in hexadecimal digits."""
    return hashlib.sha256(content).hexdigest()


def digest_of(file: Path) -> str:
    """SHA-256 of a file, which is not held in memory."""
    found = hashlib.sha256()
    with file.open("rb") as opened_file:
        while block := opened_file.read(_BLOCK):
            found.update(block)
    return found.hexdigest()


def sealed(data: dict[str, Any]) -> str:
    """The data as JSON with a digest of them."""
    return _text({**data, _KEY: digest(encoded(_text(data)))})


def opened(content: bytes) -> dict[str, Any]:
    """The data of `sealed`. Raises `BrokenSeal` where one bit of the text is another."""
    try:
        data = json.loads(content.decode("utf-8"))
    except ValueError:
        raise BrokenSeal("it is no JSON") from None
    if not isinstance(data, dict) or _KEY not in data:
        raise BrokenSeal("it has no digest")
    data.pop(_KEY)
    if encoded(sealed(data)) != content:  # spaces and the order of keys count too
        raise BrokenSeal("its digest is that of another content")
    return data


def seal_of(folder: Path) -> FolderSeal | None:
    """The seal of a folder; None where it has none. Raises `BrokenSeal`."""
    try:
        data = opened((folder / SEAL).read_bytes())
        return FolderSeal(dict(data["files"]), bool(data["complete"]))
    except FileNotFoundError:
        return None
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise BrokenSeal(f"{SEAL} is damaged or was edited: {error}") from None


def folder_of(path: Path) -> Path | None:
    """The sealed folder to which a folder or a file belongs; None for none.

    Several runs share one seal, in the folder above their own.
    """
    start = path if path.is_dir() else path.parent
    return next((folder for folder in (start, start.resolve().parent) if (folder / SEAL).exists()), None)


def faults(folder: Path, wanted: Callable[[str], bool] = lambda name: True) -> list[str]:
    """What is not as it was written, one text a file; of those that are `wanted`, by their path in the folder."""
    try:
        seal = seal_of(folder)
    except BrokenSeal as error:
        return [str(error)]
    found = list[str]()
    for name, known in seal.files.items() if seal is not None else ():
        if not wanted(name):
            continue
        try:
            if digest_of(folder / name) != known:
                found.append(f"{name} is not what was written: its digest is another")
        except OSError:
            found.append(f"{name} was written, and cannot be read any more")
    return found


def _text(data: dict[str, Any]) -> str:
    return json.dumps(data, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
