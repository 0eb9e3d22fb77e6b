"""HTML frame of the pages of a study and of a tuning: header, answer, table of contents and sections."""

from __future__ import annotations

from collections.abc import Sequence

from dmframe.report import html
from dmframe.report.page import document
from dmframe.report.parts import Lead, Section
from dmframe.report.tags import Html, joined, plain, tag


def study_page(kind: str, name: str, title: str, note: str, answer: Lead, sections: Sequence[Section]) -> str:
    """The page as one self-contained file; `kind` is printed above the name, the title and a note below it."""
    head = [tag("p", plain(kind), class_="doc-kind"), tag("h1", plain(name))]
    head += [tag("p", plain(title), class_="doc-title")] if title else []
    head += [tag("p", plain(note), class_="note")] if note else []
    writer = html.Writer("s")
    inside = [html.lead(answer), writer.contents(name, sections), *map(writer.section, sections)]
    body = [tag("header", *head), tag("article", joined(map(Html, inside)), id="s")]
    return document(f"{name}: {answer.headline}", body)
