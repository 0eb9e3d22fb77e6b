"""Text of a block's docstring: summary, parameters, notes. Its equations come from its code, see `dmframe.formula`."""

from __future__ import annotations

import inspect
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, final

from dmframe.block.adapting import option_descriptions
from dmframe.block.base import AbstractBlock

_SECTION: Final = re.compile(r"^([A-Z][A-Za-z ]+)\n-{3,}$", re.MULTILINE)


@final
@dataclass(frozen=True)
class About:
    """Text of a block's docstring.

    Parameters
    ----------
    summary
        Its first sentence.
    parameters
        Description of each parameter, as marked text.
    notes, source
        Marked text.
    """

    summary: str
    parameters: Mapping[str, str] = field(default_factory=dict)
    notes: str = ""
    source: str = ""


def about(block: type[AbstractBlock]) -> About:
    """Read a block's docstring; sections that it does not have are empty."""
    text = inspect.cleandoc(block.__doc__ or "")
    pieces = _SECTION.split(text)
    sections = dict(zip(pieces[1::2], pieces[2::2], strict=True))
    return About(
        summary=prose(pieces[0].partition("\n\n")[0]),
        parameters=_ordered(block, option_descriptions(block) | _parameters(sections.get("Parameters", ""))),
        notes=prose(sections.get("Notes", "")),
        source=prose(sections.get("References", "")),
    )


def _ordered(block: type[AbstractBlock], described: Mapping[str, str]) -> dict[str, str]:
    """Descriptions in the order of the block's parameters; those of other names come last."""
    order = dict.fromkeys((*block.model_fields, *described))
    return {name: described[name] for name in order if name in described}


def prose(text: str) -> str:
    """Marked text from the reStructuredText of docstrings."""
    text = re.sub(r":math:`([^`]*)`", lambda found: f"${' '.join(found[1].split())}$", text)
    text = re.sub(r"``([^`]*)``", r"`\1`", text)
    text = re.sub(r"\[(\w+)\]_", r"[\1]", text)
    return " ".join(text.split())


def _parameters(text: str) -> dict[str, str]:
    """``{"Gamma": "Adaptation gain. ..."}``; a line may name several."""
    found = dict[str, str]()
    for names, _, described in re.findall(r"^(\w+(?:, \w+)*) : ([^\n]*)\n((?:[ \t]+\S.*\n?)+)", text, re.MULTILINE):
        for name in names.split(", "):
            found[name] = prose(described)
    return found
