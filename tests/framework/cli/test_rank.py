"""``dmframe analyse --rank``: a page, JSON, faults."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

QUICK = ("--tube", "0.01 rad", "--boxes", "500", "--set", "duration=1 s")


def test_the_page_prints_the_region_and_how_to_use_it(dmframe: Any) -> None:
    reported = dmframe("analyse", "theorem_3", "--rank", *QUICK)
    assert (reported.status, reported.err) == (0, "")
    for expected in ("within 0.01 rad", "radius", "fails at", "certified", "tightest", "Assumption: the robot stays"):
        assert expected in reported.out
    pasted = YAML(typ="safe").load(reported.out.partition("under blocks:")[2])
    lower, upper = pasted["geometry"]["a_k_hat_box"]
    assert len(lower) == len(upper) == 12
    used = dmframe("check", "theorem_3", "--set", f"geometry.a_k_hat_box={pasted['geometry']['a_k_hat_box']}")
    assert used.status == 0


def test_json_holds_the_set_the_bound_and_what_to_paste(dmframe: Any) -> None:
    data = json.loads(dmframe("analyse", "theorem_3", "--rank", "--json", "--shape", "ball", *QUICK).out)
    assert (data["holds"], data["loss"], data["option"]) == (True, None, "geometry.a_k_hat_ball")
    assert data["set"][0]["name"] == "shoulder_pan_joint x"
    assert 0 < data["asked"] <= data["certified"] < data["nominal"]
    assert data["radius"] < data["fails_at"]
    assert data["value"][1] <= data["radius"]
    page = Path(__file__).parents[3].joinpath("docs", "reference", "command_line.md").read_text(encoding="utf-8")
    assert all(f"`{key}`" in page for key in (*data, *data["path"], *data["set"][0]))


def test_known_kinematics_have_nothing_to_paste(dmframe: Any) -> None:
    reported = dmframe("analyse", "ur10_fast", "--rank", *QUICK)
    assert reported.status == 0
    assert "it bounds the model error" in " ".join(reported.out.split())
    assert "under blocks" not in reported.out


def test_an_estimate_that_starts_outside_is_reported(dmframe: Any) -> None:
    reported = dmframe("analyse", "theorem_3", "--rank", *QUICK, "--set", "geometry.start_error=150 mm")
    assert reported.status == 0
    assert "The initial estimate is outside" in reported.out


def test_a_path_that_cannot_be_followed_is_reported_with_the_time_and_the_status(dmframe: Any) -> None:
    reported = dmframe("analyse", "theorem_3", "--rank", "--set", "path.radius=0.9")
    assert reported.status == 1
    assert "no region: the path leaves the workspace at t = 0 s" in reported.out
    data = json.loads(dmframe("analyse", "theorem_3", "--rank", "--set", "path.radius=0.9", "--json").out)
    assert (data["holds"], data["radius"], data["value"], data["loss"]["kind"]) == (False, 0, None, "unreachable")


def test_wrong_arguments_are_refused(dmframe: Any) -> None:
    for arguments, text in (
        (("--tube", "1 s"), "expected a quantity in rad"),
        (("--tube", "-1"), "tube: expected an angle of at least 0 rad, found -1"),
        (("--shape", "cone"), "shape: expected box or ball, found cone"),
    ):
        reported = dmframe("analyse", "theorem_3", "--rank", *arguments)
        assert reported.status == 2
        assert text in reported.err
    assert "full row rank" in dmframe("analyse", "arm2_joint", "--rank").err
