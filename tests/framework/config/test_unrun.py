"""A graph whose block files are not run: what is told of it, and that nothing of them runs."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import pytest

from dmframe.catalogue import find_graph
from dmframe.config.declared import DONE, declared
from dmframe.config.experiment import load_experiment
from dmframe.config.unrun import look_at
from dmframe.drawing import mermaid
from dmframe.errors import BlockError, DmframeError, UnknownNameError
from dmframe.port import TIME, Access, Port, Side, State

MARK = 'import pathlib\npathlib.Path(__file__).with_name("it_ran").touch()\n'
BLOCK = f"""
{MARK}
from typing import ClassVar, Literal

from dmframe.block import AbstractBlock, Equations
from dmframe.parameter import Diagonal, NonNegative, Positive, Scalar
from dmframe.port import Port, State

@print
class Leaky(AbstractBlock):
    '''Adapts, and leaks.'''

    inputs: ClassVar = (Port("Y_d", "n p", "N m"), Port("sigma", "n", "rad/s"))
    outputs: ClassVar = (Port("tau_dc", "n", "N m"),)
    states: ClassVar = (State("a_d_hat", "p"),)

    Gamma: Diagonal = Positive("p")
    leak: Scalar = NonNegative(unit="1/s", default=0.0)
    law: Literal["plain", "robust"] = "plain"
    table: dict = print("it ran")

    print("it ran")
    def equations(self, u, x, p):
        print("it ran")
"""


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.setenv("HOME", str(tmp_path / "home"))


@pytest.fixture
def graph(tmp_path: Path) -> Path:
    """The pendulum's graph with a block of a file that all may write."""
    (tmp_path / "mine.py").write_text(BLOCK, encoding="utf-8")
    (tmp_path / "mine.py").chmod(0o666)
    text = find_graph("pendulum").read_text(encoding="utf-8")
    file = tmp_path / "g.yaml"
    file.write_text(text.replace("type: dynamic_compensator", "type: mine.py:Leaky"), encoding="utf-8")
    return file


def dmframe(monkeypatch: pytest.MonkeyPatch, *words: str) -> int:
    from dmframe.cli import main

    monkeypatch.setattr(sys, "argv", ["dmframe", *words])
    with pytest.raises(SystemExit) as stopped:
        main()
    return int(stopped.value.code or 0)


def test_check_tells_what_a_file_declares_and_runs_nothing_of_it(
    graph: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    assert dmframe(monkeypatch, "check", str(graph)) == 2
    said = capsys.readouterr()
    lines = [line.split() for line in said.out.splitlines()]
    assert ["dynamics", "mine.py:Leaky", "controller", "a_d_hat", "Gamma,", "leak,", "law,", "table"] in lines
    assert ["dynamics.sigma", "<-", "inverse.sigma", "rad/s"] in lines
    assert ["servo.dq_c", "<-", "inverse.dq_c", "rad/s"] in lines
    assert ["dynamics", "Adapts,", "and", "leaks."] in lines
    assert f"  dynamics  not known without running it: table, {DONE}\n" in said.out
    assert ["servo.q_step", "<-", "0", "(nobody", "drives", "it)", "rad"] in lines
    assert "not checked: equations, shapes" in said.out
    assert f"{graph}:" in said.err
    assert "mine.py would run as your own program, and all users may write to" in said.err
    assert "it ran" not in said.out
    assert not graph.with_name("it_ran").exists()


def test_draw_draws_the_blocks_and_wires_that_a_file_declares_and_runs_nothing_of_it(
    graph: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    assert dmframe(monkeypatch, "draw", str(graph), "-o", str(graph.with_name("g.svg"))) == 0
    assert "drawn from declarations alone" in capsys.readouterr().err
    picture = graph.with_name("g.svg").read_text(encoding="utf-8")
    assert ">dynamics<" in picture
    assert ">leaky<" in picture
    assert not graph.with_name("it_ran").exists()
    found = look_at(str(graph))
    assert found is not None
    same = find_graph("pendulum")
    assert dmframe(monkeypatch, "draw", str(same)) == 0
    whole, read = capsys.readouterr().out, mermaid(found, found.experiment.file.title)
    assert "states: q_r, q_tie, z" in read  # one that the inverse may leave out
    assert read.rstrip().replace("q_tie, ", "") == whole.rstrip().replace("<i>dynamic_compensator</i>", "<i>leaky</i>")


def test_faults_of_the_text_are_told_without_running_anything(graph: Path) -> None:
    for change, told in (
        ("dynamics.Gama=1", "Gama: unknown parameter of leaky; did you mean Gamma?"),
        ("dynamics.Gamma=-1", "blocks.dynamics.Gamma: expected a number > 0, found -1"),
        ("dynamics.law=fast", "expected 'plain' or 'robust', found 'fast'"),
        ("clock=never", "expected a sampling period such as 8 ms, or continuous, found 'never'"),
        ("robot.model=ur1", "unknown robot; did you mean ur10?"),
    ):
        with pytest.raises(DmframeError) as raised:
            look_at(str(graph), [change])
        assert told in str(raised.value)
    text = graph.read_text(encoding="utf-8")
    graph.write_text(f"{text}wires: {{dynamics.sigmo: task.sigma}}\n", encoding="utf-8")
    found = look_at(str(graph))
    assert found is not None
    assert "wires.dynamics.sigmo: unknown input; did you mean dynamics.sigma?" in str(found.faults[-1])
    assert not graph.with_name("it_ran").exists()


def test_a_graph_whose_files_may_be_run_is_not_looked_at_but_built(graph: Path) -> None:
    assert look_at("pendulum") is None
    graph.with_name("mine.py").chmod(0o644)
    assert look_at(str(graph)) is None


def test_what_a_class_computes_is_not_known_and_what_it_writes_out_is() -> None:
    source = """
class Odd(AbstractBlock):
    side: ClassVar[Side] = Side.PLANT
    inputs = (TIME, Port("dq_c", "n", unit="rad/s", optional=True))
    outputs = tuple(Port(name) for name in "ab")
    states = (State("q", "n", "rad", box="q_box"),)
    truth = (*OTHERS, Port("x"))
    q_box: Box = Interval("n", "rad")
    equations = None
    K: Scalar = Positive(**{"unit": open("/etc/passwd")})
    helper = __import__("os").system("false")
"""
    found = declared(source.encode(), "Odd", "odd.py")
    kind = found.kind
    assert (kind.side, kind.inputs) == (Side.PLANT, (TIME, Port("dq_c", "n", "rad/s", optional=True)))
    assert kind.states == (State("q", "n", "rad", box="q_box"),)
    assert (kind.outputs, kind.truth) == ((), ())
    assert list(kind.model_fields) == ["q_box", "K"]
    assert set(found.unread) == {"outputs", "truth", "K", DONE}
    assert declared(b"from a import B\nC = B", "B", "b.py").unread
    assert declared(b"class D(B):\n  outputs = (Port('q', access=Access.MEASURED),)", "D", "d.py").unread == (
        "what it inherits",
    )
    assert (
        declared(b"class E(AbstractBlock):\n  outputs = (Port('q', access=Access.MEASURED),)", "E", "e.py")
        .kind.outputs[0]
        .access
        is Access.MEASURED
    )


@pytest.mark.parametrize(
    ("source", "kind", "told"),
    [
        (b"class A(AbstractBlock): pass", UnknownNameError, "mine.py:B: unknown class; choose from A"),
        (b"class B(", BlockError, "mine.py: 1: SyntaxError: not readable as Python"),
        (b"x = \x00", BlockError, "not readable as Python"),
        (b"a = " + b"(" * 5000, BlockError, "not readable as Python"),
        (b"class B(AbstractBlock):\n  inputs = Port('q')", BlockError, "a comma makes a tuple of one"),
        (b"class B(AbstractBlock):\n  a: Literal[()] = 1", BlockError, "mine.py: its declarations make no class: "),
    ],
)
def test_a_file_that_cannot_be_read_is_told(source: bytes, kind: type[Exception], told: str) -> None:
    with pytest.raises(kind) as raised:
        declared(source, "B", "mine.py")
    assert told in str(raised.value)


def test_ports_that_nobody_knows_are_those_that_wires_name(graph: Path) -> None:
    graph.with_name("mine.py").write_text(f"{MARK}from elsewhere import Leaky\n", encoding="utf-8")
    text = graph.read_text(encoding="utf-8")
    wires = "wires: {dynamics.s: inverse.sigma, inverse.tau_dc: dynamics.torque}\n"
    graph.write_text(text + wires, encoding="utf-8")
    found = look_at(str(graph))
    assert found is not None
    assert [port.name for port in found.blocks["dynamics"].inputs] == ["s"]
    assert [port.name for port in found.blocks["dynamics"].outputs] == ["torque"]
    assert len(found.faults) == 1  # of the file alone: what is missed may be what nobody knows
    assert "σ → s" in mermaid(found)
    assert not graph.with_name("it_ran").exists()


PLAIN = """
from typing import ClassVar, final

from dmframe.block import AbstractBlock, Equations
from dmframe.parameter import Positive, Scalar
from dmframe.port import Port, State

SIZE = 3


@final
class B(AbstractBlock):
    '''A block.'''

    inputs: ClassVar = (Port("u", "n"),)
    states: ClassVar = (State("z", "n"),)
    k: Scalar = Positive(default=1.0)

    def equations(self, u, x, p):
        return Equations(rates={"z": self._rate(u)})

    def _rate(self, u):
        return u.u if SIZE else 0
"""
DOING = {
    "a statement in the class": ("    k: Scalar", "    if True:\n        inputs = ()\n    k: Scalar"),
    "a sum onto it": ("    k: Scalar", "    inputs += ()\n    k: Scalar"),
    "two targets": ("    k: Scalar", "    inputs, states = (), ()\n    k: Scalar"),
    "set twice": ("    k: Scalar", "    inputs = ()\n    k: Scalar"),
    "deleted": ("    k: Scalar", "    del states\n    k: Scalar"),
    "a walrus": ("default=1.0", "default=(inputs := 1.0)"),
    "a call in the class": ("    k: Scalar", "    size = locals().update(inputs=())\n    k: Scalar"),
    "a method of its name": ("    def _rate", "    def states(self):\n        return ()\n\n    def _rate"),
    "a hook": ("    def _rate", "    def __init_subclass__(cls):\n        pass\n\n    def _rate"),
    "a decorator": ("@final", "@change"),
    "a metaclass": ("(AbstractBlock)", "(AbstractBlock, metaclass=M)"),
    "set from outside": ("SIZE = 3", "SIZE = 3\nAbstractBlock.inputs = ()"),
    "a loop outside": ("SIZE = 3", "for inputs in [()]:\n    pass"),
    "another Port": ("SIZE = 3", "def Port(*given):\n    return None"),
    "another base": ("from dmframe.block import AbstractBlock, Equations", "from evil import AbstractBlock"),
    "whatever another file has": ("SIZE = 3", "from evil import *"),
    "the class made anew": ("SIZE = 3", "B = 3"),
    "a call outside": ("SIZE = 3", "SIZE = change()"),
}


@pytest.mark.parametrize("what", DOING)
def test_a_file_that_does_more_than_declare_is_not_taken_at_its_word(what: str) -> None:
    old, new = DOING[what]
    assert PLAIN.count(old) == 1
    assert declared(PLAIN.encode(), "B", "b.py").unread == ()
    assert "what the file's code does" in " ".join(declared(PLAIN.replace(old, new).encode(), "B", "b.py").unread)


def test_a_class_within_a_condition_is_not_known_and_not_unknown() -> None:
    nested = "if True:\n" + "".join(f"    {line}\n" for line in PLAIN.splitlines())
    assert "outputs" in declared(nested.encode(), "B", "b.py").unread


def test_what_a_terminal_would_obey_is_shown_as_text(graph: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    file = graph.with_name("mine.py")
    file.write_text(BLOCK.replace('"sigma"', '"sig\\x1b[31m"').replace('"1/s"', '"\\x1b]0;t\\x07"'), encoding="utf-8")
    file.chmod(0o666)
    assert dmframe(monkeypatch, "check", str(graph)) == 2
    said = capsys.readouterr()
    assert "\x1b" not in said.out + said.err
    assert "sig\\x1b[31m" in said.out


@pytest.mark.parametrize(("make", "told"), [("folder", "expected a file, found"), ("circle", "cannot be found")])
def test_what_is_no_file_is_told_as_that(graph: Path, make: str, told: str) -> None:
    file = graph.with_name("mine.py")
    file.unlink()
    if make == "folder":
        file.mkdir()
    else:
        file.symlink_to(file)
    with pytest.raises(DmframeError, match=told):
        load_experiment(str(graph))
