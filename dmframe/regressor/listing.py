"""Table of base parameters as text."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction

from dmframe.regressor.base_parameters import BaseParameters
from dmframe.robot.chain import SerialChain


def listing(chain: SerialChain, base: BaseParameters) -> str:
    """Table of base parameters: number, value in the robot's model, and linear combination.

    Values are in kg, kg m and kg m^2; friction and rotors, which the model lacks, show a dash. Below the table are the
    lengths in the combinations, and the parameters that do not affect any motion.
    """
    values = base.parameters.values
    rows = [
        (str(number), _value(row, values), text)
        for number, (row, text) in enumerate(zip(base.grouping, base.symbolic, strict=True), start=1)
    ]
    head = f"{chain.name}: {base.count} base parameters of {len(base.names)}; joints {', '.join(chain.joint_names)}"
    parts = [head, _table([("no.", "value", "parameter"), *rows])]
    if base.translations:
        lengths = "\n".join(f"  {name} = {float(length):.10g} m" for name, length in base.translations)
        parts.append(
            "Translations; p_y3 is the y component of joint 3's position in the frame of joint 2 (1 is nearest the "
            f"base):\n{lengths}"
        )
    if base.unidentifiable:
        parts.append("Not identifiable from any motion: " + ", ".join(base.unidentifiable) + ".")
    return "\n\n".join(parts) + "\n"


def _value(row: Sequence[Fraction], values: Sequence[Fraction | None]) -> str:
    total = Fraction(0)
    for x, value in zip(row, values, strict=True):
        if x and value is None:
            return "-"
        total += x * (value or 0)
    return f"{float(total):.6g}"


def _table(rows: Sequence[tuple[str, str, str]]) -> str:
    widths = [max(len(row[column]) for row in rows) for column in range(2)]
    return "\n".join(f"{row[0]:>{widths[0]}}  {row[1]:>{widths[1]}}  {row[2]}" for row in rows)
