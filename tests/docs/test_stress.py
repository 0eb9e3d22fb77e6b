"""Robustness of the sampled law: the page is generated from its data, texts included, and the data from runs."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[2]
LAW, SUPERVISED, OBSERVER = "ur10_slow_sampled", "ur10_slow_supervised", "ur10_slow_observer"
KINEMATIC = ("ur10_slow_kinematic", "ur10_slow_kinematic_inverse")
Cells = dict[tuple[str, str], dict[str, str]]


@pytest.fixture(scope="module")
def study() -> ModuleType:
    spec = importlib.util.spec_from_file_location("study_stress", ROOT / "docs" / "study" / "stress.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["study_stress"] = module  # dataclasses look up their module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def cells(study: ModuleType) -> Cells:
    return {(row["case"], row["graph"]): row for row in study.read()}


def rms(row: dict[str, str]) -> float:
    """[mm], infinite if there is none."""
    return 1e3 * float(row["rms_final"] or "inf")


def test_the_data_hold_every_case_of_every_controller_once_and_the_page_shows_them(
    study: ModuleType, cells: Cells
) -> None:
    assert list(cells) == [(case, name) for case in study.CASES for name in study.CONTROLLERS]
    text = study.PAGE.read_text(encoding="utf-8")
    assert study.fill(text, study.read()) == text, "stale; run: python docs/study/stress.py --draw"
    moved = [dict(row) for row in study.read()]
    moved[2]["rms_final"] = "0.5"
    assert study.fill(text, moved) != text


UNTOLD = (
    "delay 3/4, configured 0",
    "delay 1, configured 0",
    "delay 0, configured 1",
    "delay 1 or 2 at random, configured 1",
)
HELD = "velocity P servo without q_c"
ECHOED = ("the same, the servo's target echoed", "delay 1, configured 0, the servo's target echoed")
AT_REST, CUT_OFF = "standing still", "a drive ends at 75 of 81 N m"


def of(cells: Cells, name: str) -> dict[str, dict[str, str]]:
    """The cases of a controller, except the one in which none has an error."""
    return {case: row for (case, graph), row in cells.items() if graph == name and case != AT_REST}


def test_where_delay_and_servo_are_as_configured_the_law_is_below_both_kinematic_controllers_and_does_not_grow(
    cells: Cells,
) -> None:
    for case, row in of(cells, LAW).items():
        if case not in (*UNTOLD, *ECHOED, HELD):
            assert rms(row) < min(rms(cells[case, name]) for name in KINEMATIC), case
            assert rms(row) < 1.25e3 * float(row["rms_middle"]), case
    assert rms(cells["q_c(0) off by 10 mrad, delay 1, steps", LAW]) < 0.5
    worse = [case for case in (*UNTOLD, HELD) if rms(cells[case, LAW]) > rms(cells[case, KINEMATIC[1]])]
    assert worse == [*UNTOLD, HELD]


def test_with_an_echo_law_and_observer_bear_a_wrong_delay_and_stay_below_the_kinematic_controller(cells: Cells) -> None:
    for case, name in ((case, name) for case in ECHOED for name in (LAW, OBSERVER)):
        assert rms(cells[case, name]) < 0.5 * rms(cells[case, KINEMATIC[0]])
        assert rms(cells[case, name]) < 1.25e3 * float(cells[case, name]["rms_middle"])
    assert all(rms(cells[case, SUPERVISED]) < 0.5 * rms(cells[case, KINEMATIC[1]]) for case in ECHOED)


def test_the_supervised_law_is_below_the_kinematic_controller_everywhere(cells: Cells) -> None:
    rows, more = of(cells, SUPERVISED), []
    for case, row in rows.items():
        assert rms(row) < rms(cells[case, KINEMATIC[0]]), case
        if rms(row) > 1.01 * rms(cells[case, KINEMATIC[1]]):
            more.append(case)
    assert more == ["delay 0, configured 1"]


def test_numbers_in_the_pages_words_are_those_of_the_table(study: ModuleType, cells: Cells) -> None:
    text = " ".join(study.PAGE.read_text(encoding="utf-8").split())
    rows = of(cells, SUPERVISED)
    late, heavy = "delay 1 or 2 at random, configured 1", "5 kg at half time, delay 1, steps"
    peaks = {name: 1e3 * float(cells[heavy, name]["peak_after"]) for name in (LAW, SUPERVISED, OBSERVER)}
    open_case, worst = cells["q_c(0) off by 10 mrad, delay 1, steps", LAW], cells[late, LAW]
    for words in (
        f"the error is {rms(open_case):.2g} mm",
        f"its largest error is {1e3 * float(worst['peak_after']):.0f} mm",
        f"error after 2 s is then {max(1e3 * float(rows[case]['peak_after']) for case in UNTOLD):.2g} mm",
        *(
            f"({rms(rows[case]):.3g} against {rms(cells[case, KINEMATIC[1]]):.3g} mm)"
            for case in ("delay 0, configured 1", "servo x 0.1, delay 1, steps")
        ),
        f"the law with J' ({rms(cells['servo x 0.1, delay 1, steps', LAW]):.3g} mm)",
        f"the error of the law is {rms(cells[ECHOED[0], LAW]):.3g} mm, of the observer "
        f"{rms(cells[ECHOED[0], OBSERVER]):.3g}, and of both supervised {rms(rows[ECHOED[0]]):.3g}",
        f"is {rms(cells[CUT_OFF, KINEMATIC[1]]):.0f} mm with the inverse of J, and "
        f"{rms(cells[CUT_OFF, KINEMATIC[0]]):.0f} with J'",
        f"its error is {rms(rows[CUT_OFF]):.0f} mm",
        f"{peaks[OBSERVER]:.3g} mm against {peaks[LAW]:.3g} of the law, and {peaks[SUPERVISED]:.3g} supervised",
    ):
        assert words in text, words


@pytest.mark.parametrize(
    ("case", "name"),
    [
        ("as configured", "ur10_slow_kinematic_inverse"),
        ("friction sticks and is uneven", "ur10_slow_observer"),
        ("velocity P servo without q_c", "ur10_slow_observer"),
        ("velocity P servo without q_c", "ur10_slow"),
        ("q_c(0) off by 10 mrad", LAW),
        ("q_c(0) off by 10 mrad, delay 1, steps", LAW),
        ("servo's q_c integrates 0.99 of dq_c", LAW),
        ("delay 1, configured 0", SUPERVISED),
        ("delay 1, configured 0", "ur10_slow_tuned"),
        ("rotors of 9 kg m^2", "ur10_slow_kinematic"),
        ("springs of 1e4 N m/rad, encoders at the motors", "ur10_slow_kinematic"),
        ("friction changes with the pose", "ur10_slow_kinematic"),
        ("servo filters its velocity, 30 ms", "ur10_slow_kinematic"),
        ("robot's clock fast by 1e-3", "ur10_slow_kinematic"),
    ],
)
def test_runs_come_out_as_in_the_data(case: str, name: str, study: ModuleType, cells: Cells) -> None:
    found, kept = study.row_of(case, name), cells[case, name]
    assert bool(found["fault"]) == bool(kept["fault"])
    for key in ("rms_final", "peak_after", "peak") if kept["rms_final"] else ():
        assert found[key] == pytest.approx(float(kept[key]), rel=0.02), key
