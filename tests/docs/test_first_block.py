"""The first controller of docs/tutorial/first_block.md: its error decays at its rate; it needs both declarations."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import dmframe as dm
from dmframe.common.errors import AccessError, DmframeError, WiringError
from tests.page_code import page_file

GRAPH = """\
dmframe: 1
robot: arm2
clock: 2 ms
duration: 1 s
start: {q: [40 deg, 60 deg]}
blocks:
  path:  {type: sinusoid, center: [45 deg, 60 deg], amplitude: [30 deg, 40 deg], rate: [0.9 rad/s, 1.4 rad/s]}
  law:   {type: "control.py:Proportional", k: 5}
  servo: {type: pi_servo, K_P: 6000, K_I: 24000}
  arm:   {type: manipulator, viscous: [1, 0.5]}
"""


def loaded(folder: Path, without: str = "") -> dm.Graph:
    text = page_file("docs/tutorial/first_block.md", "control.py")
    assert without in text
    (folder / "control.py").write_text(text.replace(without, "") if without else text, encoding="utf-8")
    (folder / "arm.yaml").write_text(GRAPH, encoding="utf-8")
    return dm.load(folder / "arm.yaml")


def test_the_error_of_the_first_controller_decays_at_its_rate(tmp_path: Path) -> None:
    """With a stiff servo the command is the velocity, so that de/dt = -k e from e(0) = -5 deg."""
    run = loaded(tmp_path).run()
    t = run.time
    desired = np.radians(45) + np.radians(30) * np.sin(0.9 * t)
    error = np.asarray(run["arm.q"])[:, 0] - desired
    np.testing.assert_allclose(error, -np.radians(5) * np.exp(-5 * t), atol=2e-3)


@pytest.mark.parametrize(
    ("without", "kind", "named"),
    [
        (', derivative_of="q_d"', WiringError, 'declare it with derivative_of="q_d"'),
        (", access=Access.COMMANDED", AccessError, "declare the output of law with access=Access.COMMANDED"),
    ],
)
def test_the_message_names_a_missing_declaration(
    tmp_path: Path, without: str, kind: type[DmframeError], named: str
) -> None:
    with pytest.raises(kind) as fault:
        _ = loaded(tmp_path, without).diagram
    assert named in str(fault.value)
