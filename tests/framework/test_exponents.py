"""Exponents on pages, which are powers of ten, and code, which stays as it is."""

from __future__ import annotations

import pytest

from dmframe.common.exponents import typeset
from dmframe.report.html import cell
from dmframe.report.parts import Marked, Word


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        (f"by {1.65e-5:.3g}", "by 1.65·10⁻⁵"),
        (f"{1e-5:.3g} and {-4e120:g}", "10⁻⁵ and -4·10¹²⁰"),
        (f"{8e4:.1e}", "8.0·10⁴"),
        ("1e5, model 4e-07f, x1e-05, 12e-05", "1e5, model 4e-07f, x1e-05, 12e-05"),
    ],
)
def test_exponents_are_powers_of_ten(text: str, shown: str) -> None:
    assert typeset(text) == shown


def test_a_page_typesets_prose_and_leaves_code() -> None:
    assert cell("1e-05 s") == "10⁻⁵ s"
    assert cell(Marked("1e-05 s, `tolerance: 1e-09`")) == "10⁻⁵ s, <code>tolerance: 1e-09</code>"
    assert cell(Word("--set tolerance=1e-09", "command")) == '<code class="command">--set tolerance=1e-09</code>'
    assert cell(Word("1e-05", "strong")) == "<strong>10⁻⁵</strong>"
