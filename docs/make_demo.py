"""Build the live pages that the package contains: those of the graphs with rivals, for ``dmframe demo``.

python docs/make_demo.py
"""

from __future__ import annotations

import sys
from pathlib import Path

import dmframe as dm
from dmframe.catalogue import graphs

FOLDER = "pages"


def packaged() -> dict[str, Path]:
    """Files of the packaged pages, by graph."""
    known = {name: path for name, path in graphs().items() if "\npage:" in path.read_text("utf-8")}
    return {name: path.parents[1] / FOLDER / f"{name}.html" for name, path in known.items()}


def main() -> None:
    """Write each page."""
    for name, place in packaged().items():
        place.parent.mkdir(exist_ok=True)
        dm.load(name).page().save(place)
        sys.stdout.write(f"wrote {place.name}: {place.stat().st_size} bytes\n")


if __name__ == "__main__":
    main()
