"""Numbers with an exponent, as a page prints them: 1.65e-05 as 1.65·10⁻⁵."""

from __future__ import annotations

import re
from typing import Final

_NUMBER: Final = re.compile(r"(?<![\w.])(\d(?:\.\d+)?)e([+-])0*(\d+)(?!\w)")
_RAISED: Final = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def typeset(text: str) -> str:
    """The text with the exponents of Python's formats ``g`` and ``e`` as powers of ten.

    >>> typeset("at most 1.65e-05, 1e+04")
    'at most 1.65·10⁻⁵, 10⁴'
    """
    return _NUMBER.sub(_power, text)


def _power(found: re.Match[str]) -> str:
    digits, sign, exponent = found.groups()
    power = f"10{(sign.removeprefix('+') + exponent).translate(_RAISED)}"
    return power if digits == "1" else f"{digits}·{power}"
