"""Each citation has an entry in the bibliography, and each entry is cited."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
KEY = re.compile(r"\[([A-Z][A-Za-z]+(?:19|20)\d\d[a-z]?)\]")
ENTRY = re.compile(r"^@(\w+)\{(\w+),\n(.*?)^\}", re.MULTILINE | re.DOTALL)
NEEDED = {
    "article": {"journal", "volume", "pages"},
    "book": {"publisher"},
    "inproceedings": {"booktitle"},
    "misc": {"howpublished"},
}
SOURCES = ("dmframe", "blocks/dmframe_blocks", "plants/dmframe_plants")


def entries() -> dict[str, tuple[str, set[str]]]:
    text = ROOT.joinpath("blocks", "dmframe_blocks", "references.bib").read_text(encoding="utf-8")
    return {m[2]: (m[1], set(re.findall(r"^  (\w+)", m[3], re.MULTILINE))) for m in ENTRY.finditer(text)}


def cited() -> dict[str, str]:
    files = [file for folder in SOURCES for file in ROOT.joinpath(folder).rglob("*.py")]
    files += ROOT.joinpath("docs").rglob("*.md")
    return {key: str(file.relative_to(ROOT)) for file in files for key in KEY.findall(file.read_text(encoding="utf-8"))}


def test_every_citation_has_an_entry() -> None:
    assert "WangTAC2020" in cited()
    assert {key: file for key, file in cited().items() if key not in entries()} == {}


def test_every_entry_is_cited() -> None:
    assert sorted(entries().keys() - cited().keys()) == []


def test_every_entry_states_who_what_where_and_when() -> None:
    wrong = [
        key for key, (kind, fields) in entries().items() if not {"author", "title", "year"} | NEEDED[kind] <= fields
    ]
    assert wrong == []
