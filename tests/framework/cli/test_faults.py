"""A wrong call: status 2, one line for each fault on standard error, nothing on standard output."""

from __future__ import annotations

import errno
import os
from pathlib import Path
from typing import Any

import pytest

from dmframe.robot.library import robots

LISTED = "`dmframe graphs` lists the packaged ones, and the name of a file ends in .yaml"
RUN = ("run", "pendulum", "--no-plots")

FAULTS = {
    "unknown graph": (("run", "nosuch"), f"dmframe: nosuch: unknown graph; {LISTED}\n"),
    "near miss": (("check", "ur10_fst"), "dmframe: ur10_fst: unknown graph; did you mean ur10_fast?\n"),
    "new of an unknown": (("new", "pendulm"), "dmframe: pendulm: unknown graph; did you mean pendulum?\n"),
    "draw of an unknown": (("draw", "pendulm"), "dmframe: pendulm: unknown graph; did you mean pendulum?\n"),
    "ending of a drawing": (
        ("draw", "pendulum", "-o", "a.gif"),
        "dmframe: a.gif: expected the extension .svg, .png, .pdf, .mmd, found .gif\n",
    ),
    "no ending of a drawing": (
        ("draw", "pendulum", "-o", "a"),
        "dmframe: a: expected the extension .svg, .png, .pdf, .mmd, found no extension\n",
    ),
    "folder of a drawing": (
        ("draw", "pendulum", "-o", "no/a.svg"),
        "dmframe: no/a.svg: the folder no does not exist; create it first, or choose another\n",
    ),
    "unknown block": (
        ("blocks", "pid_invers"),
        "dmframe: blocks: pid_invers: unknown block type; did you mean pid_inverse?\n",
    ),
    "unknown block file": (
        ("blocks", "my.py:Mine"),
        "dmframe: blocks: the file my.py does not exist; its path is relative to the graph's folder\n",
    ),
    "unknown robot": (
        ("regressor", "ur11"),
        f"dmframe: robot ur11: unknown robot; choose from {', '.join(robots())}\n",
    ),
    "unknown friction": (
        ("regressor", "arm2", "--friction", "sticky"),
        "dmframe: friction sticky: unknown kind of friction; choose from coulomb, rotor, viscous\n",
    ),
    "hold without an angle": (
        ("regressor", "arm2", "--hold", "joint2"),
        "dmframe: --hold joint2: expected joint=angle, for example wrist_2_joint='-90 deg'\n",
    ),
    "hold at a length": (
        ("regressor", "arm2", "--hold", "joint2=3 m"),
        "dmframe: robot arm2: hold: joint joint2 is revolute: expected an angle, as 30 deg; found 3 m\n",
    ),
    "hold of an unknown joint": (
        ("regressor", "arm2", "--hold", "jint2=3 deg"),
        "dmframe: robot arm2: hold: jint2: unknown joint; did you mean joint2?\n",
    ),
    "until now": ((*RUN, "--until", "0"), "dmframe: --until 0: expected a time above zero\n"),
    "until before": ((*RUN, "--until=-1 s"), "dmframe: --until -1 s: expected a time above zero\n"),
    "until no number": (
        (*RUN, "--until", "abc"),
        "dmframe: --until abc: expected a quantity in s, found 'abc': begin with a number\n",
    ),
    "until a length": (
        (*RUN, "--until", "2 m"),
        "dmframe: --until 2 m: expected a quantity in s, found '2 m': m cannot be converted to s\n",
    ),
    "until for ever": (
        (*RUN, "--until", "inf"),
        "dmframe: --until inf: expected a quantity in s, found 'inf': the number must be finite\n",
    ),
    "until with a line between digits": (
        (*RUN, "--until", "1_0"),
        "dmframe: --until 1_0: expected a quantity in s, found '1_0': cannot read '_0' as a unit",
    ),
    "until in other digits": (
        (*RUN, "--until", "\N{ARABIC-INDIC DIGIT THREE}"),
        "found '\N{ARABIC-INDIC DIGIT THREE}': begin with a number\n",
    ),
    "a seed that is no number": (
        ("verify", "pendulum", "--seed", "1_0"),
        "dmframe: --seed 1_0: expected a whole number\n",
    ),
    "a tube without rank": (
        ("analyse", "pendulum", "--tube", "3"),
        "dmframe: --tube: it has no effect without --rank; add that\n",
    ),
    "the least without rank": (
        ("analyse", "pendulum", "--least", "1"),
        "dmframe: --least: it has no effect without --rank; add that\n",
    ),
    "a horizon with rank": (
        ("analyse", "theorem_3", "--rank", "--horizon", "nan"),
        "dmframe: --until: it has no effect with --rank; leave one out\n",
    ),
    "a horizon that is no number": (
        ("analyse", "pendulum", "--horizon", "nan"),
        "dmframe: --until nan: expected a quantity in s, found 'nan': the number must be finite\n",
    ),
    "a tube that is no number": (
        ("analyse", "theorem_3", "--rank", "--tube", "nan"),
        "dmframe: --tube nan: expected a quantity in rad, found 'nan': the number must be finite\n",
    ),
    "boxes that are no number": (
        ("analyse", "theorem_3", "--rank", "--boxes", "1e3"),
        "dmframe: --boxes 1e3: expected a whole number\n",
    ),
    "base parameters of kinematics": (
        ("regressor", "arm2", "--kinematic", "--base"),
        "dmframe: --base: it has no effect with --kinematic; leave one out\n",
    ),
    "a joint held twice": (
        ("regressor", "arm2", "--hold", "joint2=1", "--hold", "joint2=2"),
        "dmframe: --hold joint2=2: joint2 is given twice; keep one of them\n",
    ),
    "two texts in one file": (
        ("regressor", "arm2", "--c", "x.c", "--python", "./x.c"),
        "dmframe: x.c: two files have this name; rename one\n",
    ),
    "code in a folder that is not there": (
        ("regressor", "arm2", "--c", "no/x.c"),
        "dmframe: no/x.c: the folder no does not exist; create it first, or choose another\n",
    ),
    "a name too long": (("run", "a" * 300), f"dmframe: {'a' * 300}: unknown graph; {LISTED}"),
    "set without a value": ((*RUN, "--set", "foo"), "dmframe: --set foo: expected block.parameter=value"),
    "set of an unknown block": (
        (*RUN, "--set", "taks.alpha=1"),
        "dmframe: --set taks.alpha=1: unknown block or key; did you mean task?\n",
    ),
    "set in one of two": (
        ("run", "arm2_joint", "pendulum", "--set", "path.times=[0, 1]"),
        ": blocks.path.times: unknown parameter of sinusoid; choose from amplitude, center, phase, rate\n",
    ),
    "set of a parameter without its block": (
        (*RUN, "--set", "alpha_bar=1"),
        "dmframe: --set alpha_bar=1: unknown block or key; choose from task.alpha_bar\n",
    ),
    "set of a block that one of two lacks": (
        ("run", "ur10_fast", "ur10_fast_kinematic", "--set", "dynamics.Gamma=3"),
        "dmframe: ur10_fast_kinematic: --set dynamics.Gamma=3: unknown block or key; choose from arm, ",
    ),
    "set to a bad value": (
        (*RUN, "--set", "task.alpha_bar=-1"),
        ": blocks.task.alpha_bar: expected a number > 0, found -1\n",
    ),
}


@pytest.mark.parametrize("case", FAULTS)
def test_a_bad_call_gives_status_2_and_states_what_is_right(case: str, dmframe: Any, tmp_path: Path) -> None:
    words, text = FAULTS[case]
    reported = dmframe(*words)
    assert reported.status == 2
    assert reported.out == ""
    assert text in reported.err
    assert reported.err.startswith("dmframe: ")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "words", [("nosuch",), ("run",), ("run", "pendulum", "--nosuch"), ("new",), ("check", "a", "b")]
)
def test_a_call_outside_the_grammar_gives_status_2_and_the_way_to_help(words: tuple[str, ...], dmframe: Any) -> None:
    reported = dmframe(*words)
    assert reported.status == 2
    assert reported.out == ""
    assert reported.err.startswith("Usage: ")
    assert "-h" in reported.err


def test_faults_of_a_graph_come_one_a_line_with_their_place(dmframe: Any, tmp_path: Path) -> None:
    tmp_path.joinpath("bad.yaml").write_text(
        "dmframe: 1\nclock: 4 ms\nduration: 1 m\nblocks:\n  arm: {type: manipulater}\n", encoding="utf-8"
    )
    reported = dmframe("check", "bad.yaml")
    assert reported.status == 2
    assert reported.err.splitlines() == [
        "dmframe: bad.yaml:3:11: duration: expected a quantity in s, found '1 m': m cannot be converted to s",
        "dmframe: bad.yaml:5:15: blocks.arm.type: manipulater: unknown block type; did you mean manipulator?",
    ]


def test_a_defect_of_a_users_block_is_reported_in_one_line(dmframe: Any, tmp_path: Path) -> None:
    tmp_path.joinpath("odd.py").write_text(
        "from dmframe.block import AbstractBlock, Equations\n"
        "class Odd(AbstractBlock):\n"
        '    """Divides by zero."""\n'
        "    def equations(self, u, x, p):\n"
        "        return Equations(outputs={'a': 1 / 0})\n",
        encoding="utf-8",
    )
    tmp_path.joinpath("odd.yaml").write_text(
        'dmframe: 1\nclock: 4 ms\nduration: 1 s\nblocks:\n  odd: {type: "odd.py:Odd"}\n', encoding="utf-8"
    )
    reported = dmframe("check", "odd.yaml")
    assert reported.status == 2
    assert reported.out == ""
    assert len(reported.err.splitlines()) == 1
    assert "ZeroDivisionError: division by zero" in reported.err


MOMENTS = {"import": "{}", "making": "def __init__(self): {}", "equations": "def equations(self, u, x, p): {}"}


@pytest.mark.parametrize("moment", ["import", "making", "equations"])
@pytest.mark.parametrize("fault", ["SystemExit(0)", "GeneratorExit", "BrokenPipeError"])
def test_a_users_block_cannot_end_the_program_as_if_all_were_well(
    moment: str, fault: str, dmframe: Any, tmp_path: Path
) -> None:
    body = "\n    ".join(MOMENTS[each].format("pass" if each != moment else f"raise {fault}") for each in MOMENTS)
    tmp_path.joinpath("odd.py").write_text(
        f"from dmframe.block import AbstractBlock\nclass Odd(AbstractBlock):\n    {body}\n", encoding="utf-8"
    )
    tmp_path.joinpath("odd.yaml").write_text(
        'dmframe: 1\nclock: 4 ms\nduration: 1 s\nblocks:\n  odd: {type: "odd.py:Odd"}\n', encoding="utf-8"
    )
    for words in (("check", "odd.yaml"), ("verify", "odd.yaml", "--report", "r.md")):
        reported = dmframe(*words)
        assert (reported.status, reported.out) == (2, "")
        assert len(reported.err.splitlines()) == 1
        assert fault.removesuffix("(0)") in reported.err
        assert "odd.py:" in reported.err


def test_a_certificate_that_ends_the_program_proves_nothing(dmframe: Any, tmp_path: Path) -> None:
    tmp_path.joinpath("odd.py").write_text(
        "from dmframe.block import AbstractBlock, Equations\n"
        "class Odd(AbstractBlock):\n"
        '    """Ends."""\n'
        "    def equations(self, u, x, p):\n"
        "        return Equations()\n"
        "    def certificate(self, u, x, p, truth):\n"
        "        raise SystemExit(0)\n",
        encoding="utf-8",
    )
    tmp_path.joinpath("odd.yaml").write_text(
        'dmframe: 1\nclock: 4 ms\nduration: 1 s\nblocks:\n  odd: {type: "odd.py:Odd"}\n', encoding="utf-8"
    )
    reported = dmframe("verify", "odd.yaml")
    assert reported.status == 1
    assert "odd: certificate(), odd.py:7: SystemExit: 0" in reported.out


def test_a_file_that_cannot_be_read_is_named(dmframe: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Root can read everything, so a system call is replaced to refuse."""

    def refuse(path: object, *_: Any, **__: Any) -> None:
        raise PermissionError(errno.EACCES, "Permission denied", str(path))

    really = os.open
    monkeypatch.setattr(os, "open", lambda path, *a, **k: (refuse if "my.py" in str(path) else really)(path, *a, **k))
    assert dmframe("blocks", "my.py:Mine").err == "dmframe: blocks: my.py cannot be read: permission denied\n"
    monkeypatch.setattr("dmframe.robot.library.load", refuse)
    assert dmframe("regressor", "arm.urdf").err == "dmframe: arm.urdf: cannot be read: permission denied\n"
