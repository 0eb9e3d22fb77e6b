"""The regressor explains the torques of a real UR10e; skipped without the folder of its records."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from tests.real import ur10e
from tests.real.ur10e import HELD_OUT, fit, gains, record

FOLDER = Path(os.environ.get("DMFRAME_UR10E_RECORDS", "no folder"))
needed = pytest.mark.skipif(
    not (FOLDER / HELD_OUT).is_file(),
    reason="DMFRAME_UR10E_RECORDS is not the folder of the records, see docs/how_to/robots.md",
)


@needed
def test_the_torques_of_a_held_out_record_are_explained():
    made = fit(FOLDER)
    assert np.all(made.unexplained[:4] < 0.10)
    assert np.all(made.unexplained < 0.15)
    assert np.all(made.nominal > 2 * made.unexplained)
    assert np.all(made.viscous > 2)
    assert np.all(made.coulomb > 2)
    assert np.all(made.rotor[2:] > 0.2)


@needed
def test_a_wrong_sign_of_one_current_is_not_explained(monkeypatch):
    right = record
    monkeypatch.setattr(
        ur10e, "record", lambda path, k: right(path, k * ([-1, 1, 1, 1, 1, 1] if HELD_OUT in path.name else [1]))
    )
    assert fit(FOLDER).unexplained[0] > 1.5


def test_the_robots_own_gains_are_found_in_a_made_record(tmp_path):
    random = np.random.default_rng(0)
    true = np.array([12.0, 12.0, 10.0, 10.5, 11.0, 11.0])
    time, q, dq, tau = np.arange(500) * 0.01, *random.normal(size=(3, 500, 6))
    current = tau / true + 2.0 * dq + 0.5 * np.tanh(dq / 0.01)
    rows = np.column_stack([time, q, dq, current, current, tau])
    lines = [",".join(f"{value:.9g}" for value in row) for row in rows]
    lines[3] = ",".join(lines[3].split(",")[:19])  # a row of another width, as in the records
    (tmp_path / "made.csv").write_text("\n".join(lines))
    np.testing.assert_allclose(gains(tmp_path / "made.csv"), true, rtol=1e-6)
