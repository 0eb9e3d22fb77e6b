"""A page's scripts in Node, if it is installed."""

from __future__ import annotations

import json
import shutil
import subprocess
from functools import cache
from pathlib import Path
from typing import Any, Final

import pytest

import dmframe as dm
import dmframe.page
from dmframe.block.model import SYMBOLIC
from dmframe.graph.graph import Graph
from dmframe.page.content import content_of
from dmframe.page.periods import stable_periods

WEB: Final = Path(dmframe.page.__file__).parent / "web"
DRIVER: Final = Path(__file__).parent / "page" / "drive.mjs"


@cache
def content(name: str) -> dict[str, Any]:
    """A packaged graph's page as data; not to be changed."""
    return content_of_graph(dm.load(name))


def content_of_graph(graph: Graph, *, periods: bool = False) -> dict[str, Any]:
    """A graph's page as data; with `periods`, which take seconds, including those of its clock."""
    verdict, found = graph.verify().verdict, None
    if periods:
        with SYMBOLIC:
            found = stable_periods(graph.diagram, graph.clock, verdict, graph.start)
    return content_of(graph, verdict, found)


def answered(content: dict[str, Any], *, web: Path = WEB, **questions: Any) -> dict[str, Any]:
    """The answers of `drive.mjs`; the test is skipped without Node."""
    node = shutil.which("node")
    if node is None:
        pytest.skip("node is not installed")
    text = json.dumps({"web": web.as_uri(), "content": content, **questions})
    found = subprocess.run([node, str(DRIVER)], input=text, capture_output=True, text=True, check=False)
    assert found.returncode == 0, found.stderr
    answers: dict[str, Any] = json.loads(found.stdout)
    return answers
