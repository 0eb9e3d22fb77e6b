"""The dynamic regressor as a product: exact base parameters, C source, a readable list."""

from __future__ import annotations

from dmframe.regressor.base_parameters import BaseParameters, base_parameters
from dmframe.regressor.export import SelfTest, export_c, regressor_function, self_test, write_c
from dmframe.regressor.full import Friction, parameter_names, parameter_values
from dmframe.regressor.listing import listing

__all__ = [
    "BaseParameters",
    "Friction",
    "SelfTest",
    "base_parameters",
    "export_c",
    "listing",
    "parameter_names",
    "parameter_values",
    "regressor_function",
    "self_test",
    "write_c",
]
