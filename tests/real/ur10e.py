"""Unexplained torque, friction and rotors of a real UR10e, from records of its joints and currents.

    python tests/real/ur10e.py FOLDER

FOLDER contains `identification_data` of the repository shamilmamedov/dynamic_calibration: CSV files with time, six
angles, six velocities, six currents, six desired currents and six desired torques in 31 columns. The base parameters of
`ur10e`, rotors, viscous and Coulomb friction are fitted to one record by least squares, and validated on another one.
The torque is the current times the robot's own gain, found from the desired currents and torques:
i_des = tau_des/k_t + viscous and Coulomb terms.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy

from dmframe.regressor.base_parameters import base_parameters
from dmframe.regressor.export import regressor_function
from dmframe.robot.library import load

FITTED, HELD_OUT = "ur-20_02_10-30sec_12harm.csv", "ur-20_02_12-40sec_12harm.csv"
PERIOD = 0.01
"""Period of the resampled signals [s]."""
CUT = 5.0
"""Cut-off frequency of the zero-phase filter, the same for all signals [Hz]."""
EDGE = 100
"""Samples left out at both ends of a record."""
PACKAGED = (5, 5, 2, 0.2, 0.1, 0.01), (8, 8, 4, 0, 0, 0)
"""Viscous and Coulomb friction of the packaged graph `ur10_full` [N m s/rad, N m]."""
FRICTION = ("viscous", "coulomb", "rotor")


@dataclass(frozen=True)
class Fit:
    """Unexplained torque on the held-out record as a fraction of its standard deviation; friction, rotors and gains.

    The rotors of joints 1 and 2 are part of the links' inertia: they are the difference from the data sheet's links.
    """

    unexplained: np.ndarray
    viscous: np.ndarray
    coulomb: np.ndarray
    rotor: np.ndarray
    nominal: np.ndarray
    gains: np.ndarray


def table(path: Path, width: int) -> np.ndarray:
    """The first columns of a record, one row per time; narrower rows are omitted."""
    lines = path.read_text(encoding="utf-8").splitlines()
    rows = np.array(
        [[float(word) for word in line.split(",")[:width]] for line in lines if line.count(",") >= width - 1]
    )
    return rows[np.unique(rows[:, 0], return_index=True)[1]]


def gains(path: Path) -> np.ndarray:
    """Torque per current of each joint, as the robot's controller computes it [N m/A]."""
    rows, found = table(path, 31), np.zeros(6)
    for k in range(6):
        dq = rows[:, 7 + k]
        terms = np.stack([rows[:, 25 + k], dq, np.tanh(dq / 0.01)], axis=1)
        found[k] = 1 / np.linalg.lstsq(terms, rows[:, 19 + k], rcond=None)[0][0]
    return found


def record(path: Path, per_current: np.ndarray) -> tuple[np.ndarray, ...]:
    """Angles, velocities, accelerations and torques of a record, filtered."""
    rows = table(path, 19)
    time = np.arange(rows[0, 0], rows[-1, 0], PERIOD)
    signals = np.stack([np.interp(time, rows[:, 0], rows[:, k]) for k in range(1, 19)], axis=1)
    smooth = scipy.signal.filtfilt(*scipy.signal.butter(4, 2 * CUT * PERIOD), signals, axis=0)
    q, dq, current = np.split(smooth, 3, axis=1)
    ddq = np.gradient(dq, PERIOD, axis=0)
    moving = np.flatnonzero(np.abs(dq).max(axis=1) > 0.02)
    kept = slice(max(moving[0], EDGE), min(moving[-1], len(time) - EDGE))
    return q[kept], dq[kept], ddq[kept], current[kept] * per_current


def rows_of(motion: Sequence[np.ndarray]) -> np.ndarray:
    """Base columns of the regressor along a record, time by joint by column."""
    function = regressor_function(load("ur10e"), FRICTION, base=True)
    q, dq, ddq = (values.T for values in motion[:3])
    flat = np.array(function.map(q.shape[1])(q, dq, dq, ddq))
    return flat.reshape(6, q.shape[1], -1).transpose(1, 0, 2)


def fit(folder: Path, fitted: str = FITTED, held_out: str = HELD_OUT) -> Fit:
    """Weighted least squares on one record, validated on another."""
    chain = load("ur10e")
    base = base_parameters(chain, FRICTION, symbolic=False)
    per_current = gains(folder / fitted)
    known, unknown = record(folder / fitted, per_current), record(folder / held_out, per_current)
    Y, tau = rows_of(known), known[3]
    weight = np.ones(6)
    for _ in range(2):  # ordinary, then weighted by the residual of each joint
        scaled = (Y * weight[:, None]).reshape(-1, base.count)
        found = np.linalg.lstsq(scaled, (tau * weight).ravel(), rcond=None)[0]
        weight = 1 / np.std(tau - Y @ found, axis=0)
    size = np.std(unknown[3], axis=0)
    rows = rows_of(unknown)
    values = dict(zip(base.names, base.parameters.values, strict=True))
    nominal = np.array(base.grouping, dtype=float) @ np.array([float(values[name] or 0) for name in base.names])
    place = {name: k for k, name in enumerate(base.kept)}
    rotor = [place.get(f"I_r{k}", place.get(f"I_zz{k}")) for k in range(1, 7)]  # I_zz contains rotors 1 and 2
    alone = np.array([k > 2 for k in range(1, 7)])
    packaged = nominal.copy()
    for joint, (viscous, coulomb) in enumerate(zip(*PACKAGED, strict=True), 1):
        packaged[place[f"B_{joint}"]], packaged[place[f"D_{joint}"]] = viscous, coulomb
    return Fit(
        gains=per_current,
        unexplained=np.std(unknown[3] - rows @ found, axis=0) / size,
        nominal=np.std(unknown[3] - rows @ packaged, axis=0) / size,
        viscous=np.array([found[place[f"B_{k}"]] for k in range(1, 7)]),
        coulomb=np.array([found[place[f"D_{k}"]] for k in range(1, 7)]),
        rotor=np.where(alone, found[rotor], found[rotor] - nominal[rotor]),
    )


def main(folder: str) -> None:
    """Print the table."""
    made = fit(Path(folder))
    print(f"fitted to {FITTED}, validated on {HELD_OUT}")
    rows = {
        "torque per current [N m/A]": made.gains,
        "unexplained torque [%]": 100 * made.unexplained,
        "with the packaged graphs' friction [%]": 100 * made.nominal,
        "viscous [N m s/rad]": made.viscous,
        "Coulomb [N m]": made.coulomb,
        "rotor [kg m^2]": made.rotor,
    }
    for name, values in rows.items():
        print(f"{name:40s}" + "".join(f"{value:8.2f}" for value in values))


if __name__ == "__main__":
    main(sys.argv[1])
