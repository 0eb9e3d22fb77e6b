"""Dynamic regressor: exact base parameters, readable equations, generated code, proofs."""

from __future__ import annotations

from dmframe.regressor.base_parameters import BaseParameters, base_parameters
from dmframe.regressor.export import (
    SelfTest,
    export_c,
    kinematic_function,
    kinematic_names,
    kinematic_values,
    regressor_function,
    self_test,
    write_c,
)
from dmframe.regressor.listing import listing
from dmframe.regressor.proofs import Proof, prove
from dmframe.regressor.python_source import python_source, write_python
from dmframe.regressor.typeset import WrittenOut, latex, plain_text, write_out
from dmframe.robot.parameters import DynamicParameters, Friction

__all__ = [
    "BaseParameters",
    "DynamicParameters",
    "Friction",
    "Proof",
    "SelfTest",
    "WrittenOut",
    "base_parameters",
    "export_c",
    "kinematic_function",
    "kinematic_names",
    "kinematic_values",
    "latex",
    "listing",
    "plain_text",
    "prove",
    "python_source",
    "regressor_function",
    "self_test",
    "write_c",
    "write_out",
    "write_python",
]
