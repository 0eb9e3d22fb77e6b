"""A page contains the origin and the licences of its robot, the hash of its model, and a policy for its one script."""

from __future__ import annotations

import base64
import hashlib
import re
import shutil
from pathlib import Path

import pytest
from in_node import content

import dmframe as dm
from dmframe.page.origin import origin_of
from dmframe.page.page import assembled


def test_a_page_states_where_its_robot_comes_from_and_under_which_licence() -> None:
    found = content("ur10_fast_kinematic")["origin"]
    assert "ROS-Industrial's `universal_robot`" in found["text"]
    assert "Licence: BSD" in found["text"]
    assert any("Redistribution and use in source and binary forms" in item["text"] for item in found["licences"])
    assert "BSD-3-Clause, as dmframe" in content("arm2_joint")["origin"]["text"]


def test_a_licence_next_to_a_urdf_is_carried_and_a_robot_without_one_is_reported_to_have_none(tmp_path: Path) -> None:
    urdf = next((Path(dm.__file__).parents[1] / "plants/dmframe_plants/pendulum").glob("*.urdf"))
    own = tmp_path / "deep/robot/urdf/own.urdf"
    own.parent.mkdir(parents=True)
    shutil.copyfile(urdf, own)
    graph = dm.load("pendulum").set({"robot.model": str(own)})
    found = origin_of(graph)
    assert found is not None
    assert found["licences"] == []
    assert "are unknown: no SOURCE.md and no licence file found" in found["text"]
    (own.parents[1] / "LICENSE").write_text("Do as you like.\n")
    again = origin_of(graph)
    assert again is not None
    assert again["licences"] == [{"name": "robot/LICENSE", "text": "Do as you like.\n"}]


def test_a_page_contains_the_hash_of_the_model_that_it_runs() -> None:
    assert content("arm2_joint")["fingerprint"] == dm.load("arm2_joint").diagram.fingerprint
    other = dm.load("arm2_joint").set({"task.alpha_bar": 3})
    assert len(other.diagram.fingerprint) >= 16


@pytest.mark.parametrize("tag", ["script", "style"])
def test_the_policy_allows_the_pages_own_script_and_style_alone(tag: str) -> None:
    html = assembled(content("arm2_joint"))
    (policy,) = re.findall(r'http-equiv="Content-Security-Policy" content="([^"]*)"', html)
    allowed = dict(part.split(" ", 1) for part in policy.split("; "))
    assert allowed["default-src"] == allowed["connect-src"] == "'none'"
    assert "unsafe-inline" not in policy
    opened = '<script type="module">' if tag == "script" else "<style>"
    (inside,) = re.findall(f"{opened}(.*?)</{tag}>", html, re.DOTALL)
    digest = base64.b64encode(hashlib.sha256(inside.encode()).digest()).decode()
    assert f"'sha256-{digest}'" in allowed[f"{tag}-src"].split()
    assert not re.findall(r'\sstyle="', html.split("<body>")[1].split("<script")[0])
