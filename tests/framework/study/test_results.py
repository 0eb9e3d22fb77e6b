"""A study's folder: its table, its worst runs, its page; for hand-written tables, and for one that ran."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from functools import cache, partial
from importlib import import_module
from pathlib import Path
from shlex import quote
from typing import Any

import numpy as np
import pytest
import scipy

import dmframe as dm
from dmframe.common.errors import DmframeError, MissingError, UnknownNameError, ValueFault
from dmframe.report.parts import Lead
from dmframe.study import results as results_module
from dmframe.study.answer import WORTH, ReportData, lead, summary
from dmframe.study.figures import figures_of, plain_marks
from dmframe.study.findings import event_of, findings_of
from dmframe.study.numbers import between, percent
from dmframe.study.plan import Study
from dmframe.study.read import load_study
from dmframe.study.report import reported
from dmframe.study.results import Results
from dmframe.study.sheet import names_of
from dmframe.study.statistics import Quantile

pytestmark = pytest.mark.usefixtures("without_v")

TEXT = """\
dmframe-study: 1
title: Which gain is safe
graph: pendulum
set: {duration: 2 s}
sample:
  runs: RUNS
  method: METHOD
  seed: 3
  servo.K_D: {scale: [0.5, 2]}
  servo.K_I: {scale: {log: [0.5, 2]}}
grid: {dynamics.Gamma: [1, 10]}
REPORT
"""
Figures = Callable[[Study, int, Mapping[str, np.ndarray]], dict[str, Any]]


def text_of(runs: int = 200, method: str = "random", report: str = "", grid: str = "") -> str:
    text = TEXT.replace("RUNS", str(runs)).replace("METHOD", method).replace("REPORT", report)
    return re.sub("grid:.*\n", grid, text) if grid else text


def steady(study: Study, point: int, drawn: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """The error is K_D's factor, a tenth of it at the second point; no run diverges."""
    return {"rms_final": drawn["servo.K_D"] * (1.0, 0.1)[point % 2] * 1e-3}


def breaking(study: Study, point: int, drawn: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """The same, but at the second point all runs with a soft servo diverge, the softest first."""
    soft = (drawn["servo.K_D"] < 0.7) & (point == 1)
    figures = steady(study, point, drawn)["rms_final"]
    when = np.where(soft, drawn["servo.K_D"], np.nan)
    return {"rms_final": np.where(soft, np.nan, figures), "diverged": soft, "diverged_at": when}


@pytest.fixture
def folder(tmp_path: Path) -> Callable[..., Path]:
    """Writes a folder with a table by hand."""
    return partial(write, tmp_path)


@pytest.fixture(scope="module")
def page(
    tmp_path_factory: pytest.TempPathFactory, undrawn_page: Callable[[Callable[[], Path]], Path]
) -> Callable[..., tuple[Path, str]]:
    """The same with its report, made once for all tests that only read it, where runs diverge with its figures."""

    @cache
    def made(figures: Figures = steady, text: str = "") -> tuple[Path, str]:
        place = write(tmp_path_factory.mktemp("study"), figures, text)
        made_now = partial(write_report, place, proofs=False)
        drawn = made_now() if figures is breaking else undrawn_page(made_now)
        return place, words(drawn)

    return made


def write_report(*where: Any, **options: Any) -> Path:
    return reported(*where, **options).page


def write(parent: Path, figures: Figures = steady, text: str = "", chunk: int = 64, drop: int = 0) -> Path:
    """A hand-written table, in chunks of several files, unordered."""
    import polars as pl

    place = parent / "which_gain"
    (place / "runs").mkdir(parents=True)
    (place / "study.yaml").write_text(text or text_of(), encoding="utf-8")
    study = load_study(place / "study.yaml")
    for point in study.points:
        for first in range(0, study.samples - drop, chunk):
            stop = min(first + chunk, study.samples - drop)
            samples, drawn = np.arange(first, stop), study.drawn(first, stop)
            rows: dict[str, Any] = {
                "run": samples * len(study.points) + point.index,
                "point": np.full(len(samples), point.index, dtype=np.int32),
                "sample": samples,
                **{key: [value] * len(samples) for key, value in point.values.items()},
                **drawn,
                "diverged": np.zeros(len(samples), dtype=bool),
                "diverged_at": np.full(len(samples), np.nan),
                **{f"rms_{k}": np.linspace(1, 2, len(samples)) / k for k in range(1, 9)},
                "error_most": np.full(len(samples), 0.1),
                "fault": [None] * len(samples),
            }
            rows |= figures(study, point.index, drawn)
            frame = pl.DataFrame(rows, schema_overrides={"fault": pl.String}).sample(fraction=1, shuffle=True, seed=1)
            frame.write_parquet(place / "runs" / f"p{point.index}-{first}.parquet")
    return place


def words(page: Path) -> str:
    text = re.sub(r"<(style|svg)\b.*?</\1>", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    return " ".join(re.sub(r"<[^>]+>", " ", text).replace("&#x27;", "'").replace("&gt;", ">").split())


def test_a_table_of_chunks_in_no_order_is_summed_up_point_by_point(folder: Callable[..., Path]) -> None:
    found = Results(folder(breaking))
    draws = found.study.drawn(0, 200)["servo.K_D"]
    lost = int((draws < 0.7).sum())
    rows = found.table.to_dicts()
    assert [row["dynamics.Gamma"] for row in rows] == [1, 10]
    assert [row["diverged"] for row in rows] == [0, lost]
    known = scipy.stats.binomtest(lost, 200).proportion_ci(0.95, method="exact")
    assert (rows[1]["low"], rows[1]["high"]) == pytest.approx((known.low, known.high))
    assert rows[0]["rms_final_median"] == pytest.approx(np.quantile(draws, 0.5, method="inverted_cdf") * 1e-3)
    assert rows[1]["rms_final_q99"] == math.inf  # each quantile counts the runs that diverged


def test_the_dataset_has_the_grids_dimensions_and_units(folder: Callable[..., Path]) -> None:
    data = Results(folder(breaking)).dataset()
    assert dict(data.sizes) == {"dynamics.Gamma": 2, "sample": 200}
    assert data["rms_final"].dims == ("dynamics.Gamma", "sample")
    assert data["servo.K_D"].dims == ("sample",)
    assert data["rms_final"].attrs["units"] == "rad"
    one = data.sel({"dynamics.Gamma": 10, "sample": 17})
    assert bool(one["diverged"]) == (float(one["servo.K_D"]) < 0.7)
    ratio = data["rms_final"].sel({"dynamics.Gamma": 1}) / data["servo.K_D"]
    assert ratio.values == pytest.approx(1e-3)


def test_a_grid_that_is_not_a_product_has_points(folder: Callable[..., Path]) -> None:
    grid = "grid: {case: {slow: {dynamics.Gamma: 1, duration: 1 s}, fast: {dynamics.Gamma: 9}}}\n"
    data = Results(folder(text=text_of(grid=grid))).dataset()
    assert dict(data.sizes) == {"case": 2, "sample": 200}
    assert data["case"].values.tolist() == ["slow", "fast"]


def test_the_worst_runs_are_those_that_diverged_first(folder: Callable[..., Path]) -> None:
    found = Results(folder(breaking))
    draws = found.study.drawn(0, 200)["servo.K_D"]
    soft = sorted(np.flatnonzero(draws < 0.7), key=lambda k: draws[k])
    assert found.worst_runs("rms_final", 3) == [2 * k + 1 for k in soft[:3]]
    assert found.worst_runs("rms_final", 2, points=[0]) == [2 * k for k in np.argsort(-draws)[:2]]
    (graph,) = found.worst("rms_final")
    assert 20 * draws[soft[0]] == graph.blocks["servo"].K_D  # type: ignore[attr-defined]


def test_of_a_least_the_smallest_is_the_worst(folder: Callable[..., Path]) -> None:
    def figures(study: Study, point: int, drawn: Mapping[str, np.ndarray]) -> dict[str, Any]:
        return steady(study, point, drawn) | {"arm.q.least": -drawn["servo.K_D"]}

    found = Results(folder(figures))
    assert found.worst_runs("arm.q.least")[0] // 2 == int(np.argmax(found.study.drawn(0, 200)["servo.K_D"]))


@pytest.mark.usefixtures("undrawn")
def test_a_worst_run_runs_again_exactly_as_it_did(tmp_path: Path) -> None:
    import polars as pl

    text = text_of(runs=8, report="measure: {signals: [arm.q]}\nreport: {worst: {rms_final: 2}}")
    (tmp_path / "study.yaml").write_text(text, encoding="utf-8")
    (tmp_path / "runs").mkdir()
    study = load_study(tmp_path / "study.yaml")
    for point in study.points:
        rows = pl.DataFrame(study.rows(point.index, 0, 8), strict=False)
        rows.write_parquet(tmp_path / f"runs/{point.index}.parquet")
    found = Results(tmp_path)
    write_report(tmp_path, found, proofs=False)
    runs = found.worst_runs("rms_final", 2)
    table = found.frame.collect()
    assert table["rms_final"].max() == table.filter(pl.col("run") == runs[0])["rms_final"][0]
    for place, run in enumerate(runs, start=1):
        row = table.filter(pl.col("run") == run).row(0, named=True)
        again = dm.load(tmp_path / f"worst_{place}.yaml").run(engine="compiled")
        path = again.recording["arm.q"][:, 0]
        assert (path.min(), path.max(), path[-1]) == (row["arm.q.least"], row["arm.q.most"], row["arm.q.last"])
        assert again.error is not None
        # a batch sums in another order
        assert again.error.rms_final == pytest.approx(row["rms_final"], rel=1e-12)


def test_the_page_begins_with_the_answer(page: Callable[..., tuple[Path, str]]) -> None:
    _, printed = page()
    assert "None of 200 robots diverged at 2 of 2 settings" in printed
    most = 100 * (1 - 0.025 ** (1 / 200))  # Bonferroni: half of 5 % for each of two
    assert 1.8 < most < 1.9
    assert (
        "at each of them the probability of divergence is at most 1.9 %, at 95 % confidence for all 2 settings"
        in printed
    )
    assert "Gamma = 10 has the smallest 99 % quantile of rms_final" in printed
    assert "Clopper" in printed


@pytest.mark.usefixtures("undrawn")
def test_of_one_point_the_answer_is_the_one_sided_limit(folder: Callable[..., Path]) -> None:
    printed = words(write_report(folder(text=text_of(runs=299, grid="grid: {dynamics.Gamma: [1]}\n")), proofs=False))
    assert "Of 299 robots none diverged : the probability of divergence is at most 1 %, at 95 % confidence." in printed


def test_the_page_names_its_graph_and_duration(page: Callable[..., tuple[Path, str]]) -> None:
    place, printed = page()
    study = Results(place).study
    (graph,) = {point.graph.name for point in study.points}
    duration = study.points[0].graph.duration
    assert f"Graph {graph}; runs of {duration:g} s." in printed


@pytest.mark.usefixtures("undrawn")
def test_commands_of_a_page_work_where_it_was_written(
    folder: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    place = folder()
    monkeypatch.chdir(place.parent.parent)
    printed = words(write_report(place, proofs=False))
    assert f"dmframe study report {quote(str(place.relative_to(Path.cwd())))} " in printed
    monkeypatch.chdir(Path(__file__).parent)
    assert f"dmframe study report {place.name} " in words(write_report(place, proofs=False))


def test_a_map_of_a_setting_without_divergence_states_this(page: Callable[..., tuple[Path, str]]) -> None:
    place, _ = page(breaking)
    figure = figures_of(findings_of(Results(place)))["map_1"]
    texts = [[text.get_text() for text in axes.texts] for axes in figure.axes if axes.get_title()]
    assert texts == [[], ["none diverged"], [], []]


def test_the_page_names_what_diverged_and_what_decides_it(page: Callable[..., tuple[Path, str]]) -> None:
    place, printed = page(breaking)
    assert "None of 200 robots diverged at 1 of 2 settings" in printed
    assert "Largest influence on whether a run diverges at Gamma = 10 : servo.K_D" in printed
    worst = Results(place).worst_runs()[0]
    assert f"The worst run is number {worst} at Gamma = 10 : diverged after" in printed
    found = Results(place)
    saved = [dm.load(place / f"worst_{k}.yaml") for k in (1, 2, 3, 4)]
    assert [each.blocks["dynamics"].Gamma for each in saved] == [10, 10, 10, 1]  # type: ignore[attr-defined]
    (own,) = found.worst_runs("rms_final", 1, points=[0])  # the worst run at the recommended setting
    assert saved[3].blocks == found.study.graph_of(own).blocks
    assert not (place / "worst_5.yaml").exists()
    names = {path.name for path in (place / "figures").iterdir()}
    assert names == {f"{name}.svg" for name in ("divergence", "distribution", "eighths", "influence", "map_1")}


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("method", ["sobol", "latin_hypercube"])
def test_no_interval_is_printed_where_none_is_valid(folder: Callable[..., Path], method: str) -> None:
    place = folder(breaking, text_of(runs=64, method=method))
    printed = words(write_report(place, proofs=False))
    assert "No interval of probability is given" in printed
    for never in ("95 % interval", "at most", "confidence", "by chance", "sign test", "Clopper"):
        assert never not in printed.replace("over at most 16 bins", "").replace(
            "Fraction of the runs with at most", ""
        ).replace("what so many bins explain by chance", "")
    assert Results(place).table["low"].null_count() == 2


@pytest.mark.usefixtures("undrawn")
def test_a_page_of_single_runs_states_no_probability(folder: Callable[..., Path]) -> None:
    text = re.sub(r"sample:\n(?:  .*\n)+", "", text_of())
    place = folder(lambda *_: {"rms_final": [1e-3]}, text)
    printed = words(write_report(place, proofs=False))
    assert "2 settings ran, each once; none of them diverged" in printed
    assert "which gives no probability" in printed
    assert "confidence" not in printed


@pytest.mark.usefixtures("undrawn")
def test_missing_and_failed_runs_are_reported(folder: Callable[..., Path]) -> None:
    def figures(study: Study, point: int, drawn: Mapping[str, np.ndarray]) -> dict[str, Any]:
        values = steady(study, point, drawn)["rms_final"]
        bad = np.arange(len(values)) == 0
        return {"rms_final": np.where(bad, np.nan, values), "fault": ["no pose" if each else None for each in bad]}

    place = folder(figures, drop=40, chunk=200)
    found = findings_of(Results(place))
    assert [(each.runs, each.failed, each.missing) for each in found.points] == [(159, 1, 40)] * 2
    printed = words(write_report(place, proofs=False))
    assert "80 runs are missing" in printed
    assert "2 runs could not be prepared" in printed
    assert lead_of(place).outcome == "open"


def test_few_runs_have_no_influences(folder: Callable[..., Path]) -> None:
    found = findings_of(Results(folder(steady, text_of(runs=15))))
    assert all(not each.influences for each in found.points)


@pytest.mark.parametrize("method", ["random", "sobol"])
def test_what_decides_is_named_only_where_chance_does_not_explain_it(tmp_path: Path, method: str) -> None:
    named = 0
    for seed in range(10):

        def figures(study: Study, point: int, drawn: Mapping[str, np.ndarray], seed: int = seed) -> dict[str, Any]:
            return {"rms_final": np.random.default_rng(seed).uniform(1, 2, len(drawn["servo.K_D"]))}

        (tmp_path / str(seed)).mkdir()
        results = Results(write(tmp_path / str(seed), figures, text_of(runs=20, method=method, grid="\n")))
        data = ReportData(findings_of(results), (), (), True, (), ())
        shares = [item.explained for item in data.found.points[0].influences["rms_final"]]
        printed = "Largest influence" in repr(list(summary(data)))
        named += printed
        assert not printed or max(shares) >= WORTH
    assert named <= 2  # of ten, each of which may be wrong in one of twenty cases


def test_the_answer_counts_settings_that_could_not_be_prepared(folder: Callable[..., Path]) -> None:
    def figures(study: Study, point: int, drawn: Mapping[str, np.ndarray]) -> dict[str, Any]:
        return steady(study, point, drawn) | ({"fault": ["no pose"] * len(drawn["servo.K_D"])} if point else {})

    found = lead_of(folder(figures))
    assert found.outcome == "open"
    assert found.headline == "None of 200 robots diverged at 1 of 2 settings"
    assert "for all 2 settings together. 200 runs could not be prepared" in str(found.sentence)


@pytest.mark.parametrize(("jitter", "noisy"), [("", False), (", jitter: 0.1 ms", True)])
def test_the_answer_warns_of_a_single_noise_realisation(folder: Callable[..., Path], jitter: str, noisy: bool) -> None:
    place = folder(steady, text_of().replace("2 s}", "2 s, clock: 2 ms" + jitter + "}"))
    assert ("other noise is not covered" in str(lead_of(place).sentence)) == noisy


def lead_of(place: Path) -> Lead:
    return lead(ReportData(findings_of(Results(place)), (), (), True, (), ()))


def test_events_are_figures_with_limits_in_any_unit(folder: Callable[..., Path]) -> None:
    place = folder(breaking, text_of(report="report: {probability: [diverged, rms_final > 1 mrad]}"))
    found = findings_of(Results(place))
    draws = found.results.study.drawn(0, 200)["servo.K_D"]
    first, second = (each.alone[1].count for each in found.points)
    assert (first, second) == (int((draws > 1).sum()), int((draws < 0.7).sum()))
    assert found.events[1].name == "rms_final > 1 mrad"


def test_a_time_of_a_run_that_diverged_is_its_own_and_one_that_never_came_is_infinite(
    folder: Callable[..., Path],
) -> None:
    events = "diverged_at < 0.6 s, diverged_at > 0.6 s"
    found = findings_of(Results(folder(breaking, text_of(report=f"report: {{probability: [{events}]}}"))))
    early = int((found.results.study.drawn(0, 200)["servo.K_D"] < 0.6).sum())
    assert 0 < early < found.points[1].alone[0].count
    assert [each.count for each in found.points[1].alone[1:]] == [early, 200 - early]
    assert [each.count for each in found.points[0].alone[1:]] == [0, 200]


def test_a_run_without_the_figure_is_no_case_of_its_event(folder: Callable[..., Path]) -> None:
    def lacking(study: Study, point: int, drawn: Mapping[str, np.ndarray]) -> dict[str, Any]:
        return {"rms_final": np.where(drawn["servo.K_D"] < 1, np.nan, 1.0)}

    place = folder(lacking, text_of(report="report: {probability: [rms_final > 1 mrad]}"))
    found = findings_of(Results(place))
    there = int((found.results.study.drawn(0, 200)["servo.K_D"] >= 1).sum())
    assert [(each.alone[1].count, each.alone[1].runs) for each in found.points] == [(there, there)] * 2


def test_a_varied_quantity_is_not_an_event(folder: Callable[..., Path]) -> None:
    with pytest.raises(DmframeError, match="unknown figure"):
        findings_of(Results(folder(steady, text_of(report="report: {probability: [servo.K_D > 1]}"))))


@pytest.mark.parametrize(
    ("text", "printed"),
    [
        ("rms_finl > 1 mm", "unknown figure; did you mean rms_final?"),
        ("rms_final > 1 s", "expected a quantity in rad, found '1 s'"),
        ("often", "expected diverged, or a figure and a limit such as 'error_most > 5 mm'"),
    ],
)
def test_an_event_that_means_nothing_is_refused(text: str, printed: str) -> None:
    with pytest.raises(DmframeError, match=re.escape(printed)):
        event_of(text, {"rms_final": "rad"})


def test_all_figures_and_quantities_that_the_table_lacks_are_reported_at_once(folder: Callable[..., Path]) -> None:
    report = "report: {probability: [rms_finl > 1], map: [servo.K_D, servo.K_P]}"
    with pytest.raises(DmframeError) as caught:
        write_report(folder(text=text_of(report=report)), proofs=False)
    assert len(caught.value.faults) == 2
    assert "servo.K_P" in str(caught.value)


def test_comparisons_are_on_the_same_samples(folder: Callable[..., Path]) -> None:
    (found,) = findings_of(Results(folder(breaking))).comparisons
    assert found.figure.runs == 200
    assert found.figure.better + found.figure.worse == 200
    assert found.figure.worse == found.only_here > 0
    assert found.only_there == 0
    assert found.figure.ratio == pytest.approx(0.1)


def test_a_run_that_is_listed_twice_is_noticed(folder: Callable[..., Path]) -> None:
    place = folder()
    first = sorted((place / "runs").iterdir())[0]
    (place / "runs" / "again.parquet").write_bytes(first.read_bytes())
    with pytest.raises(ValueFault, match="is 2 times"):
        Results(place).table  # noqa: B018


def test_a_table_of_another_study_is_noticed(folder: Callable[..., Path]) -> None:
    place = folder()
    place.joinpath("study.yaml").write_text(text_of(runs=100), encoding="utf-8")
    with pytest.raises(ValueFault, match="belongs to another study"):
        Results(place).table  # noqa: B018


def test_missing_folders_figures_and_packages_are_errors_with_a_remedy(
    folder: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(MissingError, match="run it first: dmframe study"):
        Results(tmp_path / "nothing")
    place = folder()
    with pytest.raises(UnknownNameError, match="did you mean rms_final"):
        Results(place).worst("rms_finl")
    with pytest.raises(ValueFault, match="how many runs"):
        Results(place).worst("rms_final", 0)
    monkeypatch.setitem(__import__("sys").modules, "polars", None)
    with pytest.raises(MissingError, match=re.escape('[study]"')):
        results_module.polars()


def test_an_older_reports_worst_runs_and_figures_go(page: Callable[..., tuple[Path, str]]) -> None:
    place, _ = page(breaking)
    place.joinpath("figures", "old.png").write_bytes(b"")
    place.joinpath("worst_9.yaml").write_text("", encoding="utf-8")
    first = place.joinpath("report.html").read_bytes()
    write_report(place, proofs=False)
    assert not place.joinpath("figures", "old.png").exists()
    assert not place.joinpath("worst_9.yaml").exists()
    assert place.joinpath("report.html").read_bytes() == first  # the same runs give the same page


def test_a_page_fetches_nothing_and_is_well_formed(page: Callable[..., tuple[Path, str]]) -> None:
    import xml.etree.ElementTree as ET

    text = page(breaking)[0].joinpath("report.html").read_text(encoding="utf-8")
    ET.fromstring(text.removeprefix("<!DOCTYPE html>\n"))
    assert not re.search(r"(src|href)=\"(?!#|data:image/png)", text)
    assert "url(" not in text.replace("url(#", "")


def test_limits_are_never_rounded_to_the_side_that_makes_them_untrue() -> None:
    assert percent(0.0002995, up=True) == "0.03 %"
    assert percent(0.0003005, up=True) == "0.031 %"
    assert percent(0.0003095, up=False) == "0.03 %"
    assert percent(0.999543, up=False) == "99.954 %"
    assert percent(0.999543, up=True) == "99.955 %"
    assert (percent(0), percent(1), percent(math.nan)) == ("0 %", "100 %", "-")
    rng = np.random.default_rng(0)
    for share in [*rng.uniform(size=200), *(1 - rng.uniform(size=100) ** 8)]:
        low, high = (float(percent(share, up=up)[:-2]) / 100 for up in (False, True))
        assert low <= share + 1e-12
        assert share <= high + 1e-12
        assert high - low < 0.011


def test_an_interval_states_where_it_has_no_end() -> None:
    assert between(Quantile(0.99, 1e-3, 5e-4, math.inf), "m") == "500 µm to no upper limit"
    assert between(Quantile(0.5, math.inf, 1e-3, math.inf), "m") == "1 mm to diverged"
    assert between(Quantile(0.5, math.inf, math.inf, math.inf), "m") == ""


def test_settings_are_called_by_what_differs_among_them() -> None:
    values = [{"a.K": 1.0, "b.K": 2.0, "clock": t, "same": 1, "servo": s} for t in (0.008, 0.09) for s in (0.1, 3.0)]
    assert names_of(values, {"clock": "s"}, ["servo"]) == [
        f"clock = {t}, servo x {s}" for t in ("8 ms", "90 ms") for s in ("0.1", "3")
    ]
    assert names_of([{"a.K": 1.0, "b.K": 2.0}, {"a.K": 2.0, "b.K": 1.0}], {}) == [
        "a.K = 1, b.K = 2",
        "a.K = 2, b.K = 1",
    ]


@pytest.mark.parametrize(
    ("low", "high", "marks"),
    [
        (0.5, 2, [0.5, 0.6, 0.8, 1, 2]),
        (0.01, 0.8, [0.01, 0.02, 0.05, 0.1, 0.2, 0.5]),
        (1e-3, 1e3, [1e-3, 1e-2, 0.1, 1, 10, 100, 1e3]),
        (1.1, 1.9, [1.1, 1.9]),
    ],
)
def test_a_logarithmic_axis_has_plain_numbers(low: float, high: float, marks: list[float]) -> None:
    assert plain_marks(low, high) == marks


@pytest.mark.parametrize(
    "harm",
    [
        lambda file: file.write_bytes(file.read_bytes()[:300]),
        lambda file: import_module("polars").DataFrame({"a": [1.0]}).write_parquet(file),
        lambda file: file.write_bytes(b""),
    ],
)
def test_a_file_that_holds_no_runs_is_named(folder: Callable[..., Path], harm: Callable[[Path], None]) -> None:
    place = folder()
    assert Results(place).table.shape[0] == 2
    harm(next(place.glob("runs/*.parquet")))
    with pytest.raises(ValueFault, match=r"parquet: expected runs of a study, found something else"):
        _ = Results(place).table


def test_a_lock_that_is_a_list_does_not_name_the_study(folder: Callable[..., Path]) -> None:
    place = folder()
    (place / "study.lock.json").write_text("[]")
    assert Results(place).name == place.name
