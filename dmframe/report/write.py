"""Writing a report: its kind by the name's ending, all of it or nothing."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

from dmframe.errors import OutputError
from dmframe.files import check_place as check_file
from dmframe.files import write_text
from dmframe.report.content import Content, gather
from dmframe.report.data import as_data
from dmframe.report.page import as_html, as_markdown
from dmframe.report.verification import Verification, command


def _as_json(contents: Sequence[Content]) -> str:
    return json.dumps(as_data(contents), indent=2, allow_nan=False, ensure_ascii=False) + "\n"


WRITERS: Final[dict[str, Callable[[Sequence[Content]], str]]] = {
    ".html": as_html,
    ".md": as_markdown,
    ".json": _as_json,
}


def write_report(
    path: str | Path,
    found: Sequence[Verification],
    *,
    replay: Sequence[str] = (),
    tell: Callable[[str], None] = lambda _: None,
) -> None:
    """Write one report on one or several graphs: a web page, Markdown or JSON, by the ending of `path`.

    Each graph is simulated as its file says, to show V along the run. The file is there in full or not at all.

    Parameters
    ----------
    path
        ``.html`` (one file that opens offline and prints), ``.md`` or ``.json``.
    replay
        The command that writes it again, where it is known.
    tell
        Called with what is done, which may take half a minute a graph.

    Raises
    ------
    OutputError
        Another ending, or a file that cannot be written.
    """
    path = Path(path)
    check_place(path)
    said = list(replay) or command(found, path)
    contents = [
        gather(
            each.experiment,
            each.diagram,
            each.verdict,
            command=said,
            seed=each.seed,
            tell=lambda text, name=each.name: tell(f"{name}: {text}"),  # type: ignore[misc]
        )
        for each in found
    ]
    write_text(path, WRITERS[path.suffix.lower()](contents))


def check_place(path: Path) -> None:
    """Refuse a place where no report can be written; to be asked before anything is computed.

    Raises
    ------
    OutputError
        Another ending than those of `WRITERS`, a folder of that name, or no folder to write in.
    """
    if path.suffix.lower() not in WRITERS:
        endings = ", ".join(WRITERS)
        raise OutputError(f"{path}: expected a name that ends in {endings}, found {path.suffix or 'no ending'}")
    check_file(path)
