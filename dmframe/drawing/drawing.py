"""Picture of a diagram, which can be shown and saved."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Final, cast, final

from dmframe.common.errors import OutputError
from dmframe.common.files import check_place, expanded, write_bytes, write_text
from dmframe.drawing.flowchart import mermaid
from dmframe.drawing.netlist import Wired
from dmframe.drawing.picture import svg


@final
@dataclass(frozen=True, repr=False, eq=False)
class Drawing:
    """The block diagram of a graph; a notebook shows it.

    Parameters
    ----------
    diagram
        The diagram.
    title
        Title above the picture.
    """

    diagram: Wired
    title: str = ""

    @cached_property
    def svg(self) -> str:
        """A stand-alone SVG."""
        return svg(self.diagram, self.title)

    @cached_property
    def mermaid(self) -> str:
        """A flowchart in Mermaid's language."""
        return mermaid(self.diagram, self.title)

    def save(self, path: str | Path) -> Path:
        """Write it as SVG, PNG, PDF or Mermaid, by the file name extension.

        Raises
        ------
        OutputError
            The extension is unknown, or the file cannot be written.
        """
        path = expanded(path)
        check_ending(path)
        check_place(path)
        WRITERS[path.suffix.lower()](self, path)
        return path

    def __reduce__(self) -> Any:
        """Pickle the texts and the names of the blocks, without expressions."""
        return _drawn, (self.title, self.svg, self.mermaid, tuple(self.diagram.blocks))

    def __repr__(self) -> str:
        return f"<Drawing of {self.title or 'a diagram'}: {len(self.diagram.blocks)} blocks>"

    def __str__(self) -> str:
        return self.mermaid

    def _repr_svg_(self) -> str:
        return self.svg


def _drawn(title: str, svg_text: str, mermaid_text: str, blocks: tuple[str, ...]) -> Drawing:
    """A drawing from its texts."""
    made = Drawing(cast(Wired, SimpleNamespace(blocks=dict.fromkeys(blocks))), title)
    vars(made).update(svg=svg_text, mermaid=mermaid_text)
    return made


def _printer(kind: str) -> Callable[[Drawing, Path], None]:
    def write(drawing: Drawing, path: Path) -> None:
        from dmframe.drawing.print import printed

        write_bytes(path, printed(drawing.svg, kind))

    return write


WRITERS: Final[dict[str, Callable[[Drawing, Path], None]]] = {
    ".svg": lambda drawing, path: write_text(path, drawing.svg),
    ".png": _printer("png"),
    ".pdf": _printer("pdf"),
    ".mmd": lambda drawing, path: write_text(path, drawing.mermaid),
}


def check_ending(path: Path) -> None:
    """Raise `OutputError` for an unknown file name extension."""
    if path.suffix.lower() not in WRITERS:
        found = path.suffix or "no extension"
        raise OutputError(f"{path}: expected the extension {', '.join(WRITERS)}, found {found}")
