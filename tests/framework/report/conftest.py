from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pytest

from dmframe.catalogue import graphs
from dmframe.certify import Verdict, verify
from dmframe.config import Graph, load_graph
from dmframe.diagram import Diagram
from dmframe.report.content import Content, gather
from dmframe.report.linear import LinearView

LIAR = '''
from __future__ import annotations

from typing import ClassVar, final

import casadi as ca

from dmframe.block import AbstractBlock, Equations
from dmframe.certificate import Certificate, Square
from dmframe.parameter import Diagonal, Positive
from dmframe.port import Port, State


@final
class Liar(AbstractBlock):
    """Adapts in the wrong direction, and claims otherwise: x < y & z."""

    inputs: ClassVar = (Port("Y_d", "n p", "N m"), Port("sigma", "n", "rad/s"))
    outputs: ClassVar = (Port("tau_dc", "n", "N m"),)
    states: ClassVar = (State("a_d_hat", "p", ""),)
    truth: ClassVar = (Port("a_d", "p", ""),)

    Gamma: Diagonal = Positive("p")

    def equations(self, u, x, p):
        return Equations({"tau_dc": u.Y_d @ x.a_d_hat}, {"a_d_hat": p.Gamma * (u.Y_d.T @ u.sigma)})

    def certificate(self, u, x, p, truth):
        error = x.a_d_hat - truth.a_d
        stored = Square(error, 1 / p.Gamma)
        return Certificate(storage=(stored,), supply=-ca.dot(u.sigma, u.Y_d @ error))
'''


@dataclass(frozen=True)
class Case:
    graph: Graph
    diagram: Diagram
    verdict: Verdict

    @property
    def item(self) -> tuple[Graph, Diagram, Verdict]:
        return self.graph, self.diagram, self.verdict


def case(source: str | Path, *overrides: str) -> Case:
    graph = load_graph(source, overrides)
    diagram = graph.diagram()
    return Case(graph, diagram, verify(diagram))


def content(found: Case) -> Content:
    return gather(found.graph, found.diagram, found.verdict, command=["dmframe", "verify", "it's"], seed=0)


@pytest.fixture(scope="session")
def proved() -> Case:
    return case("arm2_joint", "duration=0.2")


@pytest.fixture(scope="session")
def continuous() -> Case:
    return case("pendulum")


@pytest.fixture(scope="session")
def refuted(tmp_path_factory: pytest.TempPathFactory) -> Case:
    folder = tmp_path_factory.mktemp("liar")
    (folder / "liar.py").write_text(LIAR)
    text = graphs()["pendulum"].read_text().replace("type: dynamic_compensator", "type: liar.py:Liar")
    (folder / "lie.yaml").write_text(text.replace("duration: 30 s", "duration: 0.1 s"))
    return case(folder / "lie.yaml")


@pytest.fixture(scope="session")
def failing() -> Case:
    """Its identity holds, and M_bar > 0 does not."""
    return case("pendulum", "inverse.K_c=0.1", "inverse.tie=position", "duration=0.1")


@pytest.fixture(scope="session")
def silent(tmp_path_factory: pytest.TempPathFactory) -> Case:
    """A block without a certificate."""
    path = tmp_path_factory.mktemp("silent") / "silent.yaml"
    lines = graphs()["pendulum"].read_text().replace("duration: 30 s", "duration: 0.1 s").splitlines()
    kept = [line for line in lines if not line.strip().startswith(("model:", "dynamics:", "inverse:"))]
    path.write_text("\n".join([*kept, "  inverse:  {type: kinematic_command}"]) + "\n")
    return case(path)


@pytest.fixture(scope="session")
def contents(proved: Case, refuted: Case, failing: Case, silent: Case) -> dict[str, Content]:
    made = {"proved": content(proved), "silent": content(silent)}
    with pytest.MonkeyPatch.context() as patched:  # one linear analysis of each kind is enough
        patched.setattr("dmframe.report.content.linear_view", lambda *_: LinearView("Not looked at."))
        return made | {"refuted": content(refuted), "failing": content(failing)}
