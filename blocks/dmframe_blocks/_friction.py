"""Conditions that a controller has regressor columns for the friction and the rotors of the plant."""

from __future__ import annotations

import re
from collections.abc import Collection
from typing import Final

import casadi as ca

from dmframe.block import SX, Condition, Inequality, Signals
from dmframe.robot.parameters import Friction

_KINDS: Final = (
    ("viscous", "viscous friction", "B"),
    ("coulomb", "Coulomb friction", "D"),
    ("rotor", "rotor inertia", "I_r"),
)


def columns_for(friction: Collection[Friction], truth: Signals, *, rotor: bool = False) -> tuple[Condition, ...]:
    """Conditions that there is a column for each kind of friction of the plant, and for its rotors."""
    having = {*friction, *(("rotor",) if rotor else ())}
    lacking = [kind for kind in _KINDS if kind[0] not in having and kind[2] in truth]
    return tuple(_column_for(key, name, getattr(truth, of)) for key, name, of in lacking)


def _column_for(key: str, name: str, true: SX) -> Inequality:
    """The condition that the plant has no such friction, for a regressor without a column for it."""
    owners = ", ".join(dict.fromkeys(re.sub(r"(_\d+)?$", "", str(symbol)) for symbol in ca.symvar(true)))
    return Inequality(
        f"the plant has no {name}: {owners} is zero",
        -true * true,
        "eq. (5)",
        strict=False,
        otherwise=f"the plant has {name} ({owners}), and the regressor has no column for it: "
        + ("set rotors: true in a regressor" if key == "rotor" else f"add {key} to friction"),
    )
