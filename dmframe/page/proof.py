"""The certificate of a page's claim, and the program that checks it in the reader's browser."""

from __future__ import annotations

import base64
import re
import zlib
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Final, final

from dmframe.certify import Verdict
from dmframe.certify.published import certificate_text
from dmframe.config import BaseGraph

NODE: Final = "\nif (typeof module"
"""Start of the lines of `check.js` that run in Node alone."""


@final
@dataclass(frozen=True)
class Proof:
    """Certificate and checker, each deflated, in base64; empty without a proof.

    Parameters
    ----------
    certificate
        The certificate file.
    checker
        The text of `script`.
    script
        `check.js`, which the page's content security policy allows by its hash.
    """

    certificate: str = ""
    checker: str = ""
    script: str = ""


def proof_of(graph: BaseGraph, verdict: Verdict) -> Proof:
    """Proof of a graph that is proved; otherwise an empty one."""
    if verdict.claim is None or verdict.exact is None or verdict.outcome != "proved":
        return Proof()
    certificate = certificate_text(verdict, {"graph": graph.name}, graph.intervals())
    return Proof(packed(certificate), packed(checker_script()), checker_script())


@cache
def checker_script() -> str:
    """`check.js` for a page: without comments, indentation, spaces at operators, and what Node alone runs."""
    script, _, _ = files("dmframe.checker").joinpath("check.js").read_text("utf-8").partition(NODE)
    lines = re.sub(r"^[ \t]*(//.*)?\n?| // .*$", "", script, flags=re.MULTILINE).splitlines(keepends=True)
    return "".join(line if "/" in line or line.count("`") > 2 else _close(line) for line in lines)


def _close(line: str) -> str:
    """Remove spaces at operators outside of texts."""
    return re.sub(r"(\"[^\"]*\"|`[^`]*`)| ?([-=<>+*?:,;{}&|!]+) ?", lambda found: found[1] or found[2], line)


def packed(text: str) -> str:
    """Compress for DecompressionStream("deflate") of a browser."""
    return base64.b64encode(zlib.compress(text.encode(), 9)).decode()
