"""Exports with hostile names: the output compiles and parses, or is refused with a clear error."""

from __future__ import annotations

import copy
import shutil
import subprocess
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import casadi as ca
import pytest
from ruamel.yaml import YAML

import dmframe as dm
from dmframe.common.errors import DmframeError
from dmframe.export import c, fmu, ros2
from dmframe.export.folder import export
from dmframe.export.program import Member, Program, members, own_name, program_of
from dmframe.export.robot import robot_of

CC, CXX = shutil.which("gcc"), shutil.which("g++")
pytestmark = pytest.mark.skipif(CC is None or CXX is None, reason="needs gcc and g++")
STAND_INS = Path(__file__).parent / "ros2"
STRICT = ("-Wall", "-Wextra", "-pedantic", "-Werror", "-fsyntax-only")
GRAPH = "arm2_joint"
NAMES = (
    "DM_PERIOD DM_FILE DM_JOINTS DM_NAMED DM_OTHER dm_z main sin memcpy NULL EOF INFINITY M_PI __LINE__ int class "
    "pthread stdio sched endian errno alloca 1e3 true ../../x .. %s%n ${xy} $(rm) CMAKE_C_FLAGS C all test joints"
).split()
NAMES += [
    'quote"s',
    "it's",
    "new\nline",
    "tab\there",
    "é",
    "你好",
    "a b",
    "*/ int x; /*",
    "--><",
    "x" * 200,
    "-",
    "Δ",
    "\u202eevil",
]
TITLES = [
    "*/ int x; /*",
    "// \\",
    "-->",
    "]]>",
    "DM_FILE DM_JOINTS DM_TITLE",
    "??/",
    "%s %n",
    "${x}",
    '"quoted"',
    "a: b #c",
    "é 你好",
]
LABELS = [
    "M.PI",
    "E.OF",
    "INT.MAX",
    "FP.NAN",
    "DM.Z",
    "st.atime",
    "and.eq",
    "math.errhandling",
    "NULL.x",
    "a.q",
    "A.q",
    "a.q_2",
]
JOINTS = ["true", "1e3", "a: b", "${a}", 'q"', "back\\slash", "??/", "é", "new\nline", "*/", "DM_PERIOD"]
HEADERS = "cmath vector string limits.h float.h math.h signal.h sys/stat.h iso646.h netdb.h sched.h pthread.h".split()


@cache
def loaded() -> dm.Graph:
    return dm.load(GRAPH)


@cache
def program() -> Program:
    return program_of(loaded())


def checked(words: list[str], cwd: Path) -> None:
    done = subprocess.run(words, cwd=cwd, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[:3000]


def compile_all(found: list[Program], folder: Path) -> None:
    """Write sources, headers and examples; compile them as C99, and the headers as C++ after many others."""
    places = list[str]()
    for k, each in enumerate(found):
        place, still = folder / str(k), ", ".join(f"{{{', '.join(['0'] * item.size)}}}" for item in each.measured)
        place.mkdir()
        (place / f"{each.name}.c").write_text(c.source(each), encoding="utf-8")
        (place / f"{each.name}.h").write_text(c.header(each), encoding="utf-8")
        (place / "example.c").write_text(c._called("example.c", each, DM_STILL=still), encoding="utf-8")
        checked([str(CC), "-std=c99", *STRICT, "-I.", f"./{each.name}.c", "example.c"], place)
        places.append(f'#include "{k}/{each.name}.h"\n')
    late = "".join(f"#include <{header}>\n" for header in HEADERS)
    (folder / "late.cpp").write_text(late + "".join(places), encoding="utf-8")
    checked([str(CXX), "-std=c++17", "-w", "-fsyntax-only", "late.cpp"], folder)


def words_of(names: list[str]) -> dict[str, str]:
    """Name -> word of a program, for those that have one."""
    found = dict[str, str]()
    for name in names:
        try:
            found[name] = own_name(name)
        except DmframeError as error:
            assert "expected a name with a letter or digit" in error.text  # noqa: PT017
    assert len(set(found.values())) == len(found)
    assert all(word.isascii() and word.isidentifier() for word in found.values())
    return found


@pytest.mark.parametrize("every", [8, 1])
def test_names_of_graphs(every: int, tmp_path: Path) -> None:
    words = words_of(NAMES)
    assert set(NAMES) - set(words) == {"..", "-", "--><"}
    compile_all([replace(program(), name=word, title=name) for name, word in [*words.items()][::every]], tmp_path)


def test_titles(tmp_path: Path) -> None:
    compile_all([replace(program(), name=f"p{k}", title=title) for k, title in enumerate(TITLES)], tmp_path)


KINDS = ("measured", "commanded", "states", "parameters")


def labelled(labels: list[str], name: str = "law", kinds: tuple[str, ...] = KINDS) -> Program:
    """The program with these labels for its members of these kinds, as many as there are."""

    def renamed(items: tuple[Member, ...]) -> tuple[Member, ...]:
        given = [*labels, *[item.label for item in items]][: len(items)]
        made = members((label, ca.SX.sym("x", item.size), "") for label, item in zip(given, items, strict=True))
        return tuple(replace(item, label=one.label, word=one.word) for item, one in zip(items, made, strict=True))

    found = program()
    return replace(found, name=name, **{key: renamed(getattr(found, key)) for key in kinds})


def test_labels_of_signals_states_and_parameters(tmp_path: Path) -> None:
    groups = [*([label] for label in LABELS), ["a.b_c", "a_b.c", "A.B_C"]]
    compile_all([labelled(labels, f"p{k}") for k, labels in enumerate(groups)], tmp_path)


def package(found: Program, joints: list[str], folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Write a package of a program, for joints with these names, without its C; check its XML and YAML."""
    graph = copy.copy(loaded())
    monkeypatch.setattr(ros2, "program_of", lambda *_: found)
    texts = {**dict.fromkeys((f"{found.name}.c", "replay.c", "samples.h"), ""), f"{found.name}.h": c.header(found)}
    monkeypatch.setattr(ros2, "files_of", lambda *_: texts)
    diagram: Any = loaded().diagram
    if joints:
        robot = SimpleNamespace(joint_names=tuple(joints))
        diagram = SimpleNamespace(
            loop=diagram.loop,
            blocks=diagram.blocks,
            ways=diagram.ways,
            robot=robot,
            resolver=diagram.resolver,
            fingerprint=diagram.fingerprint,
        )
    vars(graph)["diagram"] = diagram
    export(graph, folder, "ros2")
    for name in ("package.xml", "controller.xml"):
        ElementTree.parse(folder / name)
    read = YAML(typ="safe").load((folder / "config" / "controllers.yaml").read_text(encoding="utf-8"))
    (names,) = (part["ros__parameters"]["joints"] for part in read.values() if "joints" in part["ros__parameters"])
    assert not joints or names == joints
    return folder


@pytest.mark.parametrize("every", [8, 1])
def test_packages(every: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    words = words_of(NAMES)
    given = [(replace(program(), name=word, title=name), list[str]()) for name, word in words.items()]
    given += [(replace(program(), name=f"t{k}", title=title), []) for k, title in enumerate(TITLES)]
    given += [(replace(program(), name=f"j{k}"), [joint, "other"]) for k, joint in enumerate(JOINTS)]
    given = given[::every]
    given += [(labelled(["interfaces.position"], "own", ("parameters",)), [])]
    folders, refused = list[Path](), set[str]()
    for k, (found, joints) in enumerate(given):
        try:
            folders.append(package(found, joints, tmp_path / str(k), monkeypatch))
        except DmframeError as error:
            assert "expected a title of printable" in error.text or "reads back" in error.text  # noqa: PT017
            refused.add(found.title if not joints else joints[0])
    assert len(refused) <= 2, refused
    assert '{"interfaces.position_2", ' in (folders[-1] / "src" / "controller.cpp").read_text()
    lines = [
        f'#define created_controller made_{k}\n#include "{each}/src/controller.cpp"\n' for k, each in enumerate(folders)
    ]
    (tmp_path / "all.cpp").write_text("#undef created_controller\n".join(lines))
    words_of_gcc = ["-std=c++17", "-fsyntax-only", "-Wall", "-Wextra", "-Werror", f"-I{STAND_INS / 'ros'}"]
    own = [f"-I{folder / room}" for folder in folders for room in ("include", "src")]
    checked([str(CXX), *words_of_gcc, f"-I{STAND_INS / 'control'}", *own, "all.cpp"], tmp_path)


@pytest.mark.parametrize("every", [8, 1])
def test_fmus(every: int, tmp_path: Path) -> None:
    sources, made = list[str](), labelled(["M.PI", "st.atime"])
    names = {**words_of(NAMES), **{title: f"t{k}" for k, title in enumerate(TITLES)}}
    for k, (name, word) in enumerate([*names.items()][::every]):
        unit = fmu._of_controller(replace(made, name=word, title=name))
        for fmi in fmu._TEXTS:
            described = fmu.described(unit, fmi, "token")  # type: ignore[arg-type]
            assert ElementTree.fromstring(described.encode()).get("modelName") == word
            sources.append(f"unit{k}_{fmi}.c")
            (tmp_path / sources[-1]).write_text(fmu.code(unit, fmi, "token"), encoding="utf-8")  # type: ignore[arg-type]
    checked([str(CC), "-std=c99", *STRICT, *sources], tmp_path)


def test_an_fmu_of_a_robot(tmp_path: Path) -> None:
    robot = replace(robot_of(loaded()), title="*/ DM_FILE")
    for fmi in fmu._TEXTS:
        unit = fmu._of_robot(robot, "model")
        (tmp_path / "unit.c").write_text(fmu.code(unit, fmi, "token"), encoding="utf-8")  # type: ignore[arg-type]
        checked([str(CC), "-std=c99", *STRICT, "unit.c"], tmp_path)
