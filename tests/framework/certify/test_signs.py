"""Signs of a claim's terms at the numbers of its file, compared with those that `verify` decides."""

import json
from fractions import Fraction
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from scalar_blocks import scalar_loop

import dmframe as dm
from dmframe.block.certificate import Certificate, Square
from dmframe.certify.assemble import assembled
from dmframe.certify.claim import claim_of
from dmframe.certify.symbols import exact_values
from dmframe.common.errors import ValueFault
from dmframe.prove.__main__ import main
from dmframe.prove.claim import Claim
from dmframe.prove.export import read_file, to_json
from dmframe.prove.signs import Numbers, signs


def written(name: str) -> tuple[Claim, dict[str, tuple[Fraction, ...]]]:
    claim = claim_of(dm.load(name).diagram)
    exact = assembled(claim)
    own = {symbol.label for symbol in exact.symbols if symbol.kind == "parameter"}
    return exact, {label: values for label, values in exact_values(claim.diagram).items() if label in own}


@pytest.fixture(scope="module")
def arm2() -> tuple[Claim, dict[str, tuple[Fraction, ...]]]:
    return written("arm2_joint")


def test_the_signs_of_a_file_are_those_of_the_verdict(arm2: tuple[Claim, Numbers]) -> None:
    claim, numbers = read_file(to_json(*arm2))
    found = {sign.name: sign for sign in signs(claim, numbers)}
    conditions = dm.load("arm2_joint").verify().verdict.conditions
    stated = {str(item.name): item.value for item in conditions if " in V > 0" in item.name}
    assert len(stated) == 5
    for name, value in stated.items():
        sign = found[name.removesuffix(" > 0")]
        assert sign.holds
        assert sign.least is not None
        assert float(sign.least) == value
    assert found["arm: weight of |sigma|^2 in V"].holds is None  # the mass matrix moves


def test_a_gain_below_zero_is_a_wrong_sign(
    arm2: tuple[Claim, dict[str, tuple[Fraction, ...]]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    claim, numbers = arm2
    wrong = numbers | {"dynamics.Gamma": tuple(-x for x in numbers["dynamics.Gamma"])}
    file = tmp_path / "claim.json"
    for given, status in ((numbers, 0), (wrong, 1)):
        file.write_text(to_json(claim, given), encoding="utf-8")
        assert main([str(file)]) == status
        assert ("of the wrong sign: dynamics: weight of |a_d_hat - a_d|^2 in V" in capsys.readouterr().out) == status


def test_numbers_of_no_parameter_and_of_another_size_are_refused(arm2: tuple[Claim, Numbers]) -> None:
    claim, numbers = arm2
    for label, values in (("dynamics.Gamma", ["1"]), ("arm.q", ["1", "1"]), ("unknown.k", ["1"])):
        text = json.loads(to_json(claim, numbers))
        text["numbers"][label] = values
        with pytest.raises(
            ValueFault, match=f"expected numbers of its parameters, with as many values as elements, found {label}"
        ):
            read_file(json.dumps(text))


@pytest.mark.parametrize("coupling", [0.5, 3.0])
def test_a_matrix_is_definite_where_its_eigenvalues_are_above_zero(coupling: float) -> None:
    W = ca.DM([[2, coupling], [coupling, 2]])
    loop = scalar_loop(
        "x w",
        lambda x, u, p: {"x": -p.k * x.x, "w": -p.k * x.w},
        lambda x, u, p: Certificate(
            storage=(Square(ca.vertcat(x.x, x.w), W),), dissipation=(Square(ca.vertcat(x.x, x.w), p.k * W),)
        ),
    )
    claim = assembled(claim_of(loop))
    (stored, spent) = signs(claim, exact_values(loop))
    definite = bool(np.all(np.linalg.eigvalsh(W.full()) > 0))
    assert stored.holds == spent.holds == definite
