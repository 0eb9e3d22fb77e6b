"""Invalid logs are refused, with the place and the remedy."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from dmframe.common.errors import DmframeError
from dmframe.identification.identify import chain_of, identify
from tests.framework.identify.plants import Hidden, record, steps, write

Columns = tuple[np.ndarray, np.ndarray, np.ndarray]


@pytest.fixture(scope="module")
def log() -> Columns:
    """A tracking error of 20 ms, without a simulation."""
    u = steps(0.008, 12.0, 0)
    q = 1.0 + np.cumsum(np.roll(u, 3, axis=0), axis=0) * 0.008
    return 0.008 * np.arange(len(u)), q, u


def nan(t: np.ndarray, q: np.ndarray, u: np.ndarray) -> Columns:
    q = q.copy()
    q[7, 1] = np.nan
    return t, q, u


def still(t: np.ndarray, q: np.ndarray, u: np.ndarray) -> Columns:
    return t, q * [1, 0, 1], u * [1, 0, 1]


def moved(u: np.ndarray) -> Columns:
    """A log of commands with positions that lag by 24 ms."""
    return 0.008 * np.arange(len(u)), 1.0 + np.cumsum(np.roll(u, 3, axis=0), axis=0) * 0.008, u


def circle(t: np.ndarray, q: np.ndarray, u: np.ndarray) -> Columns:
    return moved(np.sin(0.5 * t[:, None] + [0, 1, 2]) * np.minimum(t, 1)[:, None] * 0.2)


def one_step(t: np.ndarray, q: np.ndarray, u: np.ndarray) -> Columns:
    begun = np.array([1.0, 4.0, 7.0])
    return moved(0.3 * ((t[:, None] > begun) * (t[:, None] < begun + 1)))


def one_way(t: np.ndarray, q: np.ndarray, u: np.ndarray) -> Columns:
    return moved(u * [1, 1, 0] + np.abs(u) * [0, 0, 1])


FAULTS: dict[str, tuple[Callable[..., Columns], str]] = {
    "nan": (nan, "q_2: expected finite numbers, found 1 others, the first in row 9"),
    "swapped": (lambda t, q, u: (t, q[:, [1, 0, 2]], u), "position 1 follows command 2"),
    "degrees": (lambda t, q, u: (t, np.rad2deg(q), np.rad2deg(u)), "seem to be in degrees"),
    "mixed units": (lambda t, q, u: (t, np.rad2deg(q) * 0.05, u), "times as far as commanded"),
    "positions in degrees": (lambda t, q, u: (t, np.rad2deg(q), u), "positions are beyond the robot's limits, and"),
    "positions in mrad": (lambda t, q, u: (t, 1e3 * q, u), "and seem to be in mrad; divide by 1000"),
    "all in mrad": (lambda t, q, u: (t, 1e3 * q, 1e3 * u), "and seem to be in mrad; divide by 1000"),
    "small positions in degrees": (lambda t, q, u: (t, 11 * (q - 1), 0.2 * u), "positions seem to be in degrees, and"),
    "commands in degrees": (
        lambda t, q, u: (t, q, 3 * np.rad2deg(u)),
        "commands are beyond the robot's limits, and seem to be in degrees",
    ),
    "slow commands in degrees": (lambda t, q, u: (t, q / 20, np.rad2deg(u) / 20), "commands seem to be in degrees"),
    "milliseconds": (lambda t, q, u: (1e3 * t, q, u), "time seems to be in ms"),
    "gap": (lambda t, q, u: (t + (t > 3) * 0.5, q, u), "gap of 0.508 s before row"),
    "repeated time": (lambda t, q, u: (np.minimum(t, 5), q, u), "time does not increase in row"),
    "backwards": (lambda t, q, u: (t, u.cumsum(0) * 0.008 + 1, np.roll(u, 3, axis=0)), "positions lead their commands"),
    "still joint": (still, "joint 2: the log excites it too little"),
    "circle": (circle, "joint 1: the log excites it too little (its velocity command changes quickly"),
    "one step": (one_step, "joint 1: the log excites it too little (it moves in one direction only)"),
    "one way": (one_way, "joint 3: the log excites it too little (it moves in one direction only)"),
    "3 s": (lambda t, q, u: moved(u[:375]), "the log lasts 2.99 s, and excites the joints too little: expected 5.5 s"),
    "short": (lambda t, q, u: (t[:90], q[:90], u[:90]), "expected at least 200 samples, found 90"),
    "other robot": (lambda t, q, u: (t, q + np.random.default_rng(0).normal(0, 1, q.shape), u), "do not follow"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_in_the_numbers_is_found(name: str, log: Columns, tmp_path: Path) -> None:
    change, text = FAULTS[name]
    with pytest.raises(DmframeError, match=r"log\.csv") as refused:
        identify(write(tmp_path / "log.csv", *change(*log)), chain_of("ur10_slow"))
    assert text in str(refused.value)
    assert ("excites" in text) == ("dmframe experiment ROBOT" in str(refused.value))


def test_a_refused_log_leaves_no_twin_of_another_one(log: Columns, tmp_path: Path) -> None:
    for name in ("identified.json", "twin.yaml", "twin.urdf"):
        (tmp_path / name).write_text("of another log")
    with pytest.raises(DmframeError):
        identify(write(tmp_path / "log.csv", *nan(*log)), chain_of("ur10_slow"), out=tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["log.csv", "previous"]
    assert (tmp_path / "previous" / "twin.yaml").read_text() == "of another log"


def test_more_lost_commands_than_can_be_estimated_are_refused(log: Columns, tmp_path: Path) -> None:
    t, q, u = log
    changes = np.flatnonzero(np.any(np.diff(u, axis=0), axis=1))[:30] + 1
    kept = np.setdiff1d(np.arange(len(t)), changes)
    with pytest.raises(DmframeError, match="of their commands at changes, which are not known: expected at most 24"):
        identify(write(tmp_path / "log.csv", t[kept], q[kept], u[kept]), chain_of("ur10_slow"))


@pytest.mark.parametrize(
    ("content", "text"),
    [
        ("", "found an empty file"),
        ("t,q_1,q_1\n0,1,2\n", "the column q_1 appears 2 times"),
        ("0,1,2\n1,2,3\n", "expected a header"),
        ("0,1,1,0,0\n1,2,3,4,5\n", "expected a header with names of columns, found numbers"),
        ("t,q_1\n0,1\n1\n", ":3: expected 2 cells"),
        ("t;q_1\n0;1,5\n", ":2: column q_1: expected a number, found '1,5'; write a decimal point"),
        ("t,q_1\n0,a\n", ":2: column q_1: expected a number, found 'a'"),
        ("q_1,q_2,q_3\n1,2,3\n", "expected a column of time"),
        ("t,q_1,q_2\n1,2,3\n", "expected those of 3 joints, found 2"),
        ("t,q_1,q_2,q_3\n1,2,3,4\n", "expected commands"),
        ("t,a,b,c\n1,2,3,4\n", "expected positions"),
    ],
)
def test_a_fault_in_the_file_is_found(content: str, text: str, tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text(content)
    with pytest.raises(DmframeError) as refused:
        identify(tmp_path / "log.csv", chain_of("ur10_slow"))
    assert text in str(refused.value)


def test_unknown_columns_are_refused_with_the_nearest(log: Columns, tmp_path: Path) -> None:
    file = write(tmp_path / "log.csv", *log, names=lambda stem, j: f"my_{stem}_{j}")
    with pytest.raises(DmframeError, match="did you mean my_q_1"):
        identify(file, chain_of("ur10_slow"), columns=["q_1=my_q_11"])


def test_the_hidden_robot_of_these_tests_holds_still_without_commands() -> None:
    hidden = Hidden(np.full(3, 5.0), np.full(3, 5.0), np.full(3, 4.0))
    _, q, _ = record(hidden, seconds=0.4)
    assert np.ptp(q) > 1
    assert np.all(np.ptp(q, axis=0) == 0)
