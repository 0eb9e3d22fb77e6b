"""A plot's axis, in Node: its tick marks are finite in number, and no two have the same text."""

from __future__ import annotations

import json
import shutil
import subprocess

import pytest
from in_node import WEB

RANGES = [
    (1.0, 1.0 + 2.3e-16), (0.999999, 1.000001), (0.1499, 0.15), (123456.0, 123457.0), (1e16, 1e16),
    (-12345.0, -12330.0), (0.0, 2e-7), (1.5e-7, 1.5002e-7), (0.0, 1e-300), (-1.0, 1.0), (0.0, 20.0), (-1e10, 1e10),
]  # fmt: skip


def marks(*ranges: tuple[float, float], fault: tuple[str, str] = ("", "")) -> list[list[str]]:
    node = shutil.which("node")
    if node is None:
        pytest.skip("node is not installed")
    text = "".join((WEB / name).read_text("utf-8") for name in ("solver.js", "verdict.js", "plot.js"))
    assert fault[0] in text
    text = text.replace(*fault) if fault[0] else text
    call = "([low, high]) => levels(...widened(low, high), 1, 138).map(({ text }) => text)"
    text += f"console.log(JSON.stringify({json.dumps(ranges)}.map({call})));"
    words = [node, "--max-old-space-size=64", "--input-type=module", "-e", text]
    found = subprocess.run(words, capture_output=True, text=True, check=False)
    assert found.returncode == 0, "no end of marks"
    labels: list[list[str]] = json.loads(found.stdout)
    return labels


def test_an_axis_has_a_few_marks_that_all_read_differently() -> None:
    for texts in marks(*RANGES):
        assert 2 <= len(texts) <= 9
        assert len(set(texts)) == len(texts)
        assert max(map(len, texts)) <= 11


def test_marks_without_end_or_without_difference_are_noticed() -> None:
    with pytest.raises(AssertionError, match="no end of marks"):
        marks((1.0, 1.0 + 2.3e-16), fault=("* 1e-3 - (high - low)", "* 0"))
    assert set(marks((0.0, 2e-7), fault=("digits = decimals(step)", "digits = 0"))[0]) == {"0"}
