"""The verdict on a twin: draws, the race of laws, the rule, and refusals."""

from __future__ import annotations

import html
import json
import math
import sys
from collections.abc import Mapping
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from ruamel.yaml import YAML

import dmframe as dm
from dmframe.catalogue import find_race
from dmframe.cli import STOPPED, main
from dmframe.common.errors import DisagreementError, OutputError, ValueFault
from dmframe.common.files import write_text
from dmframe.identification import verdict as verdicts
from dmframe.identification.answer import Verdict
from dmframe.identification.choose import Choice, floor_of
from dmframe.identification.drawn import Plant, reflected, thetas
from dmframe.identification.found import Identified
from dmframe.identification.identify import _above, _doubts, chain_of
from dmframe.identification.log import Log
from dmframe.identification.model import model_of
from dmframe.identification.page import as_html
from dmframe.identification.race_text import clock_of, noise_of, not_applicable, packaged, place_in, race_text, settings
from dmframe.identification.robot_file import urdf_text
from dmframe.identification.solve import Fit
from dmframe.identification.torque import factors
from dmframe.identification.unknowns import Unknowns
from dmframe.identification.verdict import DRAWS, decided, outcome_of
from dmframe.identification.write import adaptive_text, graph_text, robot_text
from dmframe.race.plan import Cell, Race, Run
from dmframe.race.protocol import Choice as Tuned
from dmframe.race.protocol import Row, Tried
from dmframe.race.read import load_race
from tests.framework.identify.plants import START

GAINS = np.array([5.0, 7.0, 9.0]), np.array([4.0, 8.0, 6.0])
CELL = Cell(0.008, "wander", "draw_1", "log")


def known(
    robot: str = "ur10_slow",
    delay: float = 1.0,
    period: float = 0.008,
    spread: float = 1e-3,
    per_torque: float = 0.0,
) -> Identified:
    """A PID servo with known numbers and covariance on a log without a simulation; nothing is fitted."""
    chain = chain_of(robot)
    n, t = chain.n, period * np.arange(2000)
    q = 0.3 * np.sin(np.outer(t, 1 + np.arange(n))) + np.resize(START, n)
    q += np.random.default_rng(1).normal(0, 1e-5, q.shape)
    log = Log(t, q, np.diff(q, axis=0) / period, np.zeros(n))
    unknowns = Unknowns(model_of(chain), log, "pid", by_torque=per_torque > 0)
    theta, at = np.zeros(unknowns.size), unknowns.places
    theta[at["w"]] = -np.log(np.resize([700, 900, 450], n))
    theta[at["k_P"]], theta[at["k_I"]] = (np.log(np.resize(gains, n)) for gains in GAINS)
    theta[at["B"]], theta[at["D"]] = 0.01, 0.012
    if per_torque:
        theta[at["L"]] = per_torque
    theta[at["v_0"]], theta[at["v_s"]], theta[at["delay"]] = math.log(0.005), math.log(0.05), delay
    root = spread * np.random.default_rng(2).normal(size=(unknowns.size, unknowns.size)) / np.sqrt(unknowns.size)
    covariance = root @ root.T
    common = np.zeros(unknowns.size)
    common[at["w"]] = 0.2  # positions do not determine the scale of all torques
    fit = Fit(unknowns, theta, covariance + np.outer(common, common), np.full_like(q, 1e-6), np.ones(n))
    return Identified(Choice({"pid": fit}, floor_of(log) + 1e-6), (), {})


def test_draws_hold_the_scale_that_no_motion_shows_and_have_the_covariance_of_the_rest() -> None:
    found = known()
    drawn, at = thetas(found, 4000), found.fit.unknowns.places
    assert np.ptp(np.mean(drawn[at["w"]], axis=0)) < 1e-6
    assert np.ptp(drawn[at["v_0"]]) < 1e-6
    k_P = drawn[at["k_P"]]
    covariance = found.fit.covariance
    C = np.zeros((3, covariance.shape[0]))  # the fixed ones: mean of log w, v_0 and a narrow delay
    C[0, at["w"]], C[1, at["v_0"]], C[2, at["delay"]] = 1 / 3, 1, 1
    other = np.linalg.inv(np.linalg.inv(covariance + 1e-16 * np.eye(len(covariance))) + 1e14 * C.T @ C)
    assert np.cov(k_P) == pytest.approx(other[at["k_P"], at["k_P"]], rel=0.15, abs=1e-7)
    assert np.array_equal(drawn, thetas(found, 4000))


def test_the_noise_of_the_positions_is_not_above_the_residual() -> None:
    found = known()
    found.fit.residual[:, 1] = 1e-7
    assert noise_of(found) == pytest.approx(1e-7)
    assert noise_of(known()) == pytest.approx(1e-6)


def test_the_plant_of_a_draw_has_its_base_parameters_and_gains() -> None:
    found = known()
    unknowns = found.fit.unknowns
    theta = thetas(found, 1)[:, 0]
    plant, model = Plant.of(unknowns, theta), unknowns.model
    values = np.zeros(model.base.parameters.size)
    values[model.base.parameters.inertial] = plant.bodies.ravel()
    values[model.base.parameters.places("rotor")] = plant.rotors
    beta = unknowns.numbers(theta[:, None], 0.0)[model.places["beta"], 0]
    assert model.grouping @ values == pytest.approx(beta, rel=1e-6, abs=1e-3)  # a rotor inertia is not negative
    assert plant.servo["K_P"] / plant.servo["K_D"] == pytest.approx(np.exp(theta[unknowns.places["k_P"]]))


def test_the_laws_are_those_of_the_packaged_race_with_its_ranges() -> None:
    own = packaged()["laws"]
    other = YAML().load(find_race("packaged").read_text(encoding="utf-8"))["laws"]
    own["experts"]["graph"]["10 ms"], other["best"]["set"] = "ur10_fast_best", {}
    for name, law in own.items():
        its = other["best" if name == "experts" else name]
        assert {key: law[key] for key in law if key != "graph"} == {key: its[key] for key in its if key != "graph"}
        assert name == "experts" or law["graph"] == its["graph"]


def raced(found: Identified, folder: Path, draws: int = DRAWS) -> Race:
    """The race of a verdict, read from its file."""
    place = place_in(found)
    assert place is not None
    (folder / "twin.urdf").write_text(
        urdf_text(found.fit.unknowns.model.chain, Plant.of(found.fit.unknowns, found.fit.theta).bodies)
    )
    (folder / "verdict.yaml").write_text(race_text(found, draws, place))
    return load_race(folder / "verdict.yaml")


def test_the_race_of_a_verdict_has_the_identified_delay_and_its_paths_are_within_the_log(tmp_path: Path) -> None:
    found = known(delay=0.75)
    race, log = raced(found, tmp_path), found.fit.unknowns.log
    assert len(race.held_out) == 2 * DRAWS
    assert {cell.plant for cell in race.training} == {"best_fit"}
    cell = replace(race.held_out[0], plant="best_fit")
    graph = race.graph(Run("predicted", cell, (("task.Lambda", 10.0),), 0))
    delays = [block for name, block in graph.blocks.items() if graph.blocks.facts[name]["type"] == "transport_delay"]
    assert [(block.samples, block.share) for block in delays] == [(0, 0.75)]
    assert graph.blocks["task"].delay == 1
    assert not any(law.delay for law in race.file.laws.values())  # as configured, not as drawn
    q = graph.run("20 s", progress=False).recording["arm.q"]
    assert np.all(q[100:] > log.q.min(axis=0) - 0.01)
    assert np.all(q[100:] < log.q.max(axis=0) + 0.01)


def rows(entrant: list[float], level: list[float], others: float = 9.0) -> list[Row]:
    cells = [replace(CELL, plant=f"draw_{k}") for k in range(len(entrant))]
    errors = zip(cells, entrant, level, strict=True)
    return [Row(cell, "experts", {"experts": e, "level": x, "inverse": others}) for cell, e, x in errors]


@pytest.mark.parametrize(
    ("entrant", "level", "outcome"),
    [
        ([0.5, 0.79], [1.0, 1.0], "worth it"),
        ([0.5, 0.81], [1.0, 1.0], "undecided"),
        ([0.85, 0.81], [1.0, 1.0], "not worth it"),
        ([0.05, 0.06], [0.1, 0.1], "not worth it"),  # below the resolution of 0.1 mm
        ([0.5, math.inf], [1.0, 1.0], "not worth it"),
        ([0.5, 0.5], [math.inf, 1.0], "worth it"),
        ([math.inf, 0.5], [math.inf, 1.0], "undecided"),
    ],
)
def test_the_rule(entrant: list[float], level: list[float], outcome: str) -> None:
    assert outcome_of(rows(entrant, level), "level", 0.1) == outcome


def finished(found: list[Row], tuned: Mapping[str, int] | None = None) -> Any:
    """A race with these rows; `tuned` is the number of candidates of each law."""
    laws = ("experts", "level", "inverse")
    path = SimpleNamespace(parameters={"plane": "xy"}, repeats=None)
    file = SimpleNamespace(laws=laws, entrant="experts", budget=4, clocks=(0.008,), paths={"wander": path})
    counts = dict.fromkeys(laws, 4) if tuned is None else tuned
    choices = [Tuned(law, 0.008, (Tried((("a", 1.0),), 0.0, ""),) * count) for law, count in counts.items()]
    return SimpleNamespace(race=SimpleNamespace(file=file), rows=found, choices=choices)


def test_the_sentence_names_the_best_rival_with_its_interval_and_json_has_all_laws() -> None:
    found = decided(finished(rows([0.5] * 7 + [0.85], [1.0] * 7 + [1.1])), 0.1)
    assert found.sentence.startswith("worth it on a path that never repeats (experts 0.5 mm, 0.5 to 0.85; level 1 mm,")
    assert [law.law for law in found.laws] == ["experts", "level", "inverse"]
    assert json.loads(json.dumps(found.summary))["laws"][1]["interval"] == [1.0, 1.1]
    against = decided(finished(rows([0.95] * 8, [1.0] * 8)), 0.1)
    assert against.outcome == "not worth it"
    assert "not worth it on a path that never repeats: take level" in against.sentence


def test_a_law_that_diverged_is_null_in_json() -> None:
    found = decided(finished(rows([math.inf] * 8, [1.0] * 8)), 0.1).summary
    assert found["laws"][-1]["error"] is None
    assert "experts diverged mm" not in found["sentence"]
    assert found["outcome"] == "not worth it"


def test_the_interval_of_one_draw_is_refused() -> None:
    with pytest.raises(DisagreementError, match="expected at least 8 draws for an interval, found 1"):
        decided(finished(rows([0.5], [1.0])), 0.1)
    with pytest.raises(ValueFault, match="draws: expected at least 8 for an interval, found 1"):
        verdicts.verdict_of(known(), draws=1)


@pytest.mark.parametrize("tuned", [{"experts": 4, "level": 1, "inverse": 4}, {"experts": 4, "level": 4}])
def test_a_rival_that_was_not_tuned_like_the_others_is_refused(tuned: dict[str, int]) -> None:
    with pytest.raises(DisagreementError, match=r"was not tuned by the protocol: expected 4 candidates, found [01]"):
        decided(finished(rows([0.5] * 8, [1.0] * 8), tuned), 0.1)


def test_the_sampling_period_is_a_multiple_of_the_logs_that_the_laws_and_the_delay_line_allow() -> None:
    assert clock_of(known(period=0.002)) == 0.008
    assert clock_of(known(delay=6.0, period=0.008)) == 0.016
    assert "expected a delay below 4 samples" in not_applicable(known(delay=7.5, period=0.06))


def test_the_graph_of_a_twin_with_a_long_delay_has_a_longer_clock() -> None:
    data = YAML().load(graph_text(known(delay=6.0)))
    assert data["clock"] == 0.016
    assert data["blocks"]["delay"] == {"type": "transport_delay", "samples": 3}


def test_a_delay_with_a_wide_interval_is_drawn_and_a_controller_is_configured_once(tmp_path: Path) -> None:
    found = known(delay=1.5)
    place = found.fit.unknowns.places["delay"].start
    found.fit.covariance[place, place] += 0.1**2
    race = raced(found, tmp_path, draws=8)
    delays = [plant.transport_delay for plant in race.file.plants.values()]
    assert delays[0] == 1.5
    assert 0.05 < np.std(delays[1:]) < 0.2
    assert race.file.laws["predicted"].set["task.delay"] == 2


def test_settings_follow_the_rules_of_the_page_for_another_clock() -> None:
    packaged_20_ms = {"inverse.retention": 0.996, "inverse.average": 4, "probe.probe": 0.0117, "probe.taps": 8}
    longest = {f"{block}.delay_up_to": 4 for block in ("task", "probe", "inverse", "mix")}
    found = settings(0.02, 1.0)
    assert (found.pop("mix.trial"), found.pop("inverse.inertia_size")) == (None, 5)  # as measured in the pages
    assert found == pytest.approx(packaged_20_ms | longest, rel=1e-4)
    assert settings(0.008, 5.0)["mix.delay_up_to"] == 7


@pytest.mark.parametrize(
    ("options", "fault", "sentence", "status"),
    [
        (["--no-verdict"], None, "not computed: it was not requested", 0),
        ([], KeyboardInterrupt, "not computed: it was interrupted", STOPPED),
        ([], OutputError, "not computed: it was not requested", 2),
        ([], None, "worth it", 0),
    ],
)
def test_the_command_prints_the_identification_also_without_a_verdict(
    options: list[str],
    fault: type[BaseException] | None,
    sentence: str,
    status: int,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def verdict(*_: object, **__: object) -> Verdict:
        if fault is not None:
            raise fault("the disk is full")
        return Verdict("worth it", "worth it")

    monkeypatch.setattr("dmframe.identification.identify.identify", lambda *_, **__: known())
    monkeypatch.setattr(verdicts, "verdict_of", verdict)
    monkeypatch.setattr(sys, "argv", ["dmframe", "identify", "log.csv", "ur10_slow", "--json", *options])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == status
    found = json.loads(capsys.readouterr().out)
    assert found["servo"]["class"] == "pid"
    assert found["verdict"]["sentence"] == sentence


class _Tags(HTMLParser):
    """Texts by heading, and addresses outside the page."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.outside, self.open = list[str](), list[str]()
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.outside += [
            str(value) for name, value in attrs if name in ("src", "href") and not str(value).startswith("#")
        ]
        self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def test_the_page_has_the_verdict_the_parameters_and_a_panel_for_each_joint_and_needs_no_other_file() -> None:
    verdict = decided(finished(rows([0.5] * 8, [1.0] * 8)), 0.1)
    found = replace(
        known(), verdict=verdict, notices=("a <b>notice</b>",), record={"log": "<i>.csv", "command": "dmframe"}
    )
    page = as_html(found)
    tags = _Tags(page)
    assert not tags.outside
    assert not tags.open
    assert f"Verdict: {html.escape(verdict.sentence)}." in page
    assert "a &lt;b&gt;notice&lt;/b&gt;" in page
    assert "&lt;i&gt;.csv" in page
    assert page.count("<svg") == 2
    low, high = found.positive("k_P")[1][0]
    assert f"{low:.4g} to {high:.4g}" in page


def test_the_page_of_an_unknown_servo_has_no_parameters() -> None:
    found = known()
    page = as_html(replace(found, choice=Choice(found.choice.fits, found.choice.floor * 0.01)))
    assert "Unknown servo" in page
    assert "Base parameters" not in page
    assert "K_P" not in page
    assert "Residual" in page


def test_inertia_far_from_that_of_the_robots_file_gives_a_notice() -> None:
    found = known()
    assert not list(_doubts(found))
    found.fit.theta[found.fit.unknowns.places["beta"].start] = -3.5
    [notice] = _doubts(found)
    assert "by 3.5 standard deviations" in notice


def test_six_joints_and_an_unknown_servo_have_no_verdict_and_the_reason() -> None:
    assert "two or three joints" in not_applicable(known("ur10"))
    found = known()
    unknown = replace(found, choice=Choice(found.choice.fits, found.choice.floor * 0 - 1.0))
    assert verdicts.verdict_of(unknown).sentence.startswith("not computed: the class of the servo is unknown")


def test_the_adaptive_law_on_an_identified_robot_with_rotors_is_proved_over_the_intervals(tmp_path: Path) -> None:
    found = known()
    write_text(tmp_path / "twin.urdf", robot_text(found))
    text = adaptive_text(found)
    assert text is not None
    write_text(tmp_path / "adaptive.yaml", text)
    graph = dm.load(tmp_path / "adaptive.yaml")
    value = {leaf.label: np.asarray(leaf.value) for leaf in graph.diagram.loop.parameters}
    assert np.all(value["arm.rotor"] > 0)
    assert {"servo.K_D", "servo.K_P", "servo.K_I", "arm.rotor", "arm.coulomb"} <= set(graph.intervals())
    verdict = graph.verify()
    assert verdict.outcome == "proved", str(verdict)
    wrong = graph.set({"model.rotors": False}).verify()
    assert wrong.outcome != "proved"
    assert "rotor inertia" in str(wrong)


def test_links_of_a_twin_are_physical_bodies_with_the_same_base_parameters() -> None:
    model = known().fit.unknowns.model
    parameters = model.base.parameters
    values = np.array([0.0 if value is None else float(value) for value in parameters.values])
    mass = np.arange(len(values))[parameters.inertial].reshape(-1, 10)
    values[parameters.places("rotor")] = 1.0
    alike = np.linalg.svd(model.grouping)[2][len(model.grouping) :]  # directions that change no base parameter
    moved = values + alike.T @ np.random.default_rng(0).normal(0, 2, len(alike))
    beta = model.grouping @ values
    assert np.min(moved[mass[:, [4, 6, 9]]]) < 0
    found = reflected(moved, beta, model.grouping, parameters)
    assert model.grouping @ found == pytest.approx(beta, abs=1e-9)
    for own in found[mass]:
        inertia = np.array([[own[4], own[5], own[7]], [own[5], own[6], own[8]], [own[7], own[8], own[9]]])
        r = own[1:4] / own[0]
        center = inertia - own[0] * (r @ r * np.eye(3) - np.outer(r, r))
        assert own[0] > 0
        sizes = np.linalg.eigvalsh(center)
        assert sizes[0] > 0
        assert sizes[2] < sizes[0] + sizes[1]


def test_intervals_are_wider_where_the_fit_leaves_more_than_noise() -> None:
    found = known()
    fit = found.fit
    noise = float(np.min(fit.rms)) / 2
    left = replace(found, choice=Choice({"pid": fit}, np.full(3, noise), noise))
    assert found.above == 1
    assert left.above == pytest.approx(2, rel=0.2)
    assert left.delay[1][1] - left.delay[0] == pytest.approx(left.above * (found.delay[1][1] - found.delay[0]))
    assert any("times the noise" in text for text in _above(left))
    assert list(_above(found)) == []


def test_friction_that_grows_with_the_torque_is_in_the_result_its_page_its_graph_and_its_race(tmp_path: Path) -> None:
    found = known(per_torque=0.05)
    assert "per_torque" not in known().summary["friction"]
    assert found.summary["friction"]["per_torque"]["value"] == pytest.approx([0.05] * 3)
    assert "friction per torque" in as_html(found)
    blocks = YAML().load(graph_text(found))["blocks"]
    assert blocks["rubbing"] == {"type": "stribeck_friction", "per_torque": pytest.approx([0.05] * 3)}
    drawn = [plant.blocks["rubbing"]["per_torque"] for plant in raced(found, tmp_path, draws=8).file.plants.values()]
    assert drawn[0] == pytest.approx([0.05] * 3)
    assert np.all(np.std(drawn, axis=0) > 0)


@pytest.mark.parametrize("per_torque", [0.0, 0.3])
def test_measured_torques_give_the_factor_that_positions_do_not_determine(per_torque: float) -> None:
    found = known(per_torque=per_torque)
    fit, log = found.fit, found.fit.unknowns.log
    chain, beta = fit.unknowns.model.chain, found.number("beta")[0]
    plant = Plant.of(fit.unknowns, fit.theta)
    model = chain.model.copy()
    for j, own in enumerate(plant.bodies):
        xx, xy, yy, xz, yz, zz = own[4:]
        r = own[1:4] / own[0]
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) - own[0] * (r @ r * np.eye(3) - np.outer(r, r))
        model.inertias[j + 1] = pin.Inertia(own[0], r, inertia)
    assert len(beta)
    data = model.createData()
    rates = 1.0 + np.arange(3)
    angle = np.outer(log.time, rates)
    q, dq, ddq = 0.3 * np.sin(angle) + START, 0.3 * rates * np.cos(angle), -0.3 * rates**2 * np.sin(angle)
    tau = np.array([pin.rnea(model, data, *row) for row in zip(q, dq, ddq, strict=True)])
    sign = np.tanh(dq / found.number("v_0")[0])
    tau += plant.rotors * ddq + plant.viscous * dq + plant.coulomb * sign
    tau /= 1 - per_torque * np.sign(tau) * sign  # tau = rest + per_torque |tau| sign
    noisy = 1.3 * tau + 4 + np.random.default_rng(0).normal(0, 0.5, tau.shape)
    some = factors(fit, {"tau": noisy})
    assert [own.factor for own in some] == pytest.approx([1.3] * 3, rel=0.02)
    assert all(own.unexplained < 0.1 for own in some)
    shuffled = factors(fit, {"tau": np.random.default_rng(1).normal(size=tau.shape)})
    assert all(own.interval[0] < 0 < own.interval[1] or own.unexplained > 0.9 for own in shuffled)
