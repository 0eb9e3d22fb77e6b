from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from PIL import Image

from dmframe.common.errors import UnknownNameError
from dmframe.common.plotting import FORMATS, files_of, look, styled, thin
from dmframe.results.along import along
from dmframe.results.command_figure import command_figure
from dmframe.results.effort_figure import effort_figure
from dmframe.results.error_figure import error_figure
from dmframe.results.estimate_figure import estimate_figure
from dmframe.results.folder import write_run
from dmframe.results.path_figure import last_lap, magnification, path_figure
from dmframe.results.signal_figure import signal_figure
from dmframe.results.storage_figure import storage_figure

NAMES = ("error", "path", "commands", "effort", "storage_ur10_fast", "estimates_ur10_fast")


def drawn(name, run):
    """Every figure of a run, drawn as for a file."""
    makers = (error_figure, path_figure, command_figure)
    for figure in [make({name: run}) for make in makers] + [estimate_figure(name, run)]:
        if figure is not None:
            with styled():
                figure.draw_without_rendering()


def test_figures_are_written_next_to_the_data_as_small_well_formed_svg(tmp_path, ur10, kinematic):
    write_run(tmp_path / "out", [kinematic, ur10])
    files = {item.name for item in (tmp_path / "out").iterdir() if item.is_file()} - {"seal.json"}
    assert files == {f"{name}.svg" for name in NAMES}
    for name in NAMES:
        file = tmp_path / "out" / f"{name}.svg"
        assert file.stat().st_size < 2_000_000
        assert ET.parse(file).getroot().tag.endswith("svg")


def test_figures_are_also_drawn_as_png_of_200_dpi_and_as_pdf(tmp_path, ur10, kinematic):
    write_run(tmp_path / "out", [kinematic, ur10], formats=("png", "pdf", "png"))
    files = {item.name for item in (tmp_path / "out").iterdir() if item.is_file()} - {"seal.json"}
    assert files == {f"{name}.{ending}" for name in NAMES for ending in ("png", "pdf")}
    for name in NAMES:
        with Image.open(tmp_path / "out" / f"{name}.png") as picture:
            assert picture.info["dpi"][0] == pytest.approx(200, abs=0.1)
            assert picture.info["Description"] == "ur10_fast_kinematic, ur10_fast"
            assert picture.info["Software"].startswith("dmframe ")
        pdf = (tmp_path / "out" / f"{name}.pdf").read_bytes()
        assert pdf.startswith(b"%PDF-")
        assert b"ur10_fast_kinematic, ur10_fast" in pdf
        assert b"CreationDate" not in pdf


@pytest.mark.parametrize("formats", ["pgn", ("svg", "jpg"), ("",)])
def test_a_format_that_there_is_not_is_refused_before_anything_is_written(tmp_path, kinematic, formats):
    with pytest.raises(UnknownNameError, match=r"formats: unknown format of figures"):
        write_run(tmp_path / "out", [kinematic], formats=formats)
    assert not (tmp_path / "out").exists()


def test_the_same_run_gives_the_same_files_and_no_setting_of_the_user_matters(kinematic):
    import matplotlib as mpl

    once = files_of(error_figure({"one": kinematic.recording}), "error", "one", FORMATS)
    with mpl.rc_context({"lines.linewidth": 7.0, "font.size": 20.0}):
        again = files_of(error_figure({"one": kinematic.recording}), "error", "one", FORMATS)
    assert set(once) == {"error.png", "error.svg", "error.pdf"}
    assert once == again


@pytest.mark.parametrize("case", ["pendulum", "arm2", "planar"])
def test_joints_alone_one_joint_and_a_plane_have_all_their_figures(request, case):
    result = request.getfixturevalue(case)
    drawn(case, result.recording)
    panels = error_figure({case: result.recording}).axes
    assert len(panels) == {"pendulum": 1, "arm2": 2, "planar": 2}[case] + 1


def test_a_diverged_run_is_marked_where_it_diverged_and_does_not_dwarf_the_others(ur10, kinematic, blow_up):
    wild = blow_up(ur10.recording, 0.4)
    runs = {"sound": kinematic.recording, "wild": wild}
    figure = error_figure(runs)
    assert any(text.get_text() == "wild (diverged at 0.4 s)" for text in figure.legends[0].get_texts())
    top = figure.axes[0].get_ylim()[1]
    assert top < 100  # [mm]
    marks = [line for line in figure.axes[0].lines if list(line.get_xdata()) == [wild.divergence.time] * 2]
    assert len(marks) == 1
    drawn("wild", wild)
    drawn("sound", kinematic.recording)


def test_a_run_of_one_tick_and_one_that_diverged_at_once_have_figures(make_result, blow_up):
    short = make_result("ur10_fast", 0.008)
    drawn("short", short.recording)
    run = short.recording
    first = {label: rows[:1] for label, rows in run.states.items()}
    outputs = {label: rows[:1] for label, rows in run.outputs.items()}
    wild = blow_up(make_result("ur10_fast", 0.08).recording, 0.03)
    dead = replace(run, time=run.time[:1], states=first, outputs=outputs, divergence=wild.divergence)
    drawn("dead", dead)


def test_a_controller_without_estimates_has_no_figure_of_them(kinematic):
    assert estimate_figure("kinematic", kinematic.recording) is None


def test_of_many_parameters_those_that_move_most_are_named(ur10):
    figure = estimate_figure("ur10", ur10.recording)
    texts = [text.get_text() for text in figure.axes[0].get_legend().get_texts()]
    moves = np.ptp(ur10.recording["dynamics.a_d_hat"], axis=0)
    assert len(texts) == 8
    assert texts[-1] == f"{int(np.sum(moves > 0)) - 7} more"


def test_an_estimate_of_mixed_units_states_each_ones_own(make_result):
    run = make_result("torque_indirect_pi", 0.02).recording
    panel = estimate_figure("torque", run).axes[0]
    texts = [text.get_text() for text in panel.get_legend().get_texts()]
    assert "[" not in panel.get_ylabel()
    assert (
        sum(text.split("  ")[0].endswith(("[kg]", "[kg m]", "[kg m²]", "[N m s/rad]", "[N m]")) for text in texts) == 7
    )
    assert signal_figure({"torque": run}, ["adaptation.a_d_hat"]).axes[0].get_ylabel() == "adaptation.a_d_hat"


def test_an_estimate_of_one_unit_states_it_at_the_axis(ur10):
    panel = signal_figure({"ur10": ur10.recording}, ["inverse.w"]).axes[0]
    assert panel.get_ylabel() == "inverse.w\n[rad/(N m s)]"
    assert [text.get_text() for text in panel.get_legend().get_texts()] == ["shoulder pan", "shoulder lift", "elbow"]


def test_the_path_is_drawn_in_the_plane_in_which_it_is_widest(ur10):
    axes = path_figure({"ur10": ur10.recording}).axes[0]
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x [m]", "y [m]")
    assert axes.get_aspect() == 1.0


def test_the_way_to_a_constant_goal_is_shown_whole(ur10):
    outputs = dict(ur10.recording.outputs)
    outputs["path.x_d"] = np.tile([0.2, 0.6, 0.5], (ur10.recording.time.size, 1))
    (axes,) = path_figure({"ur10": replace(ur10.recording, outputs=outputs)}).axes
    plane = ["xyz".index(label[0]) for label in (axes.get_xlabel(), axes.get_ylabel())]
    ends = np.array([axes.get_xlim(), axes.get_ylim()])
    for point in (outputs["path.x_d"][0], ur10.recording["arm.x"][0], ur10.recording["arm.x"][-1]):
        assert np.all((ends[:, 0] < point[plane]) & (point[plane] < ends[:, 1]))


def test_the_last_lap_of_a_circle_is_one_period_and_an_open_path_is_whole():
    times = np.arange(0, 20, 0.01)
    circle = np.stack([np.cos(times), np.sin(times)], axis=1)
    begin = last_lap(times, circle)
    assert times[-1] - times[begin] == pytest.approx(2 * np.pi, abs=0.02)
    assert last_lap(times, np.stack([times, times], axis=1)) == 0
    assert last_lap(times, np.ones((times.size, 2))) == 0
    waited = np.repeat(np.arange(times.size), np.where(np.arange(times.size) % 700 == 0, 5, 1))  # time is constant
    assert times[waited][last_lap(times[waited], circle[waited])] == times[begin]


def test_a_path_that_only_crosses_the_point_where_it_ends_begins_no_lap_there(make_result):
    times = np.arange(0, 10, 0.01)
    eight = np.stack([np.sin(times), np.sin(2 * times)], axis=1)[: int(300 * np.pi) + 1]  # one eight and a half
    begin = last_lap(times[: len(eight)], eight)
    assert times[len(eight) - 1] - times[begin] == pytest.approx(2 * np.pi, abs=0.02)  # not half of it
    there_and_back = make_result("pendulum", 30.0).recording  # through zero during the run, zero at the end
    assert last_lap(there_and_back.time, there_and_back["path.q_d"]) == 0
    assert last_lap(times[:2], eight[:2]) == 0


def test_errors_of_rounding_alone_are_drawn_as_zero(arm2):
    run = arm2.recording
    states = {**run.states, "arm.q": run["path.q_d"] + np.array([1e-17, 1e-4])}
    first, second, norm = error_figure({"one": replace(run, states=states)}).axes
    assert first.get_yticks().tolist() == [0.0]
    assert second.get_ylim()[1] == pytest.approx(0.1, rel=0.2)
    assert norm.get_yscale() == "log"
    nothing = replace(run, states={**run.states, "arm.q": run["path.q_d"] + 1e-17})
    assert [panel.get_yticks().tolist() for panel in error_figure({"none": nothing}).axes] == [[0.0]] * 3


def test_deviations_are_magnified_by_round_numbers_and_never_reduced():
    assert magnification(0.3, 0.001) == 100
    assert magnification(0.3, 0.012) == 5
    assert magnification(0.3, 0.2) == 1
    assert magnification(0.0, 0.0) == 1


def test_a_thinned_curve_keeps_its_spikes_and_its_ends():
    values = np.sin(np.arange(100_000) * 1e-3)
    values[43_210], values[77_777] = 50.0, -50.0
    kept = thin(values, 500)
    assert kept.size <= 502
    assert {0, 43_210, 77_777, 99_999} <= set(kept.tolist())


def test_no_two_of_many_curves_look_alike_and_neighbours_differ_in_grey():
    looks = [look(index) for index in range(36)]
    assert len({str(item) for item in looks}) == 36
    grey = [sum(w * int(item["color"][i : i + 2], 16) for w, i in ((0.3, 1), (0.59, 3), (0.11, 5))) for item in looks]
    assert all(abs(a - b) > 30 for a, b in pairwise(grey[:6]))


def note(figure):
    return "" if figure._supxlabel is None else figure._supxlabel.get_text()


def test_a_figure_names_the_runs_that_it_leaves_out_and_the_stretch_that_it_shows(ur10, pendulum):
    runs = {"big": ur10.recording, "small": pendulum.recording}
    assert note(error_figure(runs)) == "not shown: small, whose error is q - q_d"
    assert note(path_figure(runs)) == "not shown: small, whose error is q - q_d"
    assert note(command_figure(runs)) == "controller every 8 ms\nnot shown: small, with other joints"
    assert note(error_figure({"big": ur10.recording})) == ""
    longer = replace(ur10.recording, time=ur10.recording.time * 50, duration=50.0)
    assert note(effort_figure({"big": longer})) == "from 38 s to 50 s of 50 s; controller every 8 ms"


def test_true_values_are_written_next_to_the_names_of_their_estimates(ur10):
    figure = estimate_figure("ur10", ur10.recording)
    texts = [text.get_text() for text in figure.axes[1].get_legend().get_texts()]
    K_D = ur10.graph.blocks["servo"].K_D
    assert texts == [
        f"{name}  (true {1 / gain:.3g})"
        for name, gain in zip(("shoulder pan", "shoulder lift", "elbow"), K_D, strict=True)
    ]


def test_voltages_and_torques_are_drawn_joint_by_joint(ur10):
    axes = effort_figure({"ur10": ur10.recording}).axes
    assert len(axes) == 6
    assert [panel.get_ylabel().split("\n")[-1] for panel in axes[:2]] == ["[V]", "[N m]"]
    (voltage,) = axes[0].get_lines()
    assert voltage.get_ydata()[-1] == ur10.recording["servo.u"][-1, 0]


def test_names_that_look_like_mathematics_are_drawn_as_they_are(ur10):
    drawn(r"$\frac{$", ur10.recording)


def test_a_run_of_two_instants_is_seen(ur10):
    short = replace(
        ur10.recording,
        time=ur10.recording.time[:2],
        states={label: rows[:2] for label, rows in ur10.recording.states.items()},
        outputs={label: rows[:2] for label, rows in ur10.recording.outputs.items()},
    )
    (line, *_) = error_figure({"short": short}).axes[0].get_lines()
    assert line.get_marker() == "o"


def test_v_is_drawn_as_the_proof_states_it_with_its_largest_terms(arm2):
    verdict = arm2.graph.verdict(arm2.recording.diagram)
    proved = along(verdict.claim, arm2.recording, float(verdict.kappa.chosen))
    above, below = storage_figure("arm2", arm2).axes
    (V,) = above.get_lines()
    np.testing.assert_allclose(V.get_ydata(), proved.V[np.isin(arm2.time, V.get_xdata())], rtol=1e-12)
    assert V.get_xdata()[[0, -1]].tolist() == arm2.time[[0, -1]].tolist()
    names = ["w_I − K_I/K_P (inverse)", "w − 1/K_⋆ (inverse)", "i + q_c − q_r (inverse)", "â_d − a_d (dynamics)"]
    assert {text.get_text() for text in below.get_legend().get_texts()} == {*names, "σ (arm)", "q − q_d (task)"}


def test_a_figure_of_v_states_how_many_of_its_terms_it_leaves_out(arm2, monkeypatch):
    assert storage_figure("arm2", arm2).axes[1].get_ylabel() == "terms of $V$"
    monkeypatch.setattr("dmframe.results.storage_figure.CURVES", 4)
    below = storage_figure("arm2", arm2).axes[1]
    assert below.get_ylabel() == "4 largest of 6\nterms of $V$"
    assert len(below.get_legend().get_texts()) == 4


def test_a_graph_of_which_nothing_would_be_proved_has_no_figure_of_v(kinematic, make_result, pendulum, monkeypatch):
    assert storage_figure("no certificate", kinematic) is None
    unpaid = make_result("pendulum", 0.1, "inverse.K_c=0.1", "inverse.tie=position")
    assert unpaid.graph.verdict(unpaid.recording.diagram).outcome == "not_applicable"
    assert storage_figure("a condition fails", unpaid) is None
    states = {label: rows for label, rows in pendulum.recording.states.items() if label != "servo.q_c"}
    partly = replace(pendulum, recording=replace(pendulum.recording, states=states))
    assert storage_figure("a state was not kept", partly) is None
    assert storage_figure("all is well", pendulum) is not None
    monkeypatch.setattr("dmframe.results.claimed.MOST", 3)
    assert storage_figure("too large to be decided on the way", replace(pendulum)) is None


def test_v_of_a_run_that_diverged_is_drawn_up_to_there(arm2, blow_up):
    figure = storage_figure("wild", replace(arm2, recording=blow_up(arm2.recording, 0.3)))
    assert figure.axes[0].get_title(loc="left") == "wild (diverged at 0.3 s)"
    assert figure.axes[0].get_ylim()[1] < 10


def test_no_label_of_a_panel_leaves_the_page(pendulum):
    figure = error_figure({"pendulum": pendulum.recording})
    with styled():
        figure.draw_without_rendering()
    assert all(panel.yaxis.label.get_window_extent().x0 >= 0 for panel in figure.axes)
