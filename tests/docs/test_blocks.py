"""Block pages: their content agrees with the code and with a run."""

from __future__ import annotations

import importlib
import io
import re
import sys
from pathlib import Path
from typing import Any

import pytest

import dmframe as dm
from dmframe.block.parameter import specs
from dmframe.catalogue import block_types, graphs
from dmframe.formula.alone import simplest

ROOT = Path(__file__).parents[2]


def part(name: str) -> Any:
    """A module of the documentation's folder."""
    sys.path.insert(0, str(ROOT / "docs"))
    try:
        return importlib.import_module(name)
    finally:
        sys.path.remove(str(ROOT / "docs"))


block_examples, make_blocks = part("block_examples"), part("make_blocks")
KINDS = block_types()
LINK = re.compile(r"\]\((\w+)\.md\)")


def section(page: str, title: str) -> str:
    """The text below a heading."""
    found = re.search(rf"^## {title}.*?\n(.*?)(?=^## |\Z)", page, re.MULTILINE | re.DOTALL)
    assert found is not None, title
    return found[1]


@pytest.fixture(scope="module")
def dynamics() -> str:
    return make_blocks.page("dynamic_compensator", KINDS["dynamic_compensator"])


def test_each_block_is_in_one_family_and_the_index_links_to_each_page_once() -> None:
    index = make_blocks.index(KINDS)
    assert sorted(LINK.findall(re.sub(r"```.*?```", "", index, flags=re.DOTALL))) == sorted(KINDS)
    families = {name: make_blocks.family(kind) for name, kind in KINDS.items()}
    assert {families[name] for name in ("circle", "setpoint")} == {"paths"}
    assert (families["known_tracking"], families["task_observer"]) == ("references", "models")
    assert (families["dynamic_compensator"], families["pid_inverse"]) == ("adaptation", "commands")
    assert families["pid_servo"] == "plant"


def test_a_page_prints_the_law_of_the_code(dynamics: str) -> None:
    found = simplest(KINDS["dynamic_compensator"])
    assert found is not None
    law = section(dynamics, "Law")
    lines = [make_blocks._row(line) for line in found[1].lines]
    assert len(lines) > 3
    assert all(line in law for line in lines)
    assert r"| supply rate | $-" in law
    assert r"It estimates $a_{d}$ by $\hat{a}_{d}$." in law
    assert "### With `leak`" in law


def test_a_page_lists_each_port_state_and_parameter_with_unit_and_meaning(dynamics: str) -> None:
    kind = KINDS["dynamic_compensator"]
    signals, parameters = section(dynamics, "Signals"), section(dynamics, "Parameters")
    for port in (*kind.inputs, *kind.outputs, *kind.truth):
        assert f"| `{port.name}` | {port.shape or '1'} | {port.unit or '-'} |" in signals
    assert all(f"| `{name}` |" in parameters for name in kind.model_fields)
    assert "| `tau_dc` | n | N m | dynamic compensation, Y_d a_d_hat and the task's torque | controller |" in signals
    assert "Adaptation gain" in parameters
    inverse = "\n".join(make_blocks._signals(KINDS["pid_inverse"]))
    assert "commanded velocity | controller, and plant as a command |" in inverse
    servo = "\n".join(make_blocks._signals(KINDS["pid_servo"]))
    assert "| `u` | n | V | armature voltage | plant and proofs |" in servo
    assert re.search(r"\| `q_c` \| n \| rad \| [^|]* \| all: it is measured \|", servo)


def test_a_page_gives_conditions_source_and_notes() -> None:
    shown = block_examples.example("pid_inverse")
    assert "\n".join(make_blocks._conditions(shown)) == r"- $\bar{M} \ge 0$ (Theorem 4 and Remark 5)"
    source = "\n".join(make_blocks._source("[WangTAC2020] eq. (15)."))
    assert source.startswith("\\[WangTAC2020\\] eq. (15).\n- \\[WangTAC2020\\] H. Wang, W. Ren")


def test_the_example_is_the_smallest_graph_that_holds_the_block_and_claims_something() -> None:
    shown = block_examples.example("dynamic_compensator")
    assert shown is not None
    assert (shown.graph, shown.block) == ("pendulum", "dynamics")
    assert "ur10_fast" in shown.others
    assert "pendulum" not in shown.others
    tracking = block_examples.example("known_tracking")
    assert tracking is not None
    assert not tracking.graph.endswith("kinematic")  # smaller, and without a proof
    assert block_examples.example("no_such_block") is None


def test_the_page_shows_the_graphs_file_and_its_live_page(dynamics: str) -> None:
    used = section(dynamics, "In a graph")
    assert graphs()["pendulum"].read_text(encoding="utf-8").rstrip() in used
    assert "```{live} pendulum\n```" in used


def test_the_main_parameter_is_the_first_that_must_be_positive_else_the_first_number() -> None:
    def main(graph: str, name: str) -> str:
        block = dm.load(graph).blocks[name]
        return block_examples.main_parameter(type(block), block)

    assert main("pendulum", "dynamics") == "Gamma"
    assert main("pendulum", "inverse") == "K_c"
    assert main("ur10_fast", "path") == "radius"  # its centre is a point, which has no multiples
    assert main("pendulum", "arm") == "viscous"
    assert main("pendulum", "model") == ""


def test_what_happens_with_another_value_is_what_a_run_gives(dynamics: str) -> None:
    rows = re.findall(r"^\| x (\S+) \| (\S+) \| (\S+) rad \| (\S+) rad \|", dynamics, re.MULTILINE)
    assert [row[0] for row in rows] == ["0.25", "0.5", "1", "2", "4"]
    assert [float(row[1]) for row in rows] == [1.25, 2.5, 5, 10, 20]
    run = dm.load("pendulum").set({"dynamics.Gamma": 20}).run(20)
    assert run.error is not None
    error = run.error.rms_by_eighth
    assert rows[-1][2:] == (f"{error[0]:.3g}", f"{error[-1]:.3g}")
    assert float(rows[-1][3]) < float(rows[0][3])


def test_an_impossible_value_is_reported_and_the_others_are_tried() -> None:
    graph = dm.load("pendulum")
    found = block_examples._tried(graph, "inverse.w_P", [1.0, -0.5, "x"], 0.1)
    assert [bool(row[0]) for row in found] == [True, True, False]
    assert "expected a quantity in 1/s" in found[2][2]


def test_a_long_sum_is_broken_between_its_summands_and_states_the_same() -> None:
    found = simplest(KINDS["pid_inverse"])
    assert found is not None
    for line in found[1].lines:
        row = make_blocks._row(line)
        whole = f"{line.left.latex} &= {line.right.latex}"
        assert re.sub(r"\s*\\\\\s*&\\quad\s*", " ", row).replace("- ", "-") == whole.replace("- ", "-")
    assert make_blocks._row(found[1].S).count("&") == 5  # a line for each of five squares


def test_a_bar_in_a_cell_ends_no_column() -> None:
    assert make_blocks._table(("a",), [("$|x|^2$ and |",)]).splitlines()[-1] == r"| $\vert x\vert ^2$ and \| |"


def test_a_parameter_states_its_unit_and_sign() -> None:
    spec = specs(KINDS["dynamic_compensator"])["Gamma"]
    assert f"{spec.unit or '-'} > 0" in make_blocks._parameters(KINDS["dynamic_compensator"])


def test_writing_the_pages_counts_them_in_a_terminal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    monkeypatch.setattr(make_blocks, "page", lambda name, _: name)  # steps that take seconds
    monkeypatch.setattr(sys, "stderr", terminal := Terminal())
    written = make_blocks.write(tmp_path, names=("circle", "sinusoid"))
    assert [path.name for path in written] == ["index.md", "circle.md", "sinusoid.md"]
    assert "2 / 2 pages" in terminal.getvalue()
    monkeypatch.setattr(sys, "stderr", quiet := io.StringIO())
    make_blocks.write(tmp_path, names=())
    assert quiet.getvalue() == ""
