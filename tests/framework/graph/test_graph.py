"""The public interface: a graph that is changed, run, proved, analysed and drawn."""

from __future__ import annotations

import inspect
import pickle
import subprocess
import sys
import xml.etree.ElementTree as ET
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import dmframe as dm
from dmframe.catalogue import graphs
from dmframe.common.errors import DmframeError, OutputError, UnknownNameError, ValueFault
from dmframe.report.linear import LinearView
from dmframe.report.verification import Verification
from dmframe.simulate import simulate

TEXT = graphs()["pendulum"].read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def pendulum() -> dm.Graph:
    return dm.load("pendulum").set(duration="0.5 s")


@pytest.fixture(scope="module")
def found(pendulum: dm.Graph) -> Verification:
    return pendulum.verify(seed=3)


@pytest.fixture(scope="module")
def run(pendulum: dm.Graph) -> dm.Run:
    return pendulum.run()


@pytest.fixture(scope="module")
def analysis(pendulum: dm.Graph) -> Any:
    return pendulum.analyse(0.1)


def test_a_graph_comes_from_its_name_a_path_a_text_and_data() -> None:
    named = dm.load("pendulum")
    data = named.document.data
    others = [dm.load(graphs()["pendulum"]), dm.load(str(graphs()["pendulum"])), dm.load(TEXT), dm.load(data)]
    assert {other.diagram.fingerprint for other in others} == {named.diagram.fingerprint}
    assert dm.load(named) is named
    assert [dm.load(TEXT).name, dm.load(data, name="mine").name] == ["graph", "mine"]


def test_data_may_hold_arrays_tuples_and_numbers_of_numpy() -> None:
    data = dict(dm.load("arm2_joint").document.data)
    servo = next(name for name, block in data["blocks"].items() if block["type"] == "pi_servo")
    data["blocks"] = data["blocks"] | {servo: data["blocks"][servo] | {"K_P": np.array([60.0, 60.0])}}
    data["duration"] = np.float64(0.5)
    loaded = dm.load(data)
    assert (loaded.duration, loaded.blocks[servo].K_P) == (0.5, (60.0, 60.0))  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("source", "text"),
    [
        ("pendulumm", "pendulumm: unknown graph; did you mean pendulum?"),
        (TEXT.replace("clock", "clokc"), "graph:4:1: clokc: unknown key; did you mean clock?"),
        ({"dmframe": 1}, "graph: blocks: this key is missing"),
        ({}, "graph: expected a graph, found no keys; a graph begins with dmframe: 1"),
        ({1: 2}, "graph: a key is a text, found 1"),
        ({"dmframe": 1, "clock": {1}}, "clock: expected a number, a text, a list or keys with values, found set"),
        ({"dmframe": 1, "duration": float("nan")}, "duration: expected a finite number, found nan"),
        (7, "load: expected a graph's name, its path, its text or a dictionary, found int"),
    ],
)
def test_text_that_is_not_a_graph_is_refused_with_its_place(source: Any, text: str) -> None:
    with pytest.raises(DmframeError) as caught:
        dm.load(source)
    assert text in str(caught.value)


def test_a_value_that_is_set_gives_another_graph_and_leaves_this_one(pendulum: dm.Graph) -> None:
    other = pendulum.set({"dynamics.Gamma": 3, "clock": "2 ms"})
    assert (other.clock, pendulum.clock) == (0.002, None)
    assert other.blocks["dynamics"].Gamma == 3.0  # type: ignore[attr-defined]
    assert pendulum.blocks["dynamics"].Gamma != 3.0  # type: ignore[attr-defined]
    assert other.overrides == ('duration="0.5 s"', "dynamics.Gamma=3", 'clock="2 ms"')


def test_what_is_set_is_what_the_command_line_would_set(pendulum: dm.Graph) -> None:
    set_here = pendulum.set({"dynamics.Gamma": 3, "start": {"q": [0.2]}, "inverse.w_box": [0, 2]})
    assert dm.Graph.read("pendulum", set_here.overrides).data == set_here.data


def test_former_names_of_a_graph_give_it_with_a_notice(pendulum: dm.Graph, run: dm.Run, analysis: Any) -> None:
    with pytest.warns(DeprecationWarning, match=r"graph\.experiment is now the graph itself"):
        assert pendulum.experiment is pendulum
    with pytest.warns(DeprecationWarning, match=r"run\.experiment is now run\.graph"):
        assert run.experiment is pendulum
    with pytest.warns(DeprecationWarning, match=r"analysis\.experiment is now analysis\.graph"):
        assert analysis.experiment is pendulum


def test_each_changed_copy_is_a_graph_with_the_same_methods(pendulum: dm.Graph) -> None:
    copies = [pendulum.set({"dynamics.Gamma": 3}), pendulum.until(1), pickle.loads(pickle.dumps(pendulum))]
    copies.append(dm.load("theorem_3").baseline())
    assert {type(copy) for copy in copies} == {dm.Graph}


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"dynamics.Gama": 1}, "set dynamics.Gama=1: blocks.dynamics.Gama: unknown parameter of dynamic_compensator"),
        ({"dynamics.Gamma": -1}, "set dynamics.Gamma=-1: blocks.dynamics.Gamma"),
        ({"dynamic.Gamma": 1}, "set dynamic.Gamma=1: unknown block or key; did you mean dynamics?"),
        ({"dynamics.Gamma": np.nan}, "set dynamics.Gamma: dynamics.Gamma: expected a finite number, found nan"),
        ({3: 1}, "set: expected a text such as 'task.gamma' as the name, found 3"),
        ({"dynamics": 1}, "expected a parameter of a block, dynamics.parameter=value"),
    ],
)
def test_a_value_that_cannot_be_set_is_refused_with_its_name(pendulum: dm.Graph, values: Any, text: str) -> None:
    with pytest.raises(DmframeError) as caught:
        pendulum.set(values)
    assert text in str(caught.value)


def test_all_faults_of_several_values_are_reported_at_once(pendulum: dm.Graph) -> None:
    with pytest.raises(DmframeError) as caught:
        pendulum.set({"dynamics.Gamma": -1, "inverse.K_c": 0})
    assert "dynamics.Gamma" in str(caught.value)
    assert "inverse.K_c" in str(caught.value)


def test_a_run_keeps_the_graphs_clock_solver_start_and_log() -> None:
    graph = dm.load("arm2_joint").set(
        {"clock": "2 ms", "solver.step": 0.0005, "start": {"q": [0.7, 1.0]}, "log.signals": ["arm.q"], "duration": 0.02}
    )
    run, file = graph.run(), graph.file
    assert (run.recording.clock, run.recording.solver.step) == (0.002, 0.0005)
    assert run["arm.q"].values[0].tolist() == [0.7, 1.0]
    assert "arm.dq" not in run
    by_hand = simulate(graph.diagram, file.duration, clock=file.clock, solver=graph.solver, start={"q": [0.7, 1.0]})
    assert np.array_equal(run["arm.q"].values, by_hand["arm.q"])


@pytest.mark.parametrize("until", [0.2, "0.2 s", "200 ms", np.float64(0.2)])
def test_a_run_lasts_as_long_as_requested(pendulum: dm.Graph, until: Any) -> None:
    run = pendulum.run(until)
    assert (run.time[-1], run.graph.file.duration) == (0.2, 0.2)


@pytest.mark.parametrize("until", [0, "-1 s", "soon", np.inf, True])
def test_a_time_that_is_invalid_is_refused(pendulum: dm.Graph, until: Any) -> None:
    with pytest.raises(DmframeError, match=f"until {until}: expected"):
        pendulum.run(until)


def test_signals_have_names_units_and_a_nearest_one() -> None:
    run = dm.load("arm2_joint").run("0.1 s")
    q = run["arm.q"]
    assert (q.dims, q.attrs["units"], list(q.joint.values)) == (("time", "joint"), "rad", ["joint1", "joint2"])
    assert run.data["arm.q"].identical(q)
    with pytest.raises(UnknownNameError, match=r"did you mean arm\.q\?"):
        run["arm.qq"]
    assert "arm.q" in run._ipython_key_completions_()


def test_short_texts_and_pages_for_a_notebook(
    pendulum: dm.Graph, found: Verification, run: dm.Run, analysis: Any
) -> None:
    things: list[Any] = [pendulum, run, found, analysis, pendulum.draw(), dm.compare([run]), dm.blocks(), dm.robots()]
    for thing in things:
        assert len(repr(thing)) < 1500 if isinstance(thing, type(dm.blocks())) else len(repr(thing)) < 400
    for thing in (*things[:4], *things[5:], pendulum.blocks["dynamics"], dm.blocks()["circle"], run.plot("arm.q")):
        page = thing._repr_html_()
        assert "<" in page
        assert "None" not in page
    assert ET.fromstring(things[4]._repr_svg_()).tag.endswith("svg")
    assert repr(found) == "<Verification of pendulum: proved>"
    assert str(found).startswith("pendulum: proved\n")
    assert pendulum.title in pendulum._repr_html_()
    for name in pendulum.blocks:
        assert name in pendulum._repr_html_()


def test_the_default_figures_of_a_run_are_a_page_for_a_notebook(pendulum: dm.Graph) -> None:
    figures = pendulum.run().plot()
    page = figures._repr_html_()
    assert page.count("<img") == len(figures) > 1
    assert "None" not in page


def test_a_title_that_is_a_script_is_shown_as_text(pendulum: dm.Graph) -> None:
    graph = pendulum.set(title="<script>alert(1)</script>")
    for page in (graph._repr_html_(), graph.run()._repr_html_(), graph.verify()._repr_html_()):
        assert "<script" not in page
        assert "&lt;script" in page


def test_a_verification_states_what_the_command_line_states(found: Verification, tmp_path: Path) -> None:
    assert isinstance(found, Verification)
    assert (found.proved, found.outcome, found.summary["seed"]) == (True, "proved", 3)
    assert [item.signal for item in found.conclusions] == ["q - q_d", "d(q - q_d)/dt"]
    assert all(condition.holds for condition in found.conditions)
    found.report(tmp_path / "r.md")
    assert (tmp_path / "r.md").read_text(encoding="utf-8").startswith("# pendulum: proved")


@pytest.mark.parametrize("ending", ["svg", "png", "pdf", "mmd"])
def test_a_drawing_is_written_by_its_ending(pendulum: dm.Graph, tmp_path: Path, ending: str) -> None:
    file = pendulum.draw().save(tmp_path / f"a.{ending}")
    start = {"svg": b"<svg", "png": b"\x89PNG", "pdf": b"%PDF", "mmd": b"---"}[ending]
    assert file.read_bytes().startswith(start)
    with pytest.raises(OutputError, match="expected the extension"):
        pendulum.draw().save(tmp_path / "a.doc")


def test_a_png_shows_each_block_where_the_svg_has_it(pendulum: dm.Graph, tmp_path: Path) -> None:
    drawing = pendulum.draw()
    with Image.open(drawing.save(tmp_path / "a.png")) as image:
        pixels = np.asarray(image.convert("L"))
    root = ET.fromstring(drawing.svg)
    scale = pixels.shape[1] / float(root.get("width", 0))
    assert pixels.shape[0] == pytest.approx(scale * float(root.get("height", 0)), abs=2)
    space = "{http://www.w3.org/2000/svg}"
    shift = float(next(g for g in root.iter(f"{space}g") if g.get("transform")).get("transform", "")[12:-1])
    boxes = [box for box in root.iter(f"{space}rect") if box.get("class") == "box"]
    assert len(boxes) == len(pendulum.blocks)
    for box in boxes:
        x, y, wide = (float(box.get(key, 0)) for key in ("x", "y", "width"))
        row, left, right = (round(scale * value) for value in (y + shift, x + 25, x + wide - 25))
        edge = pixels[row - 2 : row + 3, left:right].min(axis=0)
        assert (edge < 128).all()  # the line of the box is drawn over the whole time


def test_a_saved_graph_loads_again_and_is_not_overwritten(pendulum: dm.Graph, tmp_path: Path) -> None:
    file = pendulum.set({"dynamics.Gamma": 7}).save(tmp_path / "mine.yaml")
    again = dm.load(file)
    assert again.blocks["dynamics"].Gamma == 7.0  # type: ignore[attr-defined]
    with pytest.raises(OutputError, match="exists already; choose a new file"):
        pendulum.save(file)


def test_paths_may_begin_at_home(pendulum: dm.Graph, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setattr("dmframe.report.content.linear_view", lambda *_: LinearView("Not looked at."))
    assert pendulum.save("~/g.yaml").is_file()
    assert dm.load("~/g.yaml").blocks.keys() == dm.load(Path("~/g.yaml")).blocks.keys() == pendulum.blocks.keys()
    assert pendulum.draw().save("~/g.svg") == tmp_path / "g.svg"
    assert pendulum.verify().report("~/g.json") == tmp_path / "g.json"
    assert tmp_path.joinpath("g.json").is_file()


def test_an_error_shows_itself_in_a_line() -> None:
    run = dm.load("arm2_joint").run(until="0.5 s")
    assert repr(run.error).startswith("<TrackingError q - q_d: ")
    assert repr(run.error).endswith("mrad in the last>")
    assert len(repr(run.error)) < 100


def test_every_public_name_has_a_docstring_and_typed_arguments() -> None:
    assert set(dir(dm)) == set(dm.__all__)
    for name in dm.__all__:
        thing = getattr(dm, name)
        if name == "__version__":
            continue
        assert inspect.getdoc(thing), name
        if inspect.isfunction(thing):
            signature = inspect.signature(thing)
            assert all(p.annotation is not inspect.Parameter.empty for p in signature.parameters.values()), name
            assert signature.return_annotation is not inspect.Signature.empty, name
    for kind in (dm.Graph, dm.Run, dm.Runs):
        for name, member in inspect.getmembers(kind, inspect.isfunction):
            if not name.startswith("_"):
                assert inspect.getdoc(member), f"{kind.__name__}.{name}"


def test_a_name_that_is_not_there_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="has no attribute 'simulate_all'"):
        dm.simulate_all  # noqa: B018 - the attribute is the test


def test_importing_it_imports_nothing_heavy() -> None:
    code = "import sys, dmframe; print(sorted({'casadi', 'numpy', 'pydantic', 'xarray'} & sys.modules.keys()))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


def test_a_proof_imports_no_run_report_or_plotting_module() -> None:
    code = (
        "import sys, dmframe as dm; dm.load('pendulum').verify()\n"
        "heavy = 'dmframe.batch', 'dmframe.results', 'dmframe.regressor.export', 'dmframe.report.content', 'scipy'\n"
        "print([name for name in heavy if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


def test_functions_stay_functions_when_the_rooms_are_imported() -> None:
    code = (
        "import dmframe as dm, importlib, pkgutil\n"
        "for m in pkgutil.walk_packages(dm.__path__, 'dmframe.'):\n"
        "    m.name.endswith('__main__') or importlib.import_module(m.name)\n"
        "print([name for name in dm.__all__ if type(getattr(dm, name)).__name__ == 'module'])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


def test_an_unknown_engine_is_refused(pendulum: dm.Graph) -> None:
    with pytest.raises(ValueFault, match="engine: expected auto, compiled, interpreted, found 'fast'"):
        pendulum.run("0.1 s", engine="fast")  # type: ignore[arg-type]


def test_a_run_states_that_its_loop_is_unstable_on_its_clock_though_it_stayed_bounded() -> None:
    notices = dm.load("ur10_slow").run("12 s").notices
    assert any("unstable near its set-point with a clock of 90 ms, spectral radius" in notice for notice in notices)
    assert dm.load("ur10_slow").run("5 s").notices == ()  # too short to be shown
    assert dm.load("ur10_fast").run("12 s").notices == ()


def test_a_graph_and_a_run_survive_pickling_and_a_graph_equals_one_of_the_same_text(pendulum: dm.Graph) -> None:
    again = pickle.loads(pickle.dumps(pendulum))
    assert again == pendulum
    assert hash(again) == hash(pendulum)
    assert again != pendulum.set({"dynamics.Gamma": 3})
    assert again.overrides == pendulum.overrides
    run = pendulum.run()
    read = pickle.loads(pickle.dumps(run))
    assert read.data.identical(run.data)
    assert read.error.rms_final == run.error.rms_final  # type: ignore[union-attr]


def test_several_threads_may_prove_one_graph(pendulum: dm.Graph) -> None:
    with ThreadPoolExecutor(2) as pool:
        found = list(pool.map(lambda _: pendulum.verify().headline, range(2)))
    assert found == ["proved"] * 2


def test_blocks_cannot_be_exchanged_behind_a_graphs_back(pendulum: dm.Graph) -> None:
    with pytest.raises(TypeError):
        pendulum.blocks["servo"] = pendulum.blocks["servo"]  # type: ignore[index]
    with pytest.raises(UnknownNameError, match="did you mean dynamics"):
        pendulum.blocks["dynmics"]
    assert dm.blocks().get("nothing") is None


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda g: g.set("dynamics.Gamma=3"), "set: expected values by name"),
        (lambda g: g.variants({"dynamics.Gamma": "15"}), "values dynamics.Gamma: expected a list of values"),
        (lambda g: dm.sweep(g, {"dynamics.Gamma": 5}), "values dynamics.Gamma: expected a list of values"),
        (lambda g: dm.sweep(g, [1]), "values: expected values by name"),
        (lambda g: g.run(0.1)[3], "expected a signal's name such as arm.q, found int"),
        (lambda g: g.run(0.1)["arm"], "choose from arm.ddq, arm.dq"),
        (lambda g: g.verify(seed="a"), "seed: expected a whole number, found 'a'"),
        (lambda g: dm.compare([g.run(0.1)], until=0.2), "pendulum is a run of 100 ms, not 0.2"),
        (lambda g: g.run(0.1).plot("arm.q").save("x.png"), "expected a folder, found the name of a file"),
    ],
)
def test_common_first_mistakes_are_refused_with_a_remedy(pendulum: dm.Graph, call: Any, text: str) -> None:
    with pytest.raises(DmframeError) as caught:
        call(pendulum)
    assert text in str(caught.value)


def test_a_run_that_is_not_as_long_as_requested_gives_a_notice(pendulum: dm.Graph) -> None:
    notices = dm.load("ur10_fast").run("12 ms").notices
    assert notices == ("16 ms are simulated, not 12 ms: whole ticks of 8 ms",)
    assert pendulum.run("0.3 s").notices == ()
    few = pendulum.set({"log.every": 0.5}).run("0.5 s")
    assert few.notices == ("log.every keeps fewer than three instants of this run",)
    assert repr(few).startswith("<Run pendulum: 500 ms, to its end")


def test_an_omitted_measurement_moves_no_arm() -> None:
    controller = dm.load("ur10_fast_tuned").controller()
    assert controller.step(0.0) is False
    for array in controller.measured.values():
        array[:] = 0.1
    assert controller.step(0.0) is True
