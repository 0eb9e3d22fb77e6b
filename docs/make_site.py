"""Build the site: collect its pages in a folder, then build them with Sphinx.

    python docs/make_site.py [--check] [FOLDER]

The site is written to FOLDER, ``build/docs`` by default, as plain files. Pages that are made from the code, such as
those of the blocks, are never among the hand-written pages. ``--check`` collects the pages without building them.
"""

from __future__ import annotations

import argparse
import importlib
import os
import re
import shutil
import sys
from pathlib import Path

from site_parts import api, references
from site_parts.pages import CATALOGUE, DOCS, PAGES, ROOT, linked, shown_place, shown_text, sources

MARK = ".made-by-make_site"


def gathered(folder: Path) -> dict[str, str | bytes]:
    """All source files of the site, by their place in it; blocks' pages are written to `folder` before."""
    shown, files = set[Path](), dict[str, str | bytes]()
    for place, path in sources().items():
        files[place] = linked(path.read_text(encoding="utf-8"), path, place, shown.add)
    for place, text in made(folder).items():
        files[place] = linked(text, DOCS / place, place, shown.add)
    files |= api.pages() | {"reference/references.rst": references.text()}
    files |= {shown_place(path): shown_text(path) for path in shown}
    return files | {place: path.read_bytes() for place, path in pictures().items()}


def pictures() -> dict[str, Path]:
    """Pictures and tables that the pages show, by their place in the site."""
    found = {str(path.relative_to(DOCS)): path for path in DOCS.rglob("*") if path.suffix in PAGES[1:]}
    return {place: path for place, path in found.items() if not place.startswith("_")}


def made(folder: Path) -> dict[str, str]:
    """The pages of the blocks, where the generator is; their pictures stay in `folder`."""
    if not DOCS.joinpath("make_blocks.py").exists():
        return {}
    mine = folder / CATALOGUE
    shutil.rmtree(mine, ignore_errors=True)
    mine.mkdir(parents=True)
    importlib.import_module("make_blocks").write(mine)
    return {str(path.relative_to(folder)): path.read_text(encoding="utf-8") for path in sorted(mine.rglob("*.md"))}


def _emptied(cache: Path) -> None:
    shutil.rmtree(cache, ignore_errors=True)
    claim(cache)


def claim(folder: Path) -> None:
    """Mark a folder as written by this script, which removes all other files from it.

    Ends the program if there are files that it did not make.
    """
    mark, built = folder / MARK, folder.is_relative_to(ROOT / "build")
    if not (built or mark.exists()) and (folder.is_file() or (folder.is_dir() and any(folder.iterdir()))):
        sys.exit(f"{folder}: expected no files but those of an earlier build, found others; name another FOLDER")
    folder.mkdir(parents=True, exist_ok=True)
    mark.touch()


def lay_out(files: dict[str, str | bytes], folder: Path) -> None:
    """Write changed files and remove obsolete ones: Sphinx reads only new files again."""
    for place, content in files.items():
        path, data = folder / place, content.encode() if isinstance(content, str) else content
        if not path.is_file() or path.read_bytes() != data:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)
    pictures = folder / CATALOGUE
    for path in list(folder.rglob("*")):
        place = str(path.relative_to(folder))
        ours = path.is_relative_to(pictures) and path.suffix != ".md"
        if path.is_file() and place not in files and not ours and place != MARK:
            path.unlink()


REMOTE = re.compile(
    r"""<(?:script|img|iframe|source|video|audio|embed|object)\b[^>]*\s(?:src|data)\s*=\s*["']?(?:https?:)?//[^"'>\s]*"""
    r"""|<link\b[^>]*\shref\s*=\s*["']?(?:https?:)?//[^"'>\s]*"""
    r"""|url\(\s*["']?(?:https?:)?//[^"')]*|@import\s+["'](?:https?:)?//[^"']*""",
    re.IGNORECASE,
)
"""Resources that a browser loads from another host."""


def remote(site: Path) -> list[str]:
    """Network resources of the pages and styles of a site, each with its file; the list has to be empty."""
    found = list[str]()
    for path in sorted(site.rglob("*")):
        if path.suffix in (".html", ".css", ".svg"):
            loads = REMOTE.findall(path.read_text(encoding="utf-8"))
            found += [f"{path.relative_to(site)} loads {text}" for text in loads]
    return found


def _quiet_kernels(folder: Path) -> None:
    """Run lessons without the reader's own notebook settings, with kernels that log errors only."""
    profile = folder / "profile_default"
    profile.mkdir(parents=True, exist_ok=True)
    profile.joinpath("ipython_kernel_config.py").write_text("get_config().IPKernelApp.log_level = 40\n")
    os.environ["IPYTHONDIR"] = str(folder)


def options() -> list[str]:
    """Stream for Sphinx's output: in a terminal it counts the pages that it reads and writes, in one line."""
    quiet = [] if sys.stdout.isatty() else ["-q"]
    return ["-W", "--keep-going", *quiet, "-j", "2"]


def main() -> int:
    """Run Sphinx; returns its status."""
    parser = argparse.ArgumentParser(description="Build the site.")
    parser.add_argument("folder", nargs="?", type=Path, default=ROOT / "build" / "docs", metavar="FOLDER")
    parser.add_argument("--check", action="store_true", help="gather the pages only")
    arguments = parser.parse_args()
    site: Path = arguments.folder.resolve()
    sources_folder, cache = site.with_name(f"{site.name}-source"), site.with_name(f"{site.name}-cache")
    for folder in (sources_folder, cache):
        claim(folder)
    lay_out(gathered(sources_folder), sources_folder)
    if arguments.check:
        return 0
    if not site.is_dir():
        _emptied(cache)  # it lists pages that are not built again
    _quiet_kernels(cache / "ipython")
    from sphinx.cmd.build import build_main

    words = [*options(), "-c", str(DOCS), "-d", str(cache)]
    status = build_main([*words, str(sources_folder), str(site)])
    for text in remote(site):
        sys.stderr.write(f"{text}\n")
        status = 1
    if status:
        _emptied(cache)  # otherwise the next build would skip the page with the warning
    else:
        sys.stdout.write(f"the site: {site / 'index.html'}\n")
    return status


if __name__ == "__main__":
    sys.exit(main())
