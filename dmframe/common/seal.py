"""Digests of written files: within a JSON file, and of every file of a folder.

A folder of results has ``seal.json``: the SHA-256 of each of its files, and whether the folder is complete. It is
written with the data, and again, as the last file, after figures and pages. Digests detect damage and accidental
changes, not manipulation.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, final

from dmframe.common.files import encoded, probed

SEAL: Final = "seal.json"
_KEY: Final = "seal"
_BLOCK: Final = 2**20


class BrokenSeal(ValueError):
    """A text that was not written by `sealed`, or was changed."""


@final
@dataclass(frozen=True)
class FolderSeal:
    """Content of ``seal.json``.

    Parameters
    ----------
    files
        SHA-256 of each file, by its path in the folder.
    complete
        True if the process that wrote the folder has finished.
    """

    files: Mapping[str, str]
    complete: bool

    @property
    def text(self) -> str:
        """Text of ``seal.json``."""
        return sealed({"version": 1, "complete": self.complete, "files": dict(sorted(self.files.items()))})


def digest(content: bytes) -> str:
    """SHA-256 in hexadecimal digits."""
    return hashlib.sha256(content).hexdigest()


def digest_of(file: Path) -> str:
    """SHA-256 of a file, which is read in blocks."""
    found = hashlib.sha256()
    with file.open("rb") as opened_file:
        while block := opened_file.read(_BLOCK):
            found.update(block)
    return found.hexdigest()


def sealed(data: dict[str, Any]) -> str:
    """JSON of the data with their digest."""
    return _text({**data, _KEY: digest(encoded(_text(data)))})


def opened(content: bytes) -> dict[str, Any]:
    """Data of a text of `sealed`. Raises `BrokenSeal` if any bit was changed."""
    try:
        data = json.loads(content.decode("utf-8"))
    except ValueError:
        raise BrokenSeal("it is not JSON") from None
    if not isinstance(data, dict) or _KEY not in data:
        raise BrokenSeal("it has no digest")
    data.pop(_KEY)
    if encoded(sealed(data)) != content:  # spaces and the order of keys count too
        raise BrokenSeal("its digest does not match")
    return data


def seal_of(folder: Path) -> FolderSeal | None:
    """Seal of a folder; None if it has none. Raises `BrokenSeal`."""
    try:
        data = opened((folder / SEAL).read_bytes())
        return FolderSeal(dict(data["files"]), bool(data["complete"]))
    except FileNotFoundError:
        return None
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise BrokenSeal(f"{SEAL} is damaged or was edited: {error}") from None


def folder_of(path: Path) -> Path | None:
    """Sealed folder of a folder or a file; None for none. Several runs share a seal in their parent folder."""
    start = path if path.is_dir() else path.parent
    places = (start, start.resolve().parent)
    for folder in places:
        probed(folder / SEAL)
    return next((folder for folder in places if (folder / SEAL).exists()), None)


def faults(folder: Path, wanted: Callable[[str], bool] = lambda name: True) -> list[str]:
    """Descriptions of the changed or missing files, among those that are `wanted` by their path in the folder."""
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
                found.append(f"{name} was changed: its digest does not match")
        except OSError:
            found.append(f"{name} is missing or cannot be read")
    return found


def _text(data: dict[str, Any]) -> str:
    return json.dumps(data, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
