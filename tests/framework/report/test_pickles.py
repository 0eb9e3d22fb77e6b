"""Verifications and drawings by a pickle, in this process and in another."""

from __future__ import annotations

import pickle
import subprocess
import sys
from pathlib import Path

import pytest

import dmframe as dm


@pytest.mark.parametrize("overrides", [{}, {"inverse.Lambda": 0.02}])
def test_a_verification_comes_back_as_it_was(overrides: dict[str, float], tmp_path: Path) -> None:
    found = dm.load("pendulum").set(overrides).verify(seed=3)
    again = pickle.loads(pickle.dumps(found))
    assert str(again) == str(found)
    assert again.summary == found.summary
    assert (again.outcome, again.reason, again.seed, again.label) == (
        found.outcome,
        found.reason,
        found.seed,
        found.label,
    )
    assert [(item.name, item.value) for item in again.conditions] == [
        (item.name, item.value) for item in found.conditions
    ]
    assert again.diagram.fingerprint == found.diagram.fingerprint
    assert pickle.loads(pickle.dumps(again)).summary == found.summary
    file = tmp_path / "found.pickle"
    file.write_bytes(pickle.dumps(found))
    source = "import pickle, sys; print(pickle.load(open(sys.argv[1], 'rb')).outcome)"
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", source, str(file)], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == found.outcome


def test_a_drawing_comes_back_as_its_picture(tmp_path: Path) -> None:
    drawing = dm.load("pendulum").draw()
    again = pickle.loads(pickle.dumps(drawing))
    assert (again.svg, again.mermaid, again.title, repr(again)) == (
        drawing.svg,
        drawing.mermaid,
        drawing.title,
        repr(drawing),
    )
    assert pickle.loads(pickle.dumps(again)).svg == drawing.svg
    again.save(tmp_path / "again.svg")
    assert (tmp_path / "again.svg").read_text(encoding="utf-8") == drawing.svg
