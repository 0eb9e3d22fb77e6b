"""Pages of the site: their files, their places in the site, and the targets of links between them."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).parents[2]
DOCS: Final = ROOT / "docs"
AT_ROOT: Final = (
    *("CLAIMS.md", "KNOWN_GAPS.md", "CHANGELOG.md", "CONTRIBUTING.md"),
    *("SECURITY.md", "CODE_OF_CONDUCT.md", "GOVERNANCE.md"),
)
"""Pages in the root of the repository; in the site they are next to the first page."""
PAGES: Final = (".md", ".png", ".svg", ".csv", ".gif")
"""Suffixes of pages under `docs`, and of their parts."""
CATALOGUE: Final = "reference/blocks"
"""Where the site has a page for each block."""
SHOWN: Final = {".py": "python", ".yaml": "yaml", ".bib": "bibtex", ".toml": "toml", ".md": "markdown"}
"""Linked files that are not pages: the site shows their source, by language."""

FENCE: Final = re.compile(r"^\s*(`{3,}|:{3,})\s*(.*?)\s*$")
CODE: Final = ("{code-cell}", "{code-block}", "{toctree}", "{live}", "{math}", "{eval-rst}")
"""Directives with fences that do not contain prose."""
LINK: Final = re.compile(r"(?P<image>!?)\[(?P<text>(?:[^\[\]]|\[[^\[\]]*\])*)\]\((?P<target>[^()\s]+)\)")
TREE: Final = re.compile(r"^```\{toctree\}\n(.*?)^```$", re.MULTILINE | re.DOTALL)


class LinkError(Exception):
    """A link without a target."""


def sources() -> dict[str, Path]:
    """The hand-written pages, by their place in the site, ``how_to/laws.md``."""
    found = {str(path.relative_to(DOCS)): path for path in sorted(DOCS.rglob("*.md"))}
    return found | {name: ROOT / name for name in AT_ROOT}


def place_of(path: Path) -> str | None:
    """Place of a repository file in the site; None if it is not a page."""
    if path == ROOT / "README.md":
        return "index.md"
    if path.parent == ROOT and path.name in AT_ROOT:
        return path.name
    return str(path.relative_to(DOCS)) if path.is_relative_to(DOCS) and path.suffix in PAGES else None


def shown_place(path: Path) -> str:
    """Place in the site of a file that is not a page."""
    return f"files/{path.relative_to(ROOT)}.md"


def shown_text(path: Path) -> str:
    """A page that shows a file of the repository, out of the navigation and of the search."""
    name, text = str(path.relative_to(ROOT)), path.read_text(encoding="utf-8")
    return (
        f"---\norphan: true\nnosearch: true\n---\n\n# {name}\n\n``````{SHOWN[path.suffix]}\n{text.rstrip()}\n``````\n"
    )


def linked(text: str, page: Path, place: str, show: Callable[[Path], object]) -> str:
    """A page's text with its links as the site needs them.

    Parameters
    ----------
    page
        The file, from whose folder its links are read.
    place
        Its place in the site.
    show
        Is called with each file that is no page and has to be shown.

    Raises
    ------
    LinkError
        A link leads nowhere.
    """

    def moved(found: re.Match[str]) -> str:
        target, hash_, anchor = found["target"].partition("#")
        if not target or "://" in target or target.startswith("mailto:"):
            return found[0]
        # normpath, not resolve: the checkout may be behind a symbolic link
        path = Path(os.path.normpath(page.parent / target))
        if not path.exists() and not (path.is_relative_to(DOCS / CATALOGUE) and path.suffix == ".md"):
            raise LinkError(f"{page.relative_to(ROOT)}: {found['target']} leads nowhere")
        if path.is_dir():
            return found["text"]
        new = place_of(path) or _block_page(path)
        if new is None:
            if path.suffix not in SHOWN:
                return found["text"]
            new = shown_place(path)
            show(path)
        label = linked(found["text"], page, place, show)
        return f"{found['image']}[{label}]({os.path.relpath(new, Path(place).parent)}{hash_}{anchor})"

    return "".join(LINK.sub(moved, part) if is_prose else part for is_prose, part in parted(text))


def parted(text: str) -> list[tuple[bool, str]]:
    """A page's text cut into prose and code, each with whether it is prose; fences may be nested."""
    parts, held, opened, code = list[tuple[bool, str]](), list[str](), list[str](), ""

    def cut(is_prose: bool) -> None:
        parts.append((is_prose, "".join(held)))
        held.clear()

    for line in text.splitlines(keepends=True):
        fence = FENCE.match(line)
        if code:
            held.append(line)
            if fence and fence[1].startswith(code) and not fence[2]:
                cut(False)
                code = ""
        elif fence and not fence[2] and opened and fence[1].startswith(opened[-1]):
            opened.pop()
            held.append(line)
        elif fence and fence[2].startswith("{") and fence[2].split()[0] not in CODE:
            opened.append(fence[1])
            held.append(line)
        elif fence and fence[1].startswith("`"):
            cut(True)
            code = fence[1]
            held.append(line)
        else:
            held.append(line)
    cut(not code)
    return parts


def _block_page(path: Path) -> str | None:
    """The page of the block in a file; None without a block."""
    from dmframe.catalogue import block_types

    mine = path.suffix == ".py" and path.parent.name == "dmframe_blocks" and path.stem in block_types()
    return f"{CATALOGUE}/{path.stem}.md" if mine and (DOCS / "make_blocks.py").exists() else None


def children(text: str) -> list[str]:
    """The entries of the tables of contents of a page."""
    lines = [line.strip() for tree in TREE.findall(text) for line in tree.splitlines()]
    return [line for line in lines if line and not line.startswith(":")]
