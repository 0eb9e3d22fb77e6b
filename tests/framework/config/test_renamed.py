"""Old names in graph files: read as the new ones, with one notice that contains the place and the new name."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.block.port import Output
from dmframe.common.errors import BlockError, DmframeError, Faults
from dmframe.config.resolved import resolved
from dmframe.graph.graph import Graph

pytestmark = pytest.mark.usefixtures("without_v")

BLOCK = '''
from typing import ClassVar
from dmframe.block import AbstractBlock, Equations
from dmframe.block.certificate import Certificate, Square
from dmframe.block.parameter import Positive, Real, Scalar
from dmframe.block.port import Access, Input, Output, Side, State


class Pull(AbstractBlock):
    """v = -rate y + bias."""

    inputs = (Input("height"),)
    outputs = (Output("v", "", "", Access.COMMANDED),)
    renamed = {"gain": "rate", "y": "height"}
    rate: Scalar = Positive()

    def equations(self, u, x, p):
        return Equations(outputs={"v": -p.rate * u.height})


class Cart(AbstractBlock):
    """dplace = v + push."""

    side = Side.PLANT
    inputs = (Input("v"),)
    outputs = (Output("height", "", "", Access.MEASURED),)
    states = (State("place"),)
    renamed = {"y": "height", "z": "place", "shove": "push"}
    place: Scalar = Real(default=0.0)
    push: Scalar = Real(default=1.0)

    def equations(self, u, x, p):
        return Equations(outputs={"height": x.place}, rates={"place": u.v + p.push})
'''

NEW = """dmframe: 1
clock: continuous
duration: 1 s
start: {place: 2}
log: {signals: [cart.height]}
blocks:
  pull: {type: "blocks.py:Pull", rate: 3}
  cart: {type: "blocks.py:Cart", push: 0.5}
wires:
  pull.height: cart.height
uncertain: {cart.push: [0, 1]}
baseline:
  pull: {type: "blocks.py:Pull", rate: 1}
"""
PAIRS = [
    ("start: {place", "start: {z", "4:9", "z", "place"),
    ("start: {place", "start: {cart.z", "4:9", "cart.z", "cart.place"),
    ("[cart.height]", "[cart.y]", "5:17", "cart.y", "cart.height"),
    ("rate: 3", "gain: 3", "7:34", "gain", "rate"),
    ("push: 0.5", "shove: 0.5", "8:34", "shove", "push"),
    ("  pull.height:", "  pull.y:", "10:3", "pull.y", "pull.height"),
    (": cart.height\n", ": cart.y\n", "10:16", "cart.y", "cart.height"),
    ("{cart.push", "{cart.shove", "11:13", "cart.shove", "cart.push"),
    ("rate: 1}", "gain: 1}", "13:34", "gain", "rate"),
]


@pytest.fixture
def write(tmp_path: Path) -> Callable[[str], Path]:
    (tmp_path / "blocks.py").write_text(BLOCK)

    def write(text: str) -> Path:
        file = tmp_path / "graph.yaml"
        file.write_text(text)
        return file

    return write


def printed(call: Callable[[], Any]) -> str:
    with pytest.raises(DmframeError) as caught:
        call()
    return str(caught.value)


@pytest.mark.parametrize(("new", "old", "place", "before", "after"), PAIRS)
def test_an_old_name_is_read_as_the_new_one_with_one_notice(
    write: Callable[[str], Path],
    capsys: pytest.CaptureFixture[str],
    new: str,
    old: str,
    place: str,
    before: str,
    after: str,
) -> None:
    plain = Graph.read(write(NEW))
    assert capsys.readouterr().err == ""
    text = NEW.replace(new, old, 1)
    assert text != NEW
    graph = Graph.read(write(text))
    assert resolved(graph) == resolved(plain) or "cart.z" in text
    assert {**graph.start, "place": 2.0, "cart.place": 2.0} == {"place": 2.0, "cart.place": 2.0}
    assert graph.diagram.fingerprint == plain.diagram.fingerprint
    assert graph.baseline().diagram.fingerprint == plain.baseline().diagram.fingerprint
    file = plain.document.name
    assert capsys.readouterr().err == (
        f"{file}:{place}: notice: {before} is now called {after}; the former name still works, but write {after}\n"
    )


def test_every_old_name_at_once_gives_the_same_graph(
    write: Callable[[str], Path], capsys: pytest.CaptureFixture[str]
) -> None:
    plain, text = Graph.read(write(NEW)), NEW
    for new, old, *_ in PAIRS[1:]:
        text = text.replace(new, old, 1)
    graph = Graph.read(write(text))
    assert graph.diagram.fingerprint == plain.diagram.fingerprint
    assert capsys.readouterr().err.count("notice: ") == len(PAIRS) - 1


@pytest.mark.parametrize(
    ("override", "parameter", "value"),
    [("pull.gain=7", "pull.rate", 7), ("blocks.pull.gain=7", "pull.rate", 7), ("cart.shove=0.75", "cart.push", 0.75)],
)
def test_set_takes_an_old_name_and_goes_before_the_file(
    write: Callable[[str], Path], capsys: pytest.CaptureFixture[str], override: str, parameter: str, value: float
) -> None:
    for text in (NEW, NEW.replace("rate: 3", "gain: 3").replace("push: 0.5", "shove: 0.5")):
        graph = Graph.read(write(text), [override])
        values = {item.label: item.value for item in graph.diagram.loop.parameters}
        np.testing.assert_array_equal(values[parameter], value)
        notice = f"--set {override}: notice: {override.split('=')[0].split('.')[-1]} is now called"
        assert notice in capsys.readouterr().err
        renamed = override.replace("gain", "rate").replace("shove", "push")
        assert Graph.read(write(text), [renamed]).diagram.fingerprint == graph.diagram.fingerprint
        capsys.readouterr()


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("log.signals=[cart.y]", "log.signals=[cart.height]"),
        ("log={signals: [cart.y]}", "log={signals: [cart.height]}"),
        ("wires={pull.y: cart.y}", "wires={pull.height: cart.height}"),
        ("wires.pull.y=cart.y", "wires.pull.height=cart.height"),
        ("uncertain={cart.shove: [0, 2]}", "uncertain={cart.push: [0, 2]}"),
        ("uncertain.cart.shove=[0, 2]", "uncertain.cart.push=[0, 2]"),
        ("start={cart.z: 5}", "start={cart.place: 5}"),
        ("start.cart.z=5", "start.cart.place=5"),
        ("baseline.pull.gain=2", "baseline.pull.rate=2"),
    ],
)
def test_set_reads_old_names_wherever_a_file_may_hold_them(
    write: Callable[[str], Path], capsys: pytest.CaptureFixture[str], old: str, new: str
) -> None:
    wanted = Graph.read(write(NEW), [new])
    assert capsys.readouterr().err == ""
    assert Graph.read(write(NEW), [old]).data == wanted.data
    printed = capsys.readouterr().err.splitlines()
    assert printed
    assert all(line.startswith(f"--set {old}: notice: ") for line in printed)


def test_set_takes_an_old_start(write: Callable[[str], Path]) -> None:
    assert Graph.read(write(NEW), ["start.z=5"]).start == {"place": 5.0}


def test_both_names_at_once_are_an_error_with_its_place(write: Callable[[str], Path]) -> None:
    file = write(NEW.replace("rate: 3", "rate: 3, gain: 4").replace("{cart.push", "{cart.shove: [0, 1], cart.push"))
    text = printed(lambda: Graph.read(file))
    assert f"{file}:7:43: gain is now called rate, and both are given; keep only rate" in text
    assert f"{file}:11:13: cart.shove is now called cart.push, and both are given" in text
    text = printed(lambda: Graph.read(write(NEW), ["pull.gain=1", "pull.rate=2"]))
    assert text == "--set pull.gain=1: gain is now called rate, and both are given; keep only rate"


def test_a_bad_value_under_an_old_name_is_reported_at_its_place(write: Callable[[str], Path]) -> None:
    file = write(NEW.replace("rate: 3", "gain: -3"))
    assert printed(lambda: Graph.read(file)).startswith(f"{file}:7:40: blocks.pull.rate: ")
    assert "--set pull.gain=-1: blocks.pull.rate: " in printed(lambda: Graph.read(write(NEW), ["pull.gain=-1"]))


def test_a_block_of_another_type_has_no_old_names(write: Callable[[str], Path]) -> None:
    assert "gain" in printed(lambda: Graph.read(write(NEW.replace("push: 0.5", "gain: 0.5"))))


def test_old_names_must_lead_to_names_that_the_block_has() -> None:
    class Wrong(AbstractBlock):
        outputs = (Output("a"), Output("b"))
        renamed = {"old": "c", "a": "b"}  # noqa: RUF012 - a block's class variables are annotated in its own file

        def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
            return Equations()

    texts = [fault.text for fault in Wrong.contract("wrong")]
    assert "wrong: declares old renamed to c, which is not a parameter, state or port; choose from a, b" in texts
    assert "wrong: declares a as renamed to b, and still has a" in texts
    assert isinstance(Wrong.contract("wrong")[0], BlockError)


def test_the_command_line_reports_it_on_stderr_and_keeps_json_clean(write: Callable[[str], Path]) -> None:
    file = write(NEW.replace("rate: 3", "gain: 3"))
    call = [sys.executable, "-c", "from dmframe.cli import main; main()", "verify", str(file), "--json"]
    done = subprocess.run(call, capture_output=True, text=True, check=False)
    assert done.stderr.count("notice: ") == 1
    assert done.stdout.lstrip().startswith("{")


def test_faults_of_both_kinds_do_not_hide_one_another(write: Callable[[str], Path]) -> None:
    file = write(NEW.replace("rate: 3", "rate: 3, gain: 4").replace("rate: 1}", "rate: 1, gain: 4}"))
    with pytest.raises(Faults) as caught:
        Graph.read(file)
    assert len(caught.value.faults) == 2
