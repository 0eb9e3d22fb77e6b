"""The batch runner: which graphs share a closed loop and a batch, compared with separate runs of the graphs."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import dmframe as dm
from dmframe.batch import batch, runner
from dmframe.batch.batch import Batch
from dmframe.batch.figures import Measured, MeasuredSignals, merged
from dmframe.batch.runner import Runner, Runs
from dmframe.common.errors import ValueFault

WANTED = MeasuredSignals(("arm.q",))
GAINS = np.array([[60.0, 40.0], [30.0, 50.0], [45.0, 45.0]])


def measured(several: list[Runs], **options: Any) -> list[Measured]:
    return Runner().measure(several, lambda _: WANTED, **options)


def items() -> list[Runs]:
    graph = dm.load("arm2_joint").until(0.2)
    return [Runs(graph.set({"dynamics.Gamma": gain}), {"servo.K_P": GAINS}, 3) for gain in (1, 30)]


def final(found: Measured) -> np.ndarray:
    assert found.error is not None
    return found.error.rms_final[:, 0]


def test_graphs_that_differ_in_numbers_run_in_one_batch_with_the_figures_of_each_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    several, sizes, measure = items(), list[int](), Batch.measure

    def counted(batch: Batch, values: Any, runs: int = 1) -> Measured:
        sizes.append(runs)
        return measure(batch, values, runs)

    monkeypatch.setattr(Batch, "measure", counted)
    together = measured(several)
    assert sizes == [6]
    for item, found in zip(several, together, strict=True):
        (alone,) = measured([item])
        np.testing.assert_allclose(final(found), final(alone), rtol=1e-12)
        one = item.graph.set({"servo.K_P": GAINS[1].tolist()}).run(engine="interpreted")
        assert one.error is not None
        assert final(found)[1] == pytest.approx(one.error.rms_final, rel=1e-9)
    monkeypatch.setattr(runner, "numbers_between", lambda base, other: {})
    spoilt = measured(several)
    assert not np.allclose(final(spoilt[1]), final(together[1])), "numbers that are lost would pass unseen"


def test_values_of_the_graphs_own_keys_get_a_graph_per_run_and_a_wrong_one_a_fault() -> None:
    graph = dm.load("arm2_joint").until(0.2)
    clocks = np.array([0.004, -1.0, 0.002])
    (found,) = measured([Runs(graph, {"clock": clocks}, 3)])
    assert list(found.faults) == [1]
    assert "clock" in str(found.faults[1])
    assert np.isnan(final(found)[1])
    for k in (0, 2):
        one = graph.set({"clock": float(clocks[k])}).run()
        assert one.error is not None
        assert final(found)[k] == pytest.approx(one.error.rms_final, rel=1e-9)


def test_parts_with_other_signals_are_not_merged() -> None:
    (found,) = measured([Runs(dm.load("arm2_joint").until(0.02))])
    (other,) = Runner().measure([Runs(dm.load("arm2_joint").until(0.02))], lambda _: MeasuredSignals())
    with pytest.raises(ValueFault, match="expected runs that measure the same signals"):
        merged([(np.array([0]), found), (np.array([1]), other)], 2)


def test_a_list_of_another_length_is_another_loop() -> None:
    base = dm.load("arm2_joint").until(0.1)
    path = {"type": "waypoints", "times": [0, 1], "q_d": [[0.5, 0.5], [0.6, 0.5]]}
    longer = path | {"times": [0, 1, 2], "q_d": [[0.5, 0.5], [0.6, 0.5], [0.6, 0.6]]}
    several = [Runs(base.set({"blocks.path": each})) for each in (path, longer)]
    for item, found in zip(several, measured(several), strict=True):
        np.testing.assert_allclose(final(found), final(measured([item])[0]), rtol=1e-12)


def test_graphs_on_several_clocks_share_their_machine_code(monkeypatch: pytest.MonkeyPatch) -> None:
    made, compiled = list[object](), batch.compiled

    def counted(step: Any) -> Any:
        made.append(step)
        return compiled(step)

    monkeypatch.setattr(batch, "compiled", counted)
    several = [Runs(dm.load("arm2_joint").until(0.2).set(clock=clock)) for clock in ("2 ms", "4 ms", "5 ms")]
    together = measured(several)
    assert len(made) == 1
    for item, found in zip(several, together, strict=True):
        one = item.graph.run(engine="interpreted")
        np.testing.assert_allclose(final(found), one.error.rms_final, rtol=1e-9)
    assert len({float(final(found)[0]) for found in together}) == 3
