"""Tuning: candidates, refusals, stops and results; a search that was stopped continues without a difference."""

from __future__ import annotations

import contextlib
import itertools
import json
import math
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dmframe.analysis.linear import linearise
from dmframe.analysis.period import linearised_period
from dmframe.cli.tune import tune_study
from dmframe.common.errors import DmframeError, OutputError
from dmframe.graph.load import load
from dmframe.report.verification import Verification
from dmframe.study import candidate as candidates
from dmframe.study import tune as tuning_module
from dmframe.study.cautions import near_end
from dmframe.study.design import Spread
from dmframe.study.objective import Statistic
from dmframe.study.plan import Study
from dmframe.study.read import load_study
from dmframe.study.trials import JOURNAL, Trial, dominates, front_of
from dmframe.study.tune import Tuning, load_tuning
from dmframe.study.tune_figures import figures_of
from dmframe.study.tune_page import as_html
from dmframe.study.tuned import Tuned, tuned_of

pytest.importorskip("optuna")

Make = Callable[..., Study]

PLANTS = """\
set: {duration: 0.4 s}
sample:
  runs: 8
  seed: 2
  servo: {scale: [0.5, 2], of: [servo.K_P, servo.K_I]}
"""
GAINS = """\
tune:
  dynamics.Gamma: {log: [0.1, 100]}
  task.gamma: {uniform: [0.2, 2]}
  minimise: worst rms_final
"""


def tuning(study: Make, text: str, **options: Any) -> Tuning:
    return load_tuning(study(text, **options), threads=1)


def history(found: Tuning, folder: Path) -> list[tuple[Any, ...]]:
    return [(each.number, dict(each.values), each.figures, each.state) for each in found.trials(folder)]


def written(path: Path, found: Sequence[Verification]) -> None:
    """Instead of a certificate with its figures and periods, which the page docs/how_to/tuning.md writes."""
    path.write_text(" ".join(each.headline for each in found), encoding="utf-8")


@pytest.mark.parametrize("share", [1.0, 0.5, 0.95, 0.1, None])
def test_a_statistic_of_some_runs_is_never_more_than_that_of_all(share: float | None) -> None:
    rng = np.random.default_rng(0)
    statistic = Statistic("", share, "rms_final", ("rms_final",), "m")
    for size in (1, 2, 7, 40):
        for _ in range(30):
            values = rng.exponential(size=size)
            whole = statistic.of(values)
            expected = values.mean() if share is None else np.quantile(values, share, method="inverted_cdf")
            assert whole == pytest.approx(expected)
            for count in range(1, size + 1):
                assert statistic.at_least(rng.permutation(values)[:count], size) <= whole * (1 + 1e-12)


def test_a_figure_of_a_signal_with_several_rows_is_their_norm_or_their_largest() -> None:
    rows = {
        "u[0].rms_final": [3.0, 0.0],
        "u[1].rms_final": [4.0, 1.0],
        "u[0].least": [-9.0, 0.0],
        "u[0].most": [2.0, 5.0],
    }
    rows |= {"diverged": [False, True], "fault": [None, None]}
    norm = Statistic("", 1.0, "u.rms_final", ("u[0].rms_final", "u[1].rms_final"), "V")
    assert norm.figures(rows).tolist() == [5.0, math.inf]
    assert Statistic("", 1.0, "u.peak", ("u[0].least", "u[0].most"), "V").figures(rows).tolist() == [9.0, math.inf]
    assert Statistic("", None, "diverged", ("diverged",), "").of(np.array([0.0, 1.0])) == 0.5


def test_the_figures_of_a_trial_are_those_of_its_graphs_run_one_by_one(study: Make, tmp_path: Path) -> None:
    found = tuning(study, PLANTS.replace("runs: 8", "runs: 4") + GAINS)
    assert found.search(tmp_path / "out", 3) == 3
    trials = found.trials(tmp_path / "out")
    assert dict(trials[0].values) == {"dynamics.Gamma": 1.0, "task.gamma": 0.8}, "the graph's own values come first"
    for trial in trials:
        assert trial.state in ("ran", "stopped")
        if trial.state == "ran":
            graphs = [found.candidate(trial.values).graph_of(run) for run in range(4)]
            errors = [graph.run(engine="compiled").error for graph in graphs]
            assert trial.figures[0] == pytest.approx(max(error.rms_final for error in errors if error), rel=1e-9)


def test_a_continued_search_equals_an_uninterrupted_one(study: Make, tmp_path: Path) -> None:
    found = tuning(study, PLANTS + GAINS)
    found.search(tmp_path / "whole", 11)
    found.search(tmp_path / "parts", 4)
    again = tuning(study, PLANTS + GAINS)
    assert again.search(tmp_path / "parts", 11) == 11
    assert history(found, tmp_path / "whole") == history(again, tmp_path / "parts")
    other = tuning(study, PLANTS + GAINS + "  seed: 1\n")
    other.search(tmp_path / "other", 2)
    assert history(other, tmp_path / "other") != history(found, tmp_path / "whole")[:2]


def test_a_trial_that_was_stopped_early_is_not_on_the_front(study: Make, tmp_path: Path) -> None:
    gains = GAINS.replace("minimise: worst rms_final", "minimise: [worst rms_final, worst error_most]")
    early, whole = tuning(study, PLANTS + gains), tuning(study, PLANTS + gains + "  screen: null\n")
    for found, name in ((early, "early"), (whole, "whole")):
        found.search(tmp_path / name, 10)  # the first ten are drawn at random, independent of the others
    stopped = [each for each in early.trials(tmp_path / "early") if each.state == "stopped"]
    ran = {each.number: each for each in whole.trials(tmp_path / "whole")}
    assert stopped, "no trial was stopped, so that this test checks nothing"
    for each in stopped:
        assert all(a <= b * (1 + 1e-12) for a, b in zip(each.figures, ran[each.number].figures, strict=True))
    assert [each.number for each in front_of(early.trials(tmp_path / "early"))] == [
        each.number for each in front_of(list(ran.values()))
    ]


def test_values_whose_conditions_fail_are_refused_before_any_run(
    study: Make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = "tune: {arm.maker_viscous: {uniform: [0, 60]}, minimise: worst rms_final, subject_to: conditions}\n"
    found, ran = tuning(study, PLANTS + text), list[float]()
    rows = tuning_module.rows_of_runs

    def counted(candidate: Study, *rest: Any) -> Any:
        ran.append(candidate.bases[""].blocks["arm"].maker_viscous)  # type: ignore[attr-defined]
        return rows(candidate, *rest)

    monkeypatch.setattr(tuning_module, "rows_of_runs", counted)
    found.search(tmp_path, 6)
    trials = found.trials(tmp_path)
    most = 30.5  # largest compensation with dV/dt <= 0: K_P + B of the second joint
    assert {each.state == "refused" for each in trials} == {True, False}
    for each in trials:
        assert (each.state == "refused") == (each.values["arm.maker_viscous"] >= most), each
        assert each.state != "refused" or "does not hold" in each.why
    assert max(ran) < most


@pytest.mark.parametrize(("value", "here", "everywhere"), [(15.4, 1, 1), (15.6, 1, 0), (30.4, 1, 0), (30.6, 0, 0)])
def test_conditions_everywhere_are_those_over_all_that_is_sampled(
    study: Make, value: float, here: int, everywhere: int
) -> None:
    found = tuning(study, PLANTS + "tune: {arm.maker_viscous: {uniform: [0, 60]}, minimise: worst rms_final}\n")
    candidate = found.candidate({"arm.maker_viscous": value})
    assert (not found.proofs.failing(candidate, 0, everywhere=False)) == bool(here)
    assert (not found.proofs.failing(candidate, 0, everywhere=True)) == bool(everywhere)  # half of K_P, and B


def test_a_constraint_separates_the_trials_as_their_graphs_do(study: Make, tmp_path: Path) -> None:
    few = PLANTS.replace("runs: 8", "runs: 2")
    limited = tuning(study, few + GAINS + "  subject_to: worst rms_final <= 0.93 mm\n")
    limited.search(tmp_path, 4)
    trials = limited.trials(tmp_path)
    for trial in trials:
        graphs = [limited.candidate(trial.values).graph_of(run) for run in range(2)]
        errors = [graph.run(engine="compiled").error for graph in graphs]
        worst = max(error.rms_final or math.inf for error in errors if error)
        assert (trial.state == "broken") == (worst > 0.93e-3), (trial, worst)
    assert len({each.state == "broken" for each in trials}) == 2


def test_a_clock_is_refused_from_the_largest_stable_period_on() -> None:
    graph = load("pendulum")
    largest = linearised_period(linearise(graph.diagram, start=graph.start)).stable
    plants = load_study({"dmframe-study": 1, "graph": "pendulum", "set": {"duration": "1 s"}})
    below, above = (candidates.unstable(plants, 0, share * largest) for share in (0.97, 1.03))
    assert below is not None
    assert above is not None
    assert below <= 0 < above


def test_after_ctrl_c_the_same_call_goes_on(study: Make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found, calls = tuning(study, PLANTS + GAINS), itertools.count()
    rows = tuning_module.rows_of_runs

    def stopped(*given: Any) -> Any:
        if next(calls) == 3:
            raise KeyboardInterrupt
        return rows(*given)

    monkeypatch.setattr(tuning_module, "rows_of_runs", stopped)
    with pytest.raises(KeyboardInterrupt):
        found.search(tmp_path, 5)
    assert found.search(tmp_path, 5) == 5
    states = [each.state for each in found.trials(tmp_path)]
    assert states.count("interrupted") == 1
    assert len(states) == 6


def test_another_search_in_the_folder_is_refused_with_the_difference(study: Make, tmp_path: Path) -> None:
    tuning(study, PLANTS + GAINS).search(tmp_path, 1)
    for text, word in (
        (PLANTS + GAINS.replace("100]", "200]"), "tune"),
        (PLANTS.replace("runs: 8", "runs: 9") + GAINS, "runs"),
        (PLANTS.replace("0.4 s", "0.5 s") + GAINS, "graphs"),
    ):
        with pytest.raises(OutputError, match=f"differs in: {word}"):
            tuning(study, text).search(tmp_path, 1)
    assert tuning(study, PLANTS + GAINS + "  trials: 7\n").search(tmp_path, 2) == 2


@pytest.mark.usefixtures("undrawn")
def test_the_command_checks_proves_and_writes_what_it_found(
    study: Make, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("dmframe.report.write.write_report", written)
    study(PLANTS + GAINS)
    out = tmp_path / "out"
    status = tune_study(str(tmp_path / "study.yaml"), out=out, trials=4, overrides=(), jobs=1, as_json=True)
    summary = json.loads(capsys.readouterr().out)
    assert {path.name for path in out.iterdir()} >= {"report.html", "certificate.html", "tuned.yaml", JOURNAL}
    trials = tuning(study, PLANTS + GAINS).trials(out)
    own, best = summary["found"]
    name = "worst rms_final"
    assert best["searched"][name] == min(each.figures[0] for each in trials if each.state == "ran")
    assert best["fresh"][name] != best["searched"][name]
    assert own["searched"][name] >= best["searched"][name]
    assert best["proof"].startswith("proved")
    assert (out / "certificate.html").read_text(encoding="utf-8") == best["proof"]
    assert status == (1 if best["longer"][name] > own["longer"][name] else 0)
    graph = load(out / "tuned.yaml")
    assert graph.blocks["dynamics"].Gamma == best["values"]["dynamics.Gamma"]  # type: ignore[attr-defined]
    assert f"{best['values']['dynamics.Gamma']:g}" in (out / "report.html").read_text(encoding="utf-8")


@pytest.mark.usefixtures("undrawn")
def test_a_constraint_that_fresh_plants_violate_is_reported(
    study: Make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("dmframe.report.write.write_report", written)
    limit = "  subject_to: worst servo.u.peak <= 1 kV\n"
    found = tuning(study, PLANTS.replace("runs: 8", "runs: 2") + GAINS + limit + "  fresh: 20\n")
    found.search(tmp_path, 1)
    kept = tuned_of(found, tmp_path)
    assert kept.best.broken == ()
    _, rows = found.figures_of(found.candidate(kept.best.values))
    peak = found.bounds[0].statistic.of(found.bounds[0].statistic.figures(rows))
    # the search's own plants satisfy it
    result = tuned_of(replace(found, bounds=(replace(found.bounds[0], limit=peak),)), tmp_path)
    assert any(text.startswith("on fresh plants worst servo.u.peak <=") for text in result.best.broken)
    assert any("does not hold: it is" in notice for notice in result.notices)
    assert "do not use" in result.save().read_text(encoding="utf-8")


@pytest.mark.parametrize(("jitter", "alike"), [("0.5 ms", False), ("0 ms", True)])
def test_what_was_tuned_with_noise_is_checked_with_other_noise(
    study: Make, tmp_path: Path, jitter: str, alike: bool
) -> None:
    text = PLANTS.replace("0.4 s", f"0.1 s, jitter: {jitter}").replace("[0.5, 2]", "[1, 1.0000000001]")
    found = tuning(study, text + GAINS)
    found.search(tmp_path, 1)
    result = tuned_of(found, tmp_path)
    assert result.quiet == alike
    apart = abs(result.best.fresh[0] / result.best.searched[0] - 1)
    assert (apart < 1e-8) == alike


@pytest.mark.parametrize(
    ("spread", "value", "end"),
    [
        (Spread("log", 0.1, 10, 0.1, 10), 9.29, 10),
        (Spread("log", 0.1, 10, 0.1, 10), 8, None),
        (Spread("log", 0.1, 10, 0.1, 10), 0.1, 0.1),
        (Spread("uniform", 0, 10, 0, 10), 9.29, None),
        (Spread("uniform", 0, 10, 0, 10), 9.9, 10),
    ],
)
def test_a_best_value_at_a_bound_gives_a_warning(spread: Spread, value: float, end: float | None) -> None:
    assert near_end(value, spread) == end


@pytest.mark.usefixtures("undrawn")
def test_values_that_are_worse_over_longer_runs_give_a_warning(study: Make, tmp_path: Path) -> None:
    found = tuning(study, PLANTS + GAINS.replace("worst rms_final", "[worst rms_final, median effort]"))
    found.search(tmp_path, 3)
    result = tuned_of(found, tmp_path)
    own = result.own
    assert own is not None
    assert set(figures_of(result)) == {"search", "values", "front"}

    def with_longer(first: float, radius: float = 0.9) -> Tuned:
        return replace(result, front=(replace(result.best, longer=(first, 1.0), radius=radius),))

    for first, words in (
        (own.longer[0] * 2, "the runs are too short: over 2 s"),
        (math.inf, "diverge that did not diverge within"),
    ):
        worse = with_longer(first)
        assert worse.misled
        assert any(words in notice for notice in worse.notices)
        assert "do not use" in as_html(worse, {})
    better = with_longer(own.longer[0] / 2)
    assert not better.misled
    assert "do not use" not in as_html(better, {})
    shaky = with_longer(own.longer[0] / 2, radius=1.01)
    assert any("unstable near its set-point" in notice for notice in shaky.notices)
    assert "unstable near its set-point" in as_html(shaky, {})


def test_the_front_is_what_nothing_dominates() -> None:
    rng = np.random.default_rng(1)
    points = rng.uniform(size=(60, 2)).round(1).tolist()
    trials = [Trial(k, {}, tuple(point), "ran", "") for k, point in enumerate(points)]
    front = front_of(trials)
    expected = {tuple(a) for a in points if not any(dominates(b, a) for b in points)}
    assert {each.figures for each in front} == expected
    assert len(front) == len(expected)


GAMMA = "dynamics.Gamma: {log: [1, 10]}"
RMS = "minimise: worst rms_final"


@pytest.mark.parametrize(
    ("section", "expected"),
    [
        (RMS, "tune: expected parameters to search"),
        (GAMMA, "tune.minimise: this key is missing"),
        (
            f"dynamics.Gama: {{log: [1, 10]}}, {RMS}",
            "tune.dynamics.Gama: unknown parameter; did you mean dynamics.Gamma?",
        ),
        (f"dynamics.Gamma: {{normal: [1, 10], clip: [1, 2]}}, {RMS}", "expected two bounds, uniform or log"),
        (f"{GAMMA}, minimise: best rms_final", "tune.minimise: expected worst, median, mean or quantile 0.95"),
        (f"{GAMMA}, minimise: worst rms_fnal", "unknown figure; did you mean rms_final?"),
        (f"{GAMMA}, minimise: quantile 2 rms_final", "expected a quantile between 0 and 1, found 2"),
        (f"{GAMMA}, {RMS}, subject_to: condition", "tune.subject_to: expected conditions"),
        (f"{GAMMA}, {RMS}, subject_to: worst rms_final <= 3 V", "tune.subject_to: expected a quantity in m"),
        (f"servo.K_P: {{scale: [1, 2]}}, {RMS}", "servo.K_P is sampled, too"),
    ],
)
def test_a_wrong_section_is_refused_with_its_place(study: Make, section: str, expected: str) -> None:
    with pytest.raises(DmframeError) as caught:
        tuning(study, PLANTS + f"tune: {{{section}}}\n")
    assert expected in str(caught.value)
    assert "study.yaml:" in str(caught.value)


def test_two_processes_share_one_search(study: Make, arm: Path) -> None:
    study(PLANTS + GAINS)
    code = (
        "import pathlib as p, dmframe.study.tune as t; t.load_tuning('study.yaml', threads=1).search(p.Path('out'), 6)"
    )
    other = subprocess.Popen([sys.executable, "-c", code], cwd=arm.parent, stderr=subprocess.PIPE, text=True)
    found, out = tuning(study, PLANTS + GAINS), arm.parent / "out"
    while other.poll() is None and not (out / JOURNAL).exists():  # until the other, which starts again, has begun
        with contextlib.suppress(subprocess.TimeoutExpired):
            other.wait(0.05)
    found.search(out, 6)
    _, errors = other.communicate(timeout=120)
    assert other.returncode == 0, errors
    trials = found.trials(out)
    assert sorted(each.number for each in trials) == list(range(len(trials)))
    assert 6 <= len(trials) <= 7, "each looks before it tries"
