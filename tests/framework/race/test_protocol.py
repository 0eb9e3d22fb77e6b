"""The protocol of a race on given errors: candidates, choice, ratios and quantiles by hand."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

import pytest

from dmframe.common.errors import DisagreementError
from dmframe.race.plan import Race, Run
from dmframe.race.protocol import chosen, judged_runs, rows_of, spread, tuning_runs
from dmframe.race.read import load_race

Make = Callable[..., Race]


def errors_of(runs: Iterable[Run]) -> dict[Run, float]:
    """An error that increases with the distance of gamma from 10, so the best candidate is known."""
    return {run: 1 + abs(math.log(run.values[0][1] / 10)) for run in runs}


def test_candidates_are_the_graphs_values_and_a_halton_sequence_log_uniform_over_the_range(race: Make) -> None:
    found = race(("clocks: [20 ms]", "clocks: [20 ms, 40 ms]"))
    # the first points of a Halton sequence in one dimension are 1/2, 1/4 and 3/4
    assert found.candidates("weak", 0.02) == [(("task.gamma", gamma),) for gamma in (4, 2, 1.4142, 2.8284)]
    assert found.candidates("tuned", 0.02) == [(("task.gamma", gamma),) for gamma in (4, 10, 3.1623, 31.623)]
    assert found.candidates("tuned", 0.04)[1] == (("task.gamma", 5.0),)


def test_every_law_has_the_same_number_of_runs_on_the_training_cells_and_none_elsewhere(race: Make) -> None:
    found = race()
    runs = tuning_runs(found)
    for law in found.file.laws:
        mine = [run for run in runs if run.law == law]
        assert len({run.values for run in mine}) == found.file.budget
        assert len(mine) == 2 * found.file.budget  # one training cell, without and with the margins
    assert {(run.cell.plant, run.cell.path, run.seed) for run in runs} == {("first", "circle", 0)}
    held_out = {(run.cell.plant, run.cell.path, run.seed) for run in judged_runs(found, chosen(found, errors_of(runs)))}
    assert held_out == {("second", "other", 1)}


def test_the_candidate_with_the_least_mean_of_log_error_is_taken(race: Make) -> None:
    found = race(("budget: 4", "budget: 3"), ("realities: {ideal: {}}", "realities: {ideal: {}, b: {}, c: {}}"))
    found = replace(found, file=found.file.model_copy(update={"training": _all_realities(found)}))
    by_candidate = {4.0: (1.0, 1.0, 9.0), 10.0: (0.9, 2.0, 2.0), 3.1623: (0.1, 1.1, 1.2)}
    errors = errors_of(tuning_runs(found))
    for run in errors:
        if run.law == "tuned":
            errors[run] = by_candidate[run.values[0][1]]["ideal b c".split().index(run.cell.reality)]
    tuned = chosen(found, errors)[0]
    assert [each.score for each in tuned.tried] == pytest.approx([math.log(error) / 3 for error in (9, 3.6, 0.132)])
    assert tuned.best is tuned.tried[2]  # the first one has the least median


def _all_realities(race: Race) -> object:
    return race.file.training.model_copy(update={"realities": ("ideal", "b", "c")})


@pytest.mark.parametrize("margin", [False, True])
def test_a_candidate_that_diverges_in_training_or_with_the_margins_is_rejected(race: Make, margin: bool) -> None:
    found = race()
    errors = errors_of(tuning_runs(found))
    assert chosen(found, errors)[0].best == chosen(found, errors)[0].tried[1]  # gamma 10
    for run in errors:
        if run.values[0][1] == 10 and run.margin is margin:
            errors[run] = math.inf
    again = chosen(found, errors)[0]
    how = "with the margins" if margin else "as it is"
    assert again.tried[1].why == f"diverges {how} in 20 ms, circle, first, ideal"
    assert again.best is again.tried[0]  # gamma 4


def test_errors_under_the_margins_do_not_decide_among_candidates_that_do_not_diverge(race: Make) -> None:
    found = race()
    errors = errors_of(tuning_runs(found))
    worse = {run: 50.0 if run.margin else error for run, error in errors.items()}
    assert chosen(found, worse) == chosen(found, errors)


def test_a_law_whose_tuning_was_skipped_is_refused(race: Make) -> None:
    found = race()
    runs = tuning_runs(found)
    own = found.candidates("weak", 0.02)[0]
    skipped = [run for run in runs if run.law != "weak" or run.values == own]
    with pytest.raises(DisagreementError) as caught:
        chosen(found, errors_of(skipped))
    text = "weak was not tuned by the protocol: its candidate {'task.gamma': 2.0} has no run in the training cell 20 ms"
    assert text in str(caught.value)
    without_margins = [run for run in runs if not (run.law == "weak" and run.margin)]
    with pytest.raises(DisagreementError, match="20 ms, circle, first, ideal, with margins"):
        chosen(found, errors_of(without_margins))


def test_ratios_are_those_to_the_best_rival_of_each_cell(race: Make) -> None:
    found = race(
        ("clocks: [20 ms]", "clocks: [20 ms, 40 ms, 50 ms, 80 ms]"),
        ("  weak:", "  third: {graph: law.yaml, tune: {task.gamma: [1, 4]}}\n  weak:"),
    )
    table = {  # errors of tuned, third and weak in mm by the clock in ms, the best rival, and the ratio by hand
        20: ((1.0, 4.0, 2.0), "weak", 0.5),
        40: ((3.0, 2.0, math.inf), "third", 1.5),
        50: ((5.0, math.inf, math.inf), "third", 0.0),
        80: ((math.inf, 3.0, 1.0), "weak", math.inf),
    }
    runs = judged_runs(found, chosen(found, errors_of(tuning_runs(found))))
    place = {"tuned": 0, "third": 1, "weak": 2}
    rows = rows_of(found, {run: table[round(1000 * run.cell.clock)][0][place[run.law]] for run in runs})
    assert [(row.best_rival, row.ratio) for row in rows] == [(best, ratio) for _, best, ratio in table.values()]
    first, _, _, last = json.loads(json.dumps([row.summary for row in rows]))
    cell = "20 ms, other, second, ideal"
    assert first == {"cell": cell, "law": "tuned", "error": 1, "best_rival": "weak", "rival_error": 2, "ratio": 0.5}
    assert (last["error"], last["ratio"], last["rival_error"]) == (None, None, 1)


def test_a_law_whose_candidates_are_all_rejected_counts_as_diverged_in_every_cell(race: Make) -> None:
    found = race()
    errors = errors_of(tuning_runs(found))
    choices = chosen(found, {run: math.inf if run.law == "weak" else error for run, error in errors.items()})
    assert choices[1].best is None
    runs = judged_runs(found, choices)
    assert {run.law for run in runs} == {"tuned"}
    (row,) = rows_of(found, dict.fromkeys(runs, 2.0))
    assert (row.rival_error, row.ratio) == (math.inf, 0.0)


def test_quantiles_are_order_statistics_and_the_interval_of_the_median_is_a_seeded_bootstrap() -> None:
    values = [4.0, 1.0, math.inf, 2.0, 3.0]
    found = spread(values, seed=3)
    assert list(found.quantiles.values()) == [1, 2, 3, 4, math.inf]
    assert found == spread(values, seed=3)
    assert found.low <= found.median <= found.high == math.inf
    assert spread([1.0, 4.0], seed=0).median == 2  # for an even number, that of the logarithms
    assert spread([0.0, 1.0, math.inf, 4.0], seed=0).median == 2
    assert spread([0.0, math.inf], seed=0).median == math.inf
    narrow = spread([1 + k / 1000 for k in range(1000)], seed=0)
    # the median of 1000 uniform numbers has the standard deviation 1/(2 sqrt(1000)) = 0.0158
    assert narrow.high - narrow.low == pytest.approx(2 * 1.96 * 0.0158, rel=0.15)


@pytest.mark.parametrize(
    ("reality", "more", "models"),
    [
        ("{}", 1, [(0, 0, 1), (0, 1, 1.3)]),  # samples, share and gain, without and with the margins
        ("{transport_delay: {samples: 2}}", 1, [(2, 0, 1), (2, 1, 1.3)]),
        ("{transport_delay: {samples: 1, share: 0.25}}", 1, [(1, 0.25, 1), (2, 0.25, 1.3)]),
        ("{transport_delay: {samples: 1, late: 0.1}}", 1, [(1, None, 1), (2, None, 1.3)]),
        ("{}", 2, [(0, 0, 1), (1, 1, 1.3)]),
        ("ur", 0, [(1, 0, 1), (1, 0, 1.3)]),
        ("{command_gain: {gain: 2}}", 1, [(0, 0, 2), (0, 1, 2.6)]),  # the margin multiplies the reality's own
    ],
)
def test_the_margins_add_a_delay_and_a_gain_to_a_reality(race: Make, reality: str, more: int, models: object) -> None:
    found = race(("{ideal: {}}", f"{{ideal: {reality}}}"), ("budget: 4", f"margins: {{delay: {more}}}"))
    several = list[tuple[object, ...]]()
    for run in list(found.trials("tuned", 0.02, found.candidates("tuned", 0.02)[0])):
        blocks = found.graph(run).blocks
        several.append(
            (blocks["transport_delay"].samples, blocks["transport_delay"].share, blocks["command_gain"].gain)
        )
    assert several == models


def test_the_delay_of_a_plant_is_added_and_the_law_is_given_the_nearest_whole_one(race: Make, tmp_path: Path) -> None:
    late = ("first:  {servo:", "first:  {transport_delay: 1.6, servo:")
    found = race(late, ("realities: {ideal: {}}", "realities: {ideal: {transport_delay: {samples: 1, share: 0.25}}}"))
    runs = list(found.trials("tuned", 0.02, found.candidates("tuned", 0.02)[0]))
    delays = [found.graph(run).blocks["transport_delay"] for run in runs]
    assert [delay.samples for delay in delays] == [2, 3]
    assert [delay.share for delay in delays] == pytest.approx([0.85, 0.85])
    (tmp_path / "law.yaml").write_text((tmp_path / "law.yaml").read_text().replace("command}", "command, delay: 0}"))
    knows = found.file.laws["tuned"].model_copy(update={"delay": ("inverse.delay",)})
    law = replace(found.laws["tuned", 0.02], section=knows)
    found = replace(found, laws={**found.laws, ("tuned", 0.02): law})
    document = found.document_of(runs[0])
    assert document.data["blocks"]["inverse"]["delay"] == 1 + 2
    assert "transport_delay" not in document.data["blocks"]


def test_a_law_is_given_the_rate_at_which_the_path_repeats_and_keeps_its_own_on_others(
    race: Make, tmp_path: Path
) -> None:
    race()
    law = (tmp_path / "law.yaml").read_text().replace("kinematic_command", "repetitive_inverse, rate: 7")
    task = "sampled_tracking, Lambda: 4"
    (tmp_path / "learner.yaml").write_text(
        law.replace("known_tracking, gamma: 4", task).replace("  geometry: {type: kinematics}\n", "")
    )
    learner = "  learner: {graph: learner.yaml, tune: {task.Lambda: [1, 4]}, rate: inverse.rate}\n  weak:"
    found = race(("phase: [0]}", "phase: [0], repeats: 2}"), ("  weak:", learner))
    run = next(found.trials("learner", 0.02, found.candidates("learner", 0.02)[0]))
    assert found.graph(run).blocks["inverse"].rate == 2
    other = replace(run, cell=found.held_out[0])
    assert found.graph(other).blocks["inverse"].rate == 7
    assert "repeats" not in found.document_of(run).data["blocks"]["path"]


def test_a_law_is_given_the_seed_of_the_run(race: Make, tmp_path: Path) -> None:
    race()
    law = (tmp_path / "law.yaml").read_text().replace("kinematic_command", "velocity_probe")
    (tmp_path / "probing.yaml").write_text(law)
    probing = "  probing: {graph: probing.yaml, tune: {task.gamma: [1, 4]}, seed: inverse.seed}\n  weak:"
    found = race(("  weak:", probing))
    run = next(found.trials("probing", 0.02, found.candidates("probing", 0.02)[0]))
    given = [found.document_of(replace(run, seed=seed)).data["blocks"]["inverse"]["seed"] for seed in (0, 1, 2**64 - 1)]
    assert given == [1, 2, 551616]


def test_a_law_may_have_a_graph_for_each_range_of_sampling_periods(race: Make, tmp_path: Path) -> None:
    race()
    (tmp_path / "slow.yaml").write_text((tmp_path / "law.yaml").read_text().replace("gamma: 4", "gamma: 3"))
    found = race(
        ("clocks: [20 ms]", "clocks: [20 ms, 50 ms, 90 ms]"),
        ("weak:  {graph: law.yaml", "weak:  {graph: {30 ms: law.yaml, 60 ms: slow.yaml}"),
    )
    assert [found.candidates("weak", clock)[0][0][1] for clock in found.file.clocks] == [4, 3, 3]
    assert [found.candidates("tuned", clock)[0][0][1] for clock in found.file.clocks] == [4, 4, 4]


def test_the_packaged_race_has_what_its_page_states_and_its_quick_part_24_cells() -> None:
    found = load_race("packaged")
    paths = found.file.paths
    assert len(paths) >= 10
    assert (
        sum(len({rate for rate in path.parameters["rate"] if rate}) > 2 for path in paths.values()) >= 3
    )  # never repeat
    assert sum(path.parameters.get("stop", 0) == 1 for path in paths.values()) >= 2
    assert any(any(plant.blocks["arm"]["payload"]) for plant in found.file.plants.values())
    for part in (found, found.quick):
        assert not {cell.plant for cell in part.training} & {cell.plant for cell in part.held_out}
        assert not {cell.path for cell in part.training} & {cell.path for cell in part.held_out}
        assert len({len(part.candidates(law, clock)) for law in part.file.laws for clock in part.file.clocks}) == 1
    assert len(found.quick.held_out) == 24
    clocks = set(found.quick.file.clocks)
    assert clocks < set(found.file.clocks)
    assert list(found.quick.training) == [cell for cell in found.training if cell.clock in clocks]
    assert found.delays == {"ideal": 0, "ur": 1}
