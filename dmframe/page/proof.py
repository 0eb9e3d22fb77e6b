"""The certificate of a page's claim, and the program that checks it in the reader's browser."""

from __future__ import annotations

import base64
import re
import zlib
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import final

from dmframe.certify import Verdict
from dmframe.certify.published import certificate_text
from dmframe.config import BaseGraph


@final
@dataclass(frozen=True)
class Proof:
    """Certificate and checker, each deflated, in base64; empty without a proof.

    Parameters
    ----------
    certificate
        The certificate file.
    checker
        `check.js` without comments and indentation.
    script
        The text of `checker`, which the page's content security policy allows by its hash.
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
    """`check.js` without comments and indentation."""
    return bare(files("dmframe.checker").joinpath("check.js").read_text("utf-8"))


def bare(text: str) -> str:
    """Remove indentation, comment lines and comments at the ends of lines."""
    return re.sub(r"^[ \t]*(//.*)?\n?| // .*$", "", text, flags=re.MULTILINE)


def packed(text: str) -> str:
    """Compress for DecompressionStream("deflate") of a browser."""
    return base64.b64encode(zlib.compress(text.encode(), 9)).decode()
