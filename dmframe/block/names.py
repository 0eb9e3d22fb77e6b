"""Names of a block's class and of its parts."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dmframe.block.base import AbstractBlock


def type_name(block: type[AbstractBlock]) -> str:
    """The name in graph files: snake_case of the class, ``PidInverse`` and ``PIDInverse`` -> ``pid_inverse``."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "_", block.__name__).lower()


def names_of(block: type[AbstractBlock]) -> list[str]:
    """Names of a block's parameters, states and ports."""
    ports, states = (*block.inputs, *block.outputs), block.states
    return [*block.model_fields, *(port.name for port in ports), *(state.name for state in states)]
