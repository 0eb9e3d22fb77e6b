"""A page's verdict at dense positions of its sliders: where it is green, `verify` proves these numbers."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from in_node import WEB, answered, content

import dmframe as dm

STEPS = 80
"""Positions of each slider."""
EDGES = {"torque_direct_pid": 6, "pendulum": 2}
"""Positions that `verify` proves: the last green ones before another colour, and half as many combinations."""
Position = Mapping[str, float]


def sliders(data: Mapping[str, Any]) -> dict[str, Any]:
    """Sliders of numbers that a graph file sets by their label."""
    found = {slider["label"]: slider for slider in data["sliders"]}
    return {label: item for label, item in found.items() if "[" not in label and not label.startswith("robot.")}


def positions(data: Mapping[str, Any]) -> list[Position]:
    """Each slider separately, from end to end, then combinations of some."""
    known, rng = list(sliders(data)), np.random.default_rng(1)
    alone = [{label: float(place)} for label in known for place in np.linspace(-1, 1, STEPS)]
    some = [rng.choice(known, rng.integers(2, len(known) + 1), replace=False) for _ in range(300)]
    return [*alone, *({str(label): float(rng.uniform(-1, 1)) for label in labels} for labels in some)]


def moved(data: Mapping[str, Any], position: Position) -> tuple[dict[str, Any], dict[str, Any]]:
    """A query to the page, and the settings of a graph with the same numbers."""
    p, at, settings = list(data["p"]), list[int](), dict[str, Any]()
    for label, place in position.items():
        item = sliders(data)[label]
        rows = range(item["at"], item["at"] + item["size"])
        change = item["most"] ** place if item["kind"] == "factor" else item["most"] * place
        for k in rows:
            p[k] = float(f"{p[k] * change if item['kind'] == 'factor' else p[k] + change:.6g}")
        at += rows
        settings[label] = [p[k] for k in rows] if len(rows) > 1 else p[rows[0]]
    start = any(place in data["starts"]["reads"] for place in at)
    at += [len(p) + row for row in data["starts"]["rows"]] * start
    return {"p": p, "shift": None, "moved": {"p": True, "at": at, "start": start, "run": False}}, settings


def proofs_of_greens(name: str, web: Path = WEB) -> Iterator[tuple[Position, bool]]:
    """Positions that the page calls proved, each with whether `verify` proves it."""
    data, graph, most = content(name), dm.load(name), EDGES[name]
    walked = positions(data)
    found = answered(dict(data), web=web, judged=[moved(data, each)[0] for each in walked])["answers"]
    green = [answer["state"] in ("proved", "clock") for answer in found]
    assert any(green)
    alone = len(sliders(data)) * STEPS
    neighbours = [False, *green[: alone - 1]], [*green[1:alone], False]
    edges = [k for k in range(alone) if green[k] and not (neighbours[0][k] and neighbours[1][k])]
    edges = edges[:: max(1, len(edges) // most)][:most]
    others = [k for k in range(alone, len(walked)) if green[k]][: most // 2]
    for k in (*others, *edges):
        yield walked[k], graph.set(moved(data, walked[k])[1]).verify().proved


@pytest.mark.parametrize("name", EDGES)
def test_no_green_position_is_unproved(name: str) -> None:
    looked = list(proofs_of_greens(name))
    assert len(looked) >= EDGES[name]
    assert [position for position, proved in looked if not proved] == []


def test_a_page_that_takes_each_margin_for_one_that_holds_would_be_noticed(tmp_path: Path) -> None:
    shutil.copytree(WEB, tmp_path / "web")
    script = tmp_path / "web" / "verdict.js"
    text = script.read_text()
    assert "strict ? margin > 0 : margin >= 0" in text
    script.write_text(text.replace("strict ? margin > 0 : margin >= 0", "true"))
    assert not all(proved for _, proved in proofs_of_greens("torque_direct_pid", tmp_path / "web"))
