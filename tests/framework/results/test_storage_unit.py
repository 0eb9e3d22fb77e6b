"""The unit of V: derived from the blocks' storage functions, and none if V adds terms of several units."""

from __future__ import annotations

import pytest

import dmframe as dm
from dmframe.certify.claim import claim_of
from dmframe.common.units import base_units
from dmframe.results.storage_unit import storage_unit


@pytest.mark.parametrize(
    ("graph", "unit", "rate"),
    [("pd_torque", "N m", "N m/s"), ("ur10_fast", "m^2", "m^2/s"), ("arm2_joint", "1", "1/s")],
)
def test_v_has_the_unit_of_the_cascade_or_of_an_energy(graph: str, unit: str, rate: str) -> None:
    found = storage_unit(claim_of(dm.load(graph).diagram))
    assert (found.unit, found.rate, found.several) == (unit, rate, ())
    assert base_units(found.parts["arm"]) == base_units("J")  # a kinetic energy, by hand


def test_v_that_adds_an_energy_and_a_squared_frequency_has_no_unit_and_reports_it() -> None:
    found = storage_unit(claim_of(dm.load("torque_direct_pi").diagram))
    assert (found.unit, found.rate, found.several) == ("", "", ("1/s^2", "N m"))
    assert found.about == "its terms are in 1/s^2 and N m, each counted in SI's units"


def test_a_run_and_its_summary_have_the_unit_of_v() -> None:
    run = dm.load("ur10_fast").run(until=0.1)
    signals = run.data
    assert [signals[name].attrs["units"] for name in ("V", "V.arm", "V_rate")] == ["m^2", "m^2", "m^2/s"]
    signals = dm.load("torque_direct_pi").run(until=0.1).data
    assert [signals[name].attrs["units"] for name in ("V", "V.inverse", "V.task")] == ["unknown", "N m", "1/s^2"]
