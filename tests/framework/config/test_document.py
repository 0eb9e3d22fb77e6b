"""The YAML reader against YAML 1.2's core schema and hand-counted lines and columns."""

from __future__ import annotations

from pathlib import Path

import pytest

from dmframe.common.errors import DmframeError, DocumentError, Faults, MissingError, ValueFault
from dmframe.config.document import Document, read_document, read_file

GRAPH = """\
dmframe: 1
blocks:
  task: {type: known_tracking, gama: 0.8}
  arm:
    viscous: [5, 5,
      2]
"""


def messages(text: str) -> list[str]:
    with pytest.raises(DmframeError) as caught:
        read_document(text, "g.yaml")
    return str(caught.value).split("\n")


def test_a_graph_becomes_plain_data() -> None:
    document = read_document(GRAPH, "graph.yaml")
    assert isinstance(document, Document)
    assert document.name == "graph.yaml"
    assert document.data == {
        "dmframe": 1,
        "blocks": {"task": {"type": "known_tracking", "gama": 0.8}, "arm": {"viscous": [5, 5, 2]}},
    }


@pytest.mark.parametrize(
    ("path", "key", "place"),
    [
        ((), False, "1:1"),
        (("dmframe",), False, "1:10"),
        (("dmframe",), True, "1:1"),
        (("blocks",), True, "2:1"),
        (("blocks", "task"), False, "3:9"),
        (("blocks", "task", "gama"), True, "3:32"),
        (("blocks", "task", "gama"), False, "3:38"),
        (("blocks", "arm", "viscous", 2), False, "6:7"),
        (("blocks", "arm", "viscous", 2), True, "6:7"),
    ],
)
def test_each_key_and_value_is_located(path: tuple[str | int, ...], key: bool, place: str) -> None:
    assert read_document(GRAPH, "graph.yaml").locate(path, key) == f"graph.yaml:{place}"


@pytest.mark.parametrize(
    ("path", "place"),
    [
        (("blocks", "task", "gamma"), "3:3"),
        (("blocks", "arm", "viscous", 3), "5:5"),
        (("blocks", "arm", "viscous", -1), "5:5"),
        (("blocks", "arm", "viscous", "x"), "5:5"),
        (("dmframe", 0, "x"), "1:1"),
        (("clock",), "1:1"),
    ],
)
def test_what_is_missing_is_located_at_the_key_of_its_nearest_ancestor(path: tuple[str | int, ...], place: str) -> None:
    assert read_document(GRAPH, "graph.yaml").locate(path) == f"graph.yaml:{place}"


@pytest.mark.parametrize(
    ("written", "value"),
    [
        ("3", 3),
        ("-0", 0),
        ("012", 12),
        ("0o17", 15),
        ("0x1F", 31),
        ("0.5", 0.5),
        (".5", 0.5),
        ("1.", 1.0),
        ("1e-3", 1e-3),
        ("+1E3", 1000.0),
        ("true", True),
        ("False", False),
        ("null", None),
        ("~", None),
        ("", None),
        ("on", "on"),
        ("yes", "yes"),
        ("tRUE", "tRUE"),
        ("1_000", "1_000"),
        ("0b1", "0b1"),
        ("1:30", "1:30"),
        ("2026-01-01", "2026-01-01"),
        ("e5", "e5"),
        (".", "."),
        ("90 ms", "90 ms"),
        ("'true'", "true"),
        ('"1"', "1"),
    ],
)
def test_scalars_are_those_of_yaml_1_2(written: str, value: object) -> None:
    found = read_document(f"a: {written}", "g.yaml").data["a"]
    assert found == value
    assert type(found) is type(value)


def test_an_alias_repeats_its_anchor_as_data_of_its_own() -> None:
    document = read_document("a: &x [1, {b: 2}]\nc: *x\n", "g.yaml")
    assert document.data == {"a": [1, {"b": 2}], "c": [1, {"b": 2}]}
    document.data["a"][1]["b"] = 3
    assert document.data["c"] == [1, {"b": 2}]
    assert document.locate(("c", 1, "b")) == "g.yaml:1:15"


@pytest.mark.parametrize(
    ("text", "lines"),
    [
        ("a: 1\nb:\n  a: 1\n  a: 2\n", ["g.yaml:4:3: b.a appears twice, first at g.yaml:3:3; keep one of them"]),
        ("a: 1\r\na: 2\r\n", ["g.yaml:2:1: a appears twice, first at g.yaml:1:1; keep one of them"]),
        ("a:\n\tb: 1\n", ["g.yaml:2:1: a tab indents this line; YAML indents with spaces"]),
        ("a:\n  c: 1\n \tb: 2\nd: e: f", ["g.yaml:3:2: a tab indents this line; YAML indents with spaces"]),
        ("a:\t3\n", ["g.yaml:1:3: a tab is not allowed here; write spaces"]),
        ("a: 1\nb: [1, 2", ["g.yaml:2:4: this list is not closed, or lacks a comma; check its [ ... , ... ]"]),
        ("a: {b: 1\nc: 2", ["g.yaml:1:4: this mapping is not closed, or lacks a comma; check its { ... , ... }"]),
        ("a: 'x\nb: 1\n", ["g.yaml:1:4: this quote is never closed"]),
        ("a: 1\nb\nc: 2\n", ["g.yaml:2:1: expected a colon and a space after this key"]),
        ("a: b: c", ["g.yaml:1:5: a colon is not allowed here; check the indentation, or put the text in quotes"]),
        ("a: - b", ["g.yaml:1:4: a dash is not allowed here; check the indentation, or put the text in quotes"]),
        ("a: 'b' c", ["g.yaml:1:8: this does not match the text before it; check indentation, quotes and brackets"]),
        ("a: @x", ["g.yaml:1:4: a value cannot begin with @; put it in quotes"]),
        ("a: }", ["g.yaml:1:4: expected a value, found }; check the brackets, or put the value in quotes"]),
        (
            "a: [\n {b: 1},\n",
            ["g.yaml:3:1: expected a value, found the end of the text; check the brackets, or put the value in quotes"],
        ),
        ('a: "\\q"', ["g.yaml:1:5: in double quotes a backslash begins an escape; put the text in single quotes"]),
        ("%YAML 2\n---\na: 1", ["g.yaml:1:8: not readable as YAML (expected a digit or '.', but found '\\n')"]),
        ("a: &", ["g.yaml:1:5: expected a name here, found the end of the text; put the text in quotes"]),
        ("", ["g.yaml:1:1: expected a graph, found nothing; a graph begins with dmframe: 1"]),
        ("# only a comment\n", ["g.yaml:1:1: expected a graph, found nothing; a graph begins with dmframe: 1"]),
        (
            "\n- a",
            ["g.yaml:2:1: expected a graph, keys with their values, found a list; a graph begins with dmframe: 1"],
        ),
        (
            "hello",
            [
                "g.yaml:1:1: expected a graph, keys with their values, found the value hello; "
                "a graph begins with dmframe: 1"
            ],
        ),
        ("a: 1\n---\nb: 2\n", ["g.yaml:2:1: a second document begins here; a graph file holds one"]),
        (
            "%YAML 1.1\n---\na: 1",
            ["g.yaml:2:1: directives (%) are not used in a graph; remove the lines that begin with %"],
        ),
        (
            "a: !!python/object:os.system x",
            ["g.yaml:1:4: tags such as !!python/object:os.system are not used in a graph; write the value alone"],
        ),
        ("a: !x [1]", ["g.yaml:1:4: tags such as !x are not used in a graph; write the value alone"]),
        ("<<: {a: 1}", ["g.yaml:1:1: merge keys (<<) are not part of YAML 1.2; write the keys out"]),
        ("1: x", ['g.yaml:1:1: a key is a text, found the value 1; write "1" in quotes']),
        ("? [a]\n: b\n", ["g.yaml:1:3: a key is a text, found a list"]),
        ("a: *b", ["g.yaml:1:4: the alias *b repeats no anchor; there is none to choose from"]),
        ("a: &gain 1\nb: *gian", ["g.yaml:2:4: the alias *gian repeats no anchor; did you mean gain?"]),
        ("a: &x [*x]", ["g.yaml:1:8: the alias *x is inside the value that it repeats; write it out"]),
        ("a: 'x\0y'", ["g.yaml:1:6: expected readable text, found the control character U+0000; remove it"]),
        ("a: 1\nb: \ud800", ["g.yaml:2:4: expected readable text, found the control character U+D800; remove it"]),
        ('a: "x\\ud800y"', ["g.yaml:1:4: expected readable text, found the control character U+D800; remove it"]),
        ('a: ["\\e[31m"]', ["g.yaml:1:5: expected readable text, found the control character U+001B; remove it"]),
        ('"\\a": 1', ["g.yaml:1:1: expected readable text, found the control character U+0007; remove it"]),
        ('a: "\\uffff"', ["g.yaml:1:4: expected readable text, found the control character U+FFFF; remove it"]),
        (
            "a: !%1b[31m x",
            ["g.yaml:1:4: tags such as !\\x1b[31m are not used in a graph; write the value alone"],
        ),
        ("a: " + "[" * 60, ["g.yaml:1:54: nested deeper than 50 levels; a graph needs about four"]),
        ("a: " + "x" * 1_000_000, ["g.yaml: a graph is at most 1 MB; is this the right file?"]),
    ],
)
def test_a_text_that_is_not_a_graph_is_refused_in_plain_words(text: str, lines: list[str]) -> None:
    assert messages(text) == lines
    with pytest.raises(DocumentError):
        read_document(text, "g.yaml")


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("a: .nan", "g.yaml:1:4: a: expected a finite number, found .nan"),
        ("a: {b: [1, -.Inf]}", "g.yaml:1:12: a.b.1: expected a finite number, found -.Inf"),
        ("a: 1e999", "g.yaml:1:4: a: expected a finite number, found 1e999"),
        ("a: " + "9" * 5000, f"g.yaml:1:4: a: expected a finite number, found {'9' * 30}..."),
    ],
)
def test_numbers_that_are_not_finite_are_refused(text: str, line: str) -> None:
    assert messages(text) == [line]
    with pytest.raises(ValueFault):
        read_document(text, "g.yaml")


def test_all_faults_are_reported_at_once() -> None:
    with pytest.raises(Faults) as caught:
        read_document("a: 1\na: !x .nan\nb: {c: 1, c: 2\n", "g.yaml")
    assert str(caught.value).split("\n") == [
        "g.yaml:2:1: a appears twice, first at g.yaml:1:1; keep one of them",
        "g.yaml:2:4: tags such as !x are not used in a graph; write the value alone",
        "g.yaml:2:4: a: expected a finite number, found .nan",
        "g.yaml:3:4: this mapping is not closed, or lacks a comma; check its { ... , ... }",
        "g.yaml:3:11: b.c appears twice, first at g.yaml:3:5; keep one of them",
    ]
    assert caught.value.faults[0].path == ("a",)


def test_aliases_that_multiply_are_stopped() -> None:
    bomb = "a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]\n"
    for level in range(1, 9):
        bomb += f"a{level}: &a{level} [{', '.join([f'*a{level - 1}'] * 10)}]\n"
    assert messages(bomb) == ["g.yaml:5:5: more than 100000 values, aliases written out; shorten the graph"]


def test_a_file_with_too_many_values_is_refused_before_it_is_parsed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dmframe.config.document._Reader.document", None)  # parsing it would take seconds
    for many in ("a: [" + "1, " * 100_001 + "1]", "a: 1\n" * 100_001):
        assert messages(many) == ["g.yaml: more than 100000 values or lines; shorten the graph"]


def test_a_file_is_read_under_the_name_that_the_user_gave(tmp_path: Path) -> None:
    file = tmp_path / "graph.yaml"
    file.write_bytes(b"\xef\xbb\xbf" + GRAPH.encode())
    document = read_file(file)
    assert document.data == read_document(GRAPH, "g").data
    assert document.locate(("dmframe",)) == f"{file}:1:10"


def test_a_missing_file_is_reported_with_the_nearest_name(tmp_path: Path) -> None:
    (tmp_path / "circle.yaml").write_text(GRAPH)
    with pytest.raises(MissingError) as fault:
        read_file(tmp_path / "circel.yaml")
    assert str(fault.value) == f"{tmp_path}/circel.yaml: expected a graph file, found none; did you mean circle.yaml?"
    with pytest.raises(MissingError, match=r"found none; there is none to choose from$"):
        read_file(tmp_path / "no" / "circle.yaml")


def test_a_folder_is_no_graph(tmp_path: Path) -> None:
    with pytest.raises(DocumentError) as fault:
        read_file(tmp_path)
    assert str(fault.value) == f"{tmp_path}: expected a graph file, found a folder; name a file in it"


def test_a_file_that_cannot_be_opened_is_reported_with_the_reason(tmp_path: Path) -> None:
    (tmp_path / "loop.yaml").symlink_to("loop.yaml")
    with pytest.raises(DocumentError) as fault:
        read_file(tmp_path / "loop.yaml")
    assert str(fault.value) == f"{tmp_path}/loop.yaml: cannot read this file: too many levels of symbolic links"


def test_bytes_that_are_not_utf_8_are_located(tmp_path: Path) -> None:
    file = tmp_path / "g.yaml"
    file.write_bytes("a: 1\nb: é".encode("latin-1"))
    with pytest.raises(DocumentError) as fault:
        read_file(file)
    assert str(fault.value) == f"{file}:2:4: expected text in UTF-8, found the byte 0xe9; save the file as UTF-8"


def test_a_file_over_one_megabyte_is_not_read(tmp_path: Path) -> None:
    file = tmp_path / "g.yaml"
    file.write_bytes(b"#" * 1_000_001)
    with pytest.raises(DocumentError) as fault:
        read_file(file)
    assert str(fault.value) == f"{file}: a graph is at most 1 MB; is this the right file?"


def test_a_robot_file_names_the_command_that_writes_a_graph_of_it(tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text("<robot/>")
    with pytest.raises(DocumentError, match=r"begins with dmframe: 1; `dmframe new` writes a graph of a robot$"):
        read_file(tmp_path / "arm.urdf")
