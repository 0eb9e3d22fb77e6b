"""Names in modelDescription.xml, for names with any characters."""

from __future__ import annotations

from xml.etree import ElementTree

import pytest

from dmframe.common.errors import EngineError
from dmframe.export.fmu import Unit, Version, described
from dmframe.export.program import Member

HOSTILE = ["${a}", "true", "1e3", "a: b", '"', "'", "<x>", "ünï &amp; ]]>", "tab\tline\n", " ", "", "long" * 3000]


def named(label: str, about: str) -> Unit:
    """A unit of one number and of two."""
    one, two = (Member(label, "word", size, "", (0.5,) * size) for size in (1, 2))
    return Unit("unit", about, 0.01, (one,), (), (two,), (), (), 0, "controller.c", shows=False)


@pytest.mark.parametrize("name", HOSTILE)
@pytest.mark.parametrize("fmi", [2, 3])
def test_names_of_a_description_read_back_as_they_are(fmi: Version, name: str) -> None:
    root = ElementTree.fromstring(described(named(name, name), fmi, "token").encode())
    found = [item.get("name") for item in root.iter("ScalarVariable" if fmi == 2 else "Float64")]
    assert [each for each in found if each != "time"] == [name, *([f"{name}[1]", f"{name}[2]"] if fmi == 2 else [name])]
    assert root.get("description") == name


@pytest.mark.parametrize("name", ["bell\a", "\ud800", "null\0"])
@pytest.mark.parametrize("fmi", [2, 3])
def test_a_name_that_no_xml_can_hold_is_refused(fmi: Version, name: str) -> None:
    with pytest.raises(EngineError, match=r"unit: modelDescription\.xml is not recovered by a parser"):
        described(named(name, "about"), fmi, "token")
