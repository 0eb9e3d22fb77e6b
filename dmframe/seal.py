"""JSON files with a digest of their own content: one that was damaged or edited is noticed."""

from __future__ import annotations

import hashlib
import json
from typing import Any, Final

from dmframe.files import encoded

SEAL: Final = "seal"
"""The key that holds the digest of all others."""


class BrokenSeal(ValueError):
    """A text that `sealed` did not write."""


def digest(content: bytes) -> str:
    """SHA-256 in hexadecimal digits."""
    return hashlib.sha256(content).hexdigest()


def sealed(data: dict[str, Any]) -> str:
    """The data as JSON with a digest of them. It protects against accidents and slips, not against intent."""
    return _text({**data, SEAL: digest(encoded(_text(data)))})


def opened(content: bytes) -> dict[str, Any]:
    """The data of `sealed`. Raises `BrokenSeal` where one bit of the text is another."""
    try:
        data = json.loads(content.decode("utf-8"))
    except ValueError:
        raise BrokenSeal("no JSON") from None
    if not isinstance(data, dict) or SEAL not in data:
        raise BrokenSeal("no seal")
    data.pop(SEAL)
    if encoded(sealed(data)) != content:  # spaces and the order of keys count too
        raise BrokenSeal("the digest is another")
    return data


def _text(data: dict[str, Any]) -> str:
    return json.dumps(data, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
