"""Seeded faults are faults of the function itself: its names, defaults, closure and decorators are unchanged."""

from __future__ import annotations

import ast
import inspect
import textwrap
from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest
from seeded_faults import LIBRARY, CompileError, Mutant, check_compiled, compiled, mutants_of

import dmframe.block.linalg


def source_of(function: Callable[..., Any]) -> str:
    return textwrap.dedent(inspect.getsource(function))


@pytest.mark.parametrize(
    "function", [each for group in LIBRARY.values() for each in group], ids=lambda f: f.__qualname__
)
def test_the_unchanged_source_of_a_shared_function_gives_the_function(function: Any) -> None:
    check_compiled(source_of(function), function)


def test_a_decorated_function_keeps_its_helpers_and_its_decorator() -> None:
    made = compiled(source_of(dmframe.block.linalg.solve_spd), dmframe.block.linalg.solve_spd)
    A, b = np.array([[3.0, 1], [1, 2]]), np.array([1.0, -1])
    np.testing.assert_allclose(ca.DM(made(ca.SX(A), ca.SX(b))).full().ravel(), np.linalg.solve(A, b))
    assert "solve_spd" in str(made(ca.MX(A), ca.MX(b)))  # one node, as created by the decorator
    assert inspect.unwrap(made).__globals__ is vars(dmframe.block.linalg)


def test_a_changed_name_default_or_decorator_is_an_error_of_the_harness() -> None:
    own = source_of(dmframe.block.linalg.solve_spd)
    with pytest.raises(CompileError, match="solve_spd: its source gives other names or constants"):
        check_compiled(own.replace("_factors(A)", "_lost(A)"), dmframe.block.linalg.solve_spd)
    with pytest.raises(CompileError, match="solve_spd: its source gives other decorators"):
        check_compiled(own.replace("@operation\n", ""), dmframe.block.linalg.solve_spd)
    with pytest.raises(CompileError, match="solve_spd: its source gives other defaults"):
        check_compiled(own.replace("b: Any)", "b: Any = 1)"), dmframe.block.linalg.solve_spd)


class Base:
    def shifted(self, x: float, *, by: float = 2) -> float:
        return x + by


class Derived(Base):
    def shifted(self, x: float, *, by: float = 3) -> float:
        return super().shifted(x * x, by=by)


def test_a_method_keeps_super_and_its_keyword_defaults() -> None:
    made = compiled(source_of(Derived.shifted), Derived.shifted)
    assert made(Derived(), 4) == Derived().shifted(4) == 19
    faults = {mutant.fault.split(": ", 1)[1]: mutant for mutant in faults_of(Derived.shifted)}
    assert faults["3 became 4"].function(Derived(), 4) == 20
    assert faults["x * x became x / x"].function(Derived(), 4) == 4


def faults_of(function: Any) -> list[Mutant]:
    return list(mutants_of(function, "Derived", {}))


def checked(x: int | float) -> float:
    if x < 0:
        raise ValueError(f"expected at least 0, found {x + 1}")
    return x + 1


def test_annotations_and_messages_have_no_faults() -> None:
    faults = [mutant.fault.split(": ", 1)[1] for mutant in faults_of(checked)]
    assert faults == [
        "0 became 1",
        "0 became -1",
        "x + 1 became x - 1",
        "x + 1: only x left",
        "x + 1: only 1 left",
        "x + 1 doubled",
        "1 became 2",
        "1 became -2",
    ]
    assert all(isinstance(ast.parse(mutant.source), ast.Module) for mutant in faults_of(checked))
