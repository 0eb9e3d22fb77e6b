"""Reference for a joint path in discrete time: its law by hand, and the gain from margins."""

from __future__ import annotations

import numpy as np
import pytest

from dmframe.catalogue import block_types
from dmframe.common.errors import DmframeError

KIND = block_types()["sampled_joint_tracking"]
T = 0.02


def reference(block: object, delay: int, q_start: list[float], path: list[list[float]], **given: float) -> np.ndarray:
    """dq_r of the block, with the path at this and the next samples."""
    ahead = {"q_d": path[0], **{f"q_d_{k}": path[k] for k in range(1, len(path))}}
    found = block.evaluate({"q_start": q_start, **ahead, **given, "T": T}, {}, robot="arm2")  # type: ignore[attr-defined]
    return np.array(found.outputs["dq_r"], dtype=float).ravel()


PATH = [[0.1, -0.2], [0.15, -0.22], [0.25, -0.25], [0.4, -0.3]]


@pytest.mark.parametrize("delay", [0, 1, 2])
def test_a_robot_that_moves_as_commanded_keeps_the_share_of_its_error(delay: int) -> None:
    q = [0.13, -0.1]
    dq = reference(KIND(Lambda=5.0, delay=delay), delay, q, PATH[: delay + 2])
    before, after = np.array(PATH[delay]), np.array(PATH[delay + 1])
    np.testing.assert_allclose(q + T * dq - after, (1 - T * 5.0) * (q - before), atol=1e-15)


@pytest.mark.parametrize(("margin", "samples"), [(1.5, 1), (3.0, 2)])
def test_the_gain_from_margins_is_at_the_limit_of_the_delayed_loop(margin: float, samples: int) -> None:
    """e(k+1) = e(k) - gain e(k-m) has its poles inside the unit circle below the margin, and outside above it."""
    dq = reference(KIND(gain_margin=margin, delay_margin=samples), 0, [1.0, 0.0], [[0.0, 0.0], [0.0, 0.0]])
    step = -T * dq[0]
    for factor, stable in ((0.999 * margin, True), (1.001 * margin, False)):
        poles = np.roots([1.0, -1.0, *[0.0] * (samples - 1), factor * step])
        assert bool(np.max(np.abs(poles)) < 1) is stable


def test_with_an_identified_delay_it_aims_that_far_ahead() -> None:
    block, q = KIND(gain_margin=2.0, delay_up_to=2), [0.13, -0.1]
    given = {"delay_hat": 1.0, "identified": 1.0}
    dq = reference(block, 2, q, PATH, **given)
    step = 2 * np.sin(np.pi / (4 * (1 + 1) + 2)) / 2.0
    np.testing.assert_allclose(q + T * dq, np.array(PATH[2]) + (1 - step) * (np.array(q) - PATH[1]), atol=1e-15)


@pytest.mark.parametrize("given", [{}, {"Lambda": 1.0, "gain_margin": 2.0}, {"gain_margin": 0.5}])
def test_it_needs_one_gain(given: dict[str, float]) -> None:
    with pytest.raises(DmframeError, match="gain_margin"):
        KIND(**given)
