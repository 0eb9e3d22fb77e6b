"""Write a report; the file name's ending selects the format."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Final, TypeAlias

from dmframe.common.errors import OutputError, ValueFault
from dmframe.common.files import check_place as check_file
from dmframe.common.files import write_text
from dmframe.report.content import Content, gather
from dmframe.report.measured import Measured
from dmframe.report.page import as_html, as_markdown
from dmframe.report.parts import Section
from dmframe.report.sections import sections as standard
from dmframe.report.verification import Verification, command

_OMITTED: Final = ("picture", "mermaid", "summary", "measured", "linear", "own", "name", "title", "outcome")
SectionOf: TypeAlias = Callable[[Content], Section]


def as_data(contents: Sequence[Content]) -> dict[str, Any]:
    """Reports as plain data without pictures; formulas are LaTeX, between dollar signs within sentences."""
    return {"dmframe_report": 1, "graphs": [_graph(content) for content in contents]}


def _graph(content: Content) -> dict[str, Any]:
    measured = {key: getattr(content.measured, key) for key in ("sentence", "facts", "numbers")}
    whole = asdict(replace(content, measured=Measured(""), own=()))  # without the recording, which is not copied
    linear = {key: whole["linear"][key] for key in ("sentence", "numbers")}
    rest = {key: value for key, value in whole.items() if key not in _OMITTED}
    return {"title": content.title, "verdict": content.summary, "measured": measured, "linear": linear, **rest}


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
    sections: Sequence[SectionOf] = (),
    tell: Callable[[str], None] = lambda _: None,
) -> None:
    """Write a report on one or several graphs: web page, Markdown or JSON by the ending of `path`.

    Each graph is simulated to show V along the run. The file is written atomically.

    Parameters
    ----------
    path
        ``.html`` (one self-contained file), ``.md`` or ``.json``.
    replay
        Command that writes the report again; default: derived from the graphs.
    sections
        Functions that make further sections from the content of a graph's report, for ``.html`` and ``.md``.
    tell
        Receives progress messages; a graph may take half a minute.

    Raises
    ------
    DmframeError
        If the ending is unknown, the file cannot be written, or a function returns no section or one of a used name.
    """
    path = Path(path)
    check_place(path)
    used = list(replay) or command(found, path)
    contents = [
        gather(
            each.graph,
            each.verdict,
            command=used,
            seed=each.seed,
            tell=lambda text, name=each.name: tell(f"{name}: {text}"),  # type: ignore[misc]
        )
        for each in found
    ]
    write_text(path, WRITERS[path.suffix.lower()]([_with_own(content, sections) for content in contents]))


def _with_own(content: Content, functions: Sequence[SectionOf]) -> Content:
    """The content with the sections of these functions."""
    used = {section.name for section in standard(content)} if functions else set()
    own = list[Section]()
    for function in functions:
        section = function(content)
        if not isinstance(section, Section):
            name = getattr(function, "__name__", repr(function))
            raise ValueFault(f"report: expected {name} to return a Section, found {section!r:.60}")
        if section.name in used:
            raise ValueFault(f"report: the section name {section.name!r} is used already; choose another")
        used.add(section.name)
        own.append(section)
    return replace(content, own=tuple(own))


def check_place(path: Path) -> None:
    """Check before any computation that a report can be written to `path`.

    Raises
    ------
    OutputError
        If the ending is not in `WRITERS`, `path` is a folder, or its folder does not exist.
    """
    if path.suffix.lower() not in WRITERS:
        endings = ", ".join(WRITERS)
        raise OutputError(f"{path}: expected a name that ends in {endings}, found {path.suffix or 'no ending'}")
    check_file(path)
