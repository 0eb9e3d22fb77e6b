"""Fill the table of docs/paper.md: each numbered equation, property, theorem, remark -> block or file -> test -> graph.

    python docs/make_paper.py

What an equation is, and who states it, stands below in `ROWS`; tests and graphs are looked up. ``tests/docs`` says when
the page is stale, when a block cites an equation that its row does not know, and when a row names what is not there.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "paper.md"
BLOCKS, GRAPHS, TESTS = (ROOT / part for part in ("blocks/dmframe_blocks", "blocks/dmframe_blocks/graphs", "tests"))
BEGIN, END = "<!-- table: begin -->", "<!-- table: end -->"
NOT_GIVEN = "not given in our source"
KNOWN_ANSWERS = "tests/blocks/test_known_answers.py"


@dataclass(frozen=True)
class Row:
    """A line of the paper's table; `files` where no block states it, ``path`` or ``path::name``."""

    what: str
    says: str
    blocks: tuple[str, ...] = ()
    files: tuple[str, ...] = ()
    tests: tuple[str, ...] = ()
    graphs: tuple[str, ...] = ()


SYMBOLIC, ROBOT = "dmframe/robot/symbolic.py", "tests/framework/robot/test_symbolic.py"
INVERSE_PID = "the PID inverse: command, adaptation of w, w_P, w_I and a_d; our source gives (32)-(39) as one range"
ROWS = (
    Row("(1)", "x = f(q)", ("kinematics", "manipulator")),
    Row("(2)", "dx = J(q) dq", ("kinematics",)),
    Row(
        "(3)",
        "M ddq + C dq + B dq + g = K u",
        ("manipulator",),
        tests=(f"{KNOWN_ANSWERS}::test_the_manipulator_obeys_the_textbooks_equation_of_motion",),
    ),
    Row(
        "(4)",
        "J(q) psi = Y_k(q, psi) a_k",
        ("adaptive_kinematics",),
        (f"{SYMBOLIC}::kinematic_regressor",),
        (f"{ROBOT}::test_the_task_velocity_is_linear_in_the_kinematic_parameters",),
    ),
    Row(
        "(5)",
        "M dzeta + C zeta + B zeta + g = Y_d(q, dq, zeta, dzeta) a_d",
        ("regressor",),
        (f"{SYMBOLIC}::regressor",),
        (f"{ROBOT}::test_the_regressor_times_the_parameters_is_the_torque_for_any_parameters",),
    ),
    Row("(6)", "PI velocity servo", ("pi_servo",)),
    Row("(7)", "PID position servo", ("pid_servo",)),
    Row("(8)", "passive filter of the task feedback, dy", ("passive_filter",)),
    Row("(9)", "filtered regulation, dq_ref = -K_2 y", ("filtered_regulation",)),
    Row("(10), (11)", NOT_GIVEN),
    Row(
        "(12)",
        "PI inverse with the dynamic compensation and the task's torque",
        ("pi_inverse", "dynamic_compensator", "filtered_regulation"),
    ),
    Row("(13)", "da_k, driven by Dx", ("adaptive_kinematics", "filtered_regulation")),
    Row("(14)", "dw = -Lambda tau_dc * sigma", ("pi_inverse",)),
    Row("(15)", "da_d = -Gamma_d Y_d' sigma", ("dynamic_compensator",)),
    Row("(16)", "dw_I = Lambda_I (q_c - q_r) * sigma", ("pi_inverse",)),
    Row("(17), (18)", NOT_GIVEN),
    Row("(19)", "task observer", ("task_observer",)),
    Row(
        "(20)",
        "observed regulation, dq_ref = -gamma J_hat' (x_o - x_d): (30) with a goal at rest",
        ("observed_tracking",),
    ),
    Row("(21)", "PI inverse for it: (12) without the task's torque", ("pi_inverse", "dynamic_compensator")),
    Row("(22)", "da_k, driven by Dx - Dx_o", ("adaptive_kinematics", "observed_tracking")),
    Row("(23)-(25)", NOT_GIVEN),
    Row("(26)", "beta > 4 gamma / 9", ("observed_tracking", "task_observer")),
    Row("(27)-(29)", NOT_GIVEN),
    Row("(30)", "observed tracking; with known kinematics, Section V's", ("observed_tracking", "task_tracking")),
    Row("(31)", "beta > 4 gamma / 9 again, for tracking", ("observed_tracking",)),
    Row("(32)-(36), (38), (39)", INVERSE_PID, ("pid_inverse",)),
    Row("(37)", "da_d = -Gamma_d Y_d' xi, with xi our sigma", ("dynamic_compensator", "pid_inverse")),
    Row("(40)-(42)", NOT_GIVEN),
    Row(
        "(43)",
        "z'' + w_P z' + w_I z = 0 uniformly exponentially stable",
        ("pid_inverse",),
        ("dmframe/certificate.py::CommonLyapunov", "dmframe/certify/stability.py"),
        ("tests/framework/certify/test_conditions.py",),
    ),
    Row("(44)", NOT_GIVEN),
    Row("(45)", "joint tracking", ("joint_tracking",)),
    Row("(46)-(48)", NOT_GIVEN),
    Row(
        "(49)-(53)",
        "a user's torque through the servo: PI and PID; our source names (50) and the range",
        ("pi_torque_inverse", "pid_torque_inverse", "filtered_regressor"),
    ),
    Row(
        "(54)-(58)",
        "indirect adaptation from the prediction error; our source gives the range",
        ("indirect_adaptation", "certainty_equivalence", "filtered_adaptation", "filtered_regressor"),
    ),
    Row(
        "(59)",
        "adaptive computed torque",
        ("computed_torque", "certainty_equivalence", "direct_adaptation", "mass_estimate"),
    ),
    Row("(60)", "direct adaptation, driven by M_hat^-1 s_star", ("direct_adaptation", "computed_torque")),
    Row("Property 1", NOT_GIVEN),
    Row(
        "Property 2",
        "M symmetric, uniformly positive",
        ("manipulator",),
        (f"{SYMBOLIC}::mass_matrix",),
        (f"{ROBOT}::test_the_mass_matrix_is_symmetric_entry_by_entry",),
    ),
    Row(
        "Property 3",
        "dM/dt - 2 C skew-symmetric",
        ("manipulator",),
        (f"{SYMBOLIC}::coriolis",),
        (f"{ROBOT}::test_the_mass_matrix_rate_minus_twice_coriolis_is_exactly_skew",),
    ),
    Row(
        "Property 4",
        "linear in a_d: (5)",
        ("regressor",),
        (f"{SYMBOLIC}::regressor",),
        (f"{ROBOT}::test_the_regressor_times_the_parameters_is_the_torque_for_any_parameters",),
    ),
    Row(
        "Theorem 1",
        "filtered regulation, PI servo",
        ("filtered_regulation", "passive_filter", "pi_inverse"),
        graphs=("theorem_1",),
    ),
    Row("Theorem 2", "observed regulation, PI servo", ("observed_tracking", "task_observer"), graphs=("theorem_2",)),
    Row("Theorem 3", "observed tracking, PI servo", ("observed_tracking", "task_observer"), graphs=("theorem_3",)),
    Row("Theorem 4", "PID servo, M_bar >= 0 in the passive case", ("pid_inverse",), graphs=("theorem_4",)),
    Row("Remark 1", NOT_GIVEN),
    Row(
        "Remark 2",
        "projection of w, w_P, w_I, a_d_hat, a_k_hat",
        files=(
            "dmframe/port.py::State",
            "dmframe/diagram/projection.py::Projection",
            "dmframe/simulate/step.py::project",
        ),
        tests=("tests/framework/simulate/test_simulate.py",),
        graphs=("theorem_1", "theorem_4"),
    ),
    Row("Remarks 3, 4", NOT_GIVEN),
    Row("Remark 5", "a K_c that makes M_bar positive", ("pid_inverse",)),
    Row("Remarks after 5", NOT_GIVEN),
    Row(
        "Section V",
        "the experiment and the kinematic controller that it is compared with",
        ("task_tracking", "kinematic_command", "circle"),
        ("docs/study/section_v.py",),
        ("tests/blocks/test_section_v.py",),
        ("ur10_fast", "ur10_slow"),
    ),
)


def block_types() -> list[str]:
    """Every packaged block, by the name of its file."""
    return sorted(path.stem for path in BLOCKS.glob("*.py") if not path.stem.startswith("_"))


def citations(block: str) -> set[int]:
    """The equation numbers of the paper that a block's page cites."""
    text = (BLOCKS / f"{block}.py").read_text(encoding="utf-8")
    page = re.search(r"\[WangTAC2020\]_ (.*?)\n *\"\"\"", text, re.DOTALL)
    return numbers(page[1]) if page else set()


def numbers(text: str) -> set[int]:
    """``(5), (8)-(10)`` -> 5, 8, 9, 10."""
    found = set[int]()
    for first, last in re.findall(r"\((\d+)\)(?:\s*-\s*\((\d+)\))?", text):
        found |= set(range(int(first), int(last or first) + 1))
    return found


def graphs_of(blocks: Sequence[str]) -> list[str]:
    """Packaged graphs that hold all these blocks; where none does, those that hold the first."""
    used = {
        path.stem: set(re.findall(r"type: (\w+)", path.read_text(encoding="utf-8"))) for path in GRAPHS.glob("*.yaml")
    }
    for wanted in (set(blocks), set(blocks[:1])):
        found = sorted((name for name, types in used.items() if wanted <= types), key=_rank)
        if found:
            return found[:2]
    return []


def _rank(name: str) -> tuple[bool, bool, str]:
    return not name.startswith("theorem"), not re.search(r"_(tracking|regulation)_", name), name


def tests_of(row: Row) -> list[str]:
    """For a theorem, tests that name its graph; else for each block a test that names it, first a known answer."""
    if row.graphs:
        return [test for test, texts in _tests().items() if "theorem" in test and row.graphs[0] in texts][:2]
    return list(dict.fromkeys(test for block in row.blocks if (test := _test_of(block))))


def _test_of(block: str) -> str:
    named = [test for test, texts in _tests().items() if any(re.search(rf"\b{block}\b", text) for text in texts)]
    return min(named, key=lambda test: not test.startswith(KNOWN_ANSWERS), default="")


_FOUND = dict[str, list[str]]()


def _tests() -> Mapping[str, list[str]]:
    """Each test of `tests/blocks`, as ``path::name``, with the texts in its body."""
    if not _FOUND:
        for path in sorted(TESTS.joinpath("blocks").glob("test_*.py")):
            for node in ast.parse(path.read_text(encoding="utf-8")).body:
                if isinstance(node, ast.FunctionDef) and node.name.startswith("test_"):
                    texts = [part.value for part in ast.walk(node) if isinstance(part, ast.Constant)]
                    _FOUND[f"{path.relative_to(ROOT).as_posix()}::{node.name}"] = [
                        t for t in texts if isinstance(t, str)
                    ]
    return _FOUND


def _link(target: str) -> str:
    path, _, name = target.partition("::")
    shown = name or path.rpartition("/")[2]
    return f"[`{shown}`](../{path})" if not path.startswith("docs/") else f"[`{shown}`]({path.removeprefix('docs/')})"


def lines() -> Iterator[str]:
    """The table."""
    yield "| number | what it says | block or file | test | graph |"
    yield "|---|---|---|---|---|"
    for row in ROWS:
        where = [_link(f"blocks/dmframe_blocks/{block}.py::{block}") for block in row.blocks]
        where += [_link(file) for file in row.files]
        tests = [_link(test) for test in row.tests or tests_of(row)]
        graphs = [f"`{name}`" for name in row.graphs or (graphs_of(row.blocks) if row.blocks else [])]
        missing = "-" if row.says == NOT_GIVEN else "none yet"
        cells = [", ".join(cell) or missing for cell in (where, tests, graphs)]
        yield "| " + " | ".join([row.what, row.says, *cells]) + " |"


def fill(page: str) -> str:
    """The page with its table put in."""
    before, _, rest = page.partition(BEGIN)
    return "\n".join([before + BEGIN, *lines(), END]) + rest.partition(END)[2]


if __name__ == "__main__":
    PAGE.write_text(fill(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
