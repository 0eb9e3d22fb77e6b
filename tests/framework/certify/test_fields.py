"""A field of the wrong type in a certificate is an error with the block, the field, the file and the line."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, is_dataclass
from typing import Any

import casadi as ca
import numpy as np
import pytest
from closed_loops import known_blocks, loop_of

from dmframe.block import certificate
from dmframe.block.certificate import (
    Assumption,
    Certificate,
    Clipped,
    CommonLyapunov,
    Consumed,
    Inequality,
    InformationSquare,
    Lemma,
    NormSquare,
    Square,
    StableLinear,
)
from dmframe.certify import verify
from dmframe.robot.library import load

x = ca.SX.sym("x")
WRONG: dict[str, Callable[[], object]] = {
    "Certificate: expected dissipation to be a tuple of Square, NormSquare, Lemma or InformationSquare, "
    "found a Square; is a comma missing?": lambda: Certificate(dissipation=Square(x)),
    "Certificate: expected storage to be a tuple of Square, InformationSquare, Potential or LogDet, "
    "found a list": lambda: Certificate(storage=[Square(x)]),
    "found a generator": lambda: Certificate(residual=(Square(item) for item in (x, x))),
    "found None": lambda: Certificate(storage=None),
    "found a dict": lambda: Certificate(dissipation={"a": Square(x)}),
    "Certificate: expected supply to be an expression, found None": lambda: Certificate(supply=None),
    "Certificate: expected supply to be an expression, found a tuple": lambda: Certificate(supply=(x,)),
    "Certificate: expected consumes to be a Consumed or None, found a tuple": lambda: Certificate(consumes=(x, 1)),
    "Certificate: expected dominates to be a tuple of expressions, found an SX; is a comma missing?": lambda: (
        Certificate(dominates=x)
    ),
    "Certificate: expected task to be True or False, found a str": lambda: Certificate(task="yes"),
    "Certificate: expected truth to be a mapping of names to expressions, found a str": lambda: Certificate(
        truth="a_d"
    ),
    "Certificate: expected truth['a_d'] to be an expression, found a str": lambda: Certificate(truth={"a_d": "a_d"}),
    "Certificate: expected each name of truth to be a text, found an SX": lambda: Certificate(truth={x: x}),
    "Certificate: expected linear to be a tuple of StableLinear, found a StableLinear; is a comma missing?": lambda: (
        Certificate(linear=StableLinear((x,), ((x,),), (x,)))
    ),
    "Square: expected weight to be an expression, found a str": lambda: Square(x, "2"),
    "Square: expected vector to be an expression, found a list": lambda: Square([x, x]),
    "Square: expected weight to be an expression, found a bool": lambda: Square(x, True),
    "Square: expected weight to be an expression, found an ndarray": lambda: Square(x, np.array(["2"])),
    "the name of a term is printed from its expression": lambda: Square("x", x),
    "Lemma: expected phi to be a text, found a builtin": lambda: Lemma(x, x, x, x, len),
    "Lemma: expected scale to be an expression, found a dict": lambda: Lemma(x, x, x, {}),
    "NormSquare: expected by to be an expression": lambda: NormSquare(x, x, "b"),
    "InformationSquare: expected memory to be an expression": lambda: InformationSquare(x, x, None, x, x, x),
    "Clipped: expected other to be an expression": lambda: Clipped(x, x, None),
    "Consumed: expected c to be an expression": lambda: Consumed(x, None),
    "StableLinear: expected rates[0] to be a tuple of expressions, found an SX; is a comma missing?": lambda: (
        StableLinear((x,), (x,), (x,))
    ),
    "StableLinear: expected otherwise[0] to be an Inequality, a CommonLyapunov or an Assumption": lambda: StableLinear(
        (x,), ((x,),), (x,), otherwise=("no",)
    ),
    "Inequality: expected expression to be an expression, found a bool": lambda: Inequality("x > 0", True, ""),
    "Inequality: expected name to be a Text or a text, found an SX": lambda: Inequality(x, x, ""),
    "CommonLyapunov: expected a to be an expression": lambda: CommonLyapunov("stable", None, x, ""),
    "Assumption: expected text to be a Text or a text, found None": lambda: Assumption(None),
}


@pytest.mark.parametrize("text", WRONG)
def test_a_field_of_the_wrong_type_is_an_error_with_block_field_file_and_line(text: str) -> None:
    block = known_blocks()["dynamic_compensator"]
    wrong = type(block)(block.__name__, (block,), {"__module__": block.__module__, "certificate": stating(text)})
    loop = loop_of(load("arm2"), "joint", "PI").build({"dynamic_compensator": wrong}, lambda _, mutant: mutant)
    verdict = verify(loop, trials=1)
    assert verdict.outcome == "not_applicable"
    assert verdict.reason.startswith("dynamics: certificate(), test_fields.py:")
    assert text in verdict.reason
    assert line_of(text) <= int(verdict.reason.split(":")[2]) < line_of(text) + 4


def stating(text: str) -> Any:
    return lambda self, u, x, p, truth: WRONG[text]()


def line_of(text: str) -> int:
    return WRONG[text].__code__.co_firstlineno


def test_every_class_of_a_certificate_checks_its_fields() -> None:
    stated = [item for item in vars(certificate).values() if is_dataclass(item)]
    assert {kind.__name__ for kind in stated} >= {"Certificate", "Square", "Inequality"}
    for kind in stated:
        with pytest.raises(TypeError, match=f"^({kind.__name__}: expected|Square\\()"):
            kind(*["wrong"] * (len(fields(kind)) - 1), object())
