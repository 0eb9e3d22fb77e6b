from __future__ import annotations

from pathlib import Path

import pytest

from dmframe.catalogue import graphs
from dmframe.graph.graph import Graph
from dmframe.report.content import Content, gather
from dmframe.report.linear import LinearView
from dmframe.report.verification import Verification

LIAR = '''
from __future__ import annotations

from typing import ClassVar, final

import casadi as ca

from dmframe.block import AbstractBlock, Equations
from dmframe.block.certificate import Certificate, Square
from dmframe.block.parameter import Diagonal, Positive
from dmframe.block.port import Input, Output, State


@final
class Liar(AbstractBlock):
    """Adapts in the wrong direction, and claims otherwise: x < y & z."""

    inputs = (Input("Y_d", "n p", "N m"), Input("sigma", "n", "rad/s"))
    outputs = (Output("tau_dc", "n", "N m"),)
    states = (State("a_d_hat", "p", ""),)
    truth = (Input("a_d", "p", ""),)

    Gamma: Diagonal = Positive("p")

    def equations(self, u, x, p):
        return Equations({"tau_dc": u.Y_d @ x.a_d_hat}, {"a_d_hat": p.Gamma * (u.Y_d.T @ u.sigma)})

    def certificate(self, u, x, p, truth):
        error = x.a_d_hat - truth.a_d
        stored = Square(error, 1 / p.Gamma)
        return Certificate(storage=(stored,), supply=-ca.dot(u.sigma, u.Y_d @ error))
'''


def case(source: str | Path, *overrides: str) -> Verification:
    graph = Graph.read(source, overrides)
    return Verification(graph, graph.verdict())


def content(found: Verification) -> Content:
    return gather(found.graph, found.verdict, command=["dmframe", "verify", "it's"], seed=0)


@pytest.fixture(scope="session")
def proved() -> Verification:
    return case("arm2_joint", "duration=0.2")


@pytest.fixture(scope="session")
def continuous() -> Verification:
    return case("pendulum")


@pytest.fixture(scope="session")
def refuted(tmp_path_factory: pytest.TempPathFactory) -> Verification:
    folder = tmp_path_factory.mktemp("liar")
    (folder / "liar.py").write_text(LIAR)
    text = graphs()["pendulum"].read_text().replace("type: dynamic_compensator", "type: liar.py:Liar")
    (folder / "lie.yaml").write_text(text.replace("duration: 30 s", "duration: 0.1 s"))
    return case(folder / "lie.yaml")


@pytest.fixture(scope="session")
def failing() -> Verification:
    """Its identity holds, and M_bar > 0 does not."""
    return case("pendulum", "inverse.K_c=0.1", "inverse.tie=position", "duration=0.1")


@pytest.fixture(scope="session")
def silent(tmp_path_factory: pytest.TempPathFactory) -> Verification:
    """A block without a certificate."""
    path = tmp_path_factory.mktemp("silent") / "silent.yaml"
    lines = graphs()["pendulum"].read_text().replace("duration: 30 s", "duration: 0.1 s").splitlines()
    kept = [line for line in lines if not line.strip().startswith(("model:", "dynamics:", "inverse:"))]
    path.write_text("\n".join([*kept, "  inverse:  {type: kinematic_command}"]) + "\n")
    return case(path)


@pytest.fixture(scope="session")
def contents(
    proved: Verification, refuted: Verification, failing: Verification, silent: Verification
) -> dict[str, Content]:
    analysed_too = content(silent)
    with pytest.MonkeyPatch.context() as patched:  # one linear analysis is sufficient
        patched.setattr("dmframe.report.content.linear_view", lambda *_: LinearView("Not looked at."))
        made = {"proved": content(proved), "silent": analysed_too}
        return made | {"refuted": content(refuted), "failing": content(failing)}


@pytest.fixture(scope="session")
def analysed(proved: Verification) -> Content:
    """With a linear analysis of a loop of two joints."""
    return content(proved)
