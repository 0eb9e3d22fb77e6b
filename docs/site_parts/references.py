"""The page of references, from the bibliography of the blocks: targets of ``[Key]_`` in docstrings."""

from __future__ import annotations

import re
from typing import Final

from dmframe.report.references import reference
from site_parts.pages import ROOT

BIBLIOGRAPHY: Final = ROOT / "blocks" / "dmframe_blocks" / "references.bib"
HEAD: Final = """References
==========

The sources that the code and these pages cite, as ``blocks/dmframe_blocks/references.bib`` has them.

"""


def text() -> str:
    """The page, in reStructuredText."""
    keys = re.findall(r"^@\w+\{([^,\s]+),", BIBLIOGRAPHY.read_text(encoding="utf-8"), re.MULTILINE)
    return HEAD + "\n".join(f".. [{key}] {reference(key)}\n" for key in sorted(keys, key=str.lower))
