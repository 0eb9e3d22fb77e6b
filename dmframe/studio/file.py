"""The file of the studio: read, and written only when the user saves, with all bytes of unchanged lines kept."""

from __future__ import annotations

import difflib
import hashlib
import os
import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, final

from dmframe.common.errors import DmframeError, OutputError
from dmframe.common.files import reason, write_bytes

MOST_BYTES: Final = 1_000_000
"""Size limit of a graph file, as in `dmframe.config.document`."""
MARK: Final = "\ufeff"
"""Byte order mark, which some editors write at the beginning."""
LINE: Final = re.compile("\r\n|\r|\n")
MOST_COMPARED: Final = 2000
"""Changed lines from which on their line ends are all the most frequent one: a comparison takes quadratic time."""


@final
class ChangedError(DmframeError):
    """The file is no longer the version that an edit began with; `now` is its present state."""

    def __init__(self, text: str, now: Content) -> None:
        super().__init__(text)
        self.now = now


@final
@dataclass(frozen=True)
class Content:
    """A version of the file.

    Parameters
    ----------
    text
        The text; line ends are those of the file. Empty if it cannot be edited.
    version
        Digest of its bytes; empty if there is no such file.
    problem
        Reason why it cannot be edited; empty if it can.
    """

    text: str
    version: str
    problem: str = ""

    @property
    def data(self) -> dict[str, Any]:
        """Plain data for JSON."""
        return {"text": self.text.removeprefix(MARK), "version": self.version, "problem": self.problem}


@final
class File:
    """A file that one user edits in one or several tabs, and with other programs."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def read(self) -> Content:
        """Its present version; a problem is described and not raised."""
        try:
            with self.path.open("rb") as file:
                raw = file.read(MOST_BYTES + 1)
        except FileNotFoundError:
            return Content("", "", "the file does not exist; save to write it again")
        except OSError as error:
            return Content("", "", f"the file cannot be read: {reason(error)}")
        version = hashlib.sha256(raw).hexdigest()
        if len(raw) > MOST_BYTES:
            return Content("", version, f"the file has more than {MOST_BYTES} bytes; a graph is shorter")
        try:
            text = raw.decode("utf-8")
        except UnicodeDecodeError as error:
            line = raw[: error.start].count(b"\n") + 1
            return Content("", version, f"line {line} is no text in UTF-8; save the file as UTF-8")
        if "\0" in text:
            return Content("", version, "the file is binary")
        return Content(text, version)

    @property
    def writable(self) -> bool:
        """False for a file that this user may not write."""
        return os.access(self.path, os.W_OK) if self.path.exists() else os.access(self.path.parent, os.W_OK)

    def save(self, text: str, version: str) -> Content:
        """Write a text whose edit began with a version; returns the new version.

        The bytes of lines that did not change are those of that version, with its mark and its line ends.

        Raises
        ------
        ChangedError
            The file has another version now, or is gone; an empty `version` writes a file that is gone.
        OutputError
            It cannot be written; the old one is unchanged.
        """
        now = self.read()
        if now.version != version:
            what = "was removed" if not now.version else "was changed by another program or in another tab"
            raise ChangedError(f"{self.path.name} {what} since this text was opened; nothing was written", now)
        try:
            raw = with_line_ends(now.text, text).encode("utf-8")
        except UnicodeEncodeError as error:
            raise OutputError(
                f"the text has the character {text[error.start]!a}, which UTF-8 cannot represent"
            ) from None
        if len(raw) > MOST_BYTES:
            raise OutputError(f"the text has {len(raw)} bytes, more than {MOST_BYTES}; shorten it")
        if not now.version or raw != now.text.encode("utf-8"):
            write_bytes(self.path, raw)
        return Content(raw.decode("utf-8"), hashlib.sha256(raw).hexdigest())


def with_line_ends(old: str, new: str) -> str:
    """The new text with the line ends and the byte order mark of the old one.

    An editor has one kind of line end. Lines that both texts have, and lines changed in place, keep theirs;
    new ones get the most frequent one.
    """
    new = new.removeprefix(MARK)
    ends = LINE.findall(old)
    usual = Counter(ends).most_common(1)[0][0] if ends else "\n"
    before, after = LINE.split(old.removeprefix(MARK)), LINE.split(new)
    found = [usual] * (len(after) - 1)
    for i, j, size in _matched(before, after):
        for k in range(size):
            if i + k < len(ends) and j + k < len(found):
                found[j + k] = ends[i + k]
    for k in reversed(range(len(found) - 1)):
        if found[k] == "\r" and not after[k + 1] and found[k + 1] == "\n":  # together they would be one line end
            found[k] = "\n"
    mark = MARK if old.startswith(MARK) else ""
    return mark + "".join(line + end for line, end in zip(after, [*found, ""], strict=True))


def _matched(before: list[str], after: list[str]) -> list[tuple[int, int, int]]:
    """Runs of lines that correspond, equal or changed in place: first line in each text, and number of lines."""
    least, first, last = min(len(before), len(after)), 0, 0
    while first < least and before[first] == after[first]:
        first += 1
    while last < least - first and before[-1 - last] == after[-1 - last]:
        last += 1
    runs = [(0, 0, first), (len(before) - last, len(after) - last, last)]
    inner = before[first : len(before) - last], after[first : len(after) - last]
    if max(map(len, inner)) <= MOST_COMPARED:
        for kind, i, i_end, j, j_end in difflib.SequenceMatcher(None, *inner, autojunk=False).get_opcodes():
            if kind in ("equal", "replace"):
                runs.append((first + i, first + j, min(i_end - i, j_end - j)))
    return runs
