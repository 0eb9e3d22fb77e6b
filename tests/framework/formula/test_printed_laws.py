"""The printed laws and the docstrings of packaged blocks agree with their code; a false block fails."""

from pathlib import Path

import pytest
from structures import packaged

import dmframe as dm
from dmframe.cli.app import app

LIAR = '''
from typing import ClassVar
from dmframe.block import *
from dmframe.block.port import *
class Spring(AbstractBlock):
    r"""A spring.

    .. math:: \\dot q = 2 q

    .. math:: \\dot v = \\unknown q
    """
    side: ClassVar = Side.PLANT
    states: ClassVar = (State("q", "1"), State("v", "1"))
    def equations(self, u, x, p): return Equations(rates={"q": SIGN * x.q, "v": -x.q})
'''
FEW = ("arm2_joint", "ur10_fast", "ur10_fast_sampled", "torque_direct_pi")
GRAPH = "dmframe: 1\nduration: 1 s\nclock: continuous\nblocks:\n  spring: {type: spring.py:Spring}\n"


@pytest.mark.parametrize("name", FEW)
def test_what_some_graphs_print_and_state_is_what_runs(name: str) -> None:
    dm.load(name).check_laws()


@pytest.mark.parametrize("name", packaged())
def test_what_a_packaged_graph_prints_and_states_is_what_runs(name: str) -> None:
    assert not [text for text in dm.load(name).check_laws() if "no equation for it" not in text]


def written(folder: Path, factor: str) -> Path:
    (folder / "spring.py").write_text(LIAR.replace("SIGN", factor))
    (folder / "graph.yaml").write_text(GRAPH)
    return folder / "graph.yaml"


def test_check_of_a_graph_whose_docstring_is_false_fails_with_file_and_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = written(tmp_path, "-2")
    assert app(["check", str(path)], standalone_mode=False) == 1
    printed = capsys.readouterr().out
    assert r"spring.py:8: \dot{q}: the docstring's law is not what the equations compute" in " ".join(printed.split())
    with pytest.raises(dm.DmframeError, match=r"spring\.py:8: \\dot"):
        dm.load(path).check_laws()


def test_check_prints_the_equations_that_cannot_be_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = written(tmp_path, "2")
    assert app(["check", str(path)], standalone_mode=False) == 0
    assert "notice: spring.py:10: " in capsys.readouterr().out
