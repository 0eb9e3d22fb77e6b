"""Designs: the same numbers for a sample, for any order of requests, with the distribution of the file."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest
import scipy

from dmframe.common.errors import ValueFault
from dmframe.study.design import Design, Method, Spread

NAMES = ("servo.K_P", "arm.viscous", "path.radius")


@pytest.mark.parametrize("method", ["random", "sobol", "latin_hypercube"])
def test_a_sample_does_not_depend_on_the_chunk(method: Method) -> None:
    design = Design(method, 5, NAMES, 300)
    whole = design.points(0, 300)
    parts = [design.points(first, min(first + 37, 300)) for first in range(0, 300, 37)]
    assert np.concatenate(parts).tolist() == whole.tolist()
    assert whole.min() > 0
    assert whole.max() < 1
    assert Design(method, 6, NAMES, 300).points(0, 300).tolist() != whole.tolist()


@pytest.mark.parametrize("method", ["random", "sobol"])
def test_more_samples_do_not_change_the_existing_ones(method: Method) -> None:
    few, many = Design(method, 5, NAMES, 10), Design(method, 5, NAMES, 1000)
    assert few.extends
    assert many.points(0, 10).tolist() == few.points(0, 10).tolist()
    assert not Design("latin_hypercube", 5, NAMES, 10).extends


def test_random_numbers_of_one_quantity_do_not_depend_on_the_others() -> None:
    alone = Design("random", 5, NAMES[1:2], 50).points(0, 50)
    assert Design("random", 5, NAMES, 50).points(0, 50)[:, 1].tolist() == alone[:, 0].tolist()


def test_random_numbers_are_those_of_numpy() -> None:
    words = np.frombuffer(hashlib.sha256(b"servo.K_P").digest(), dtype=np.uint32).tolist()
    generator = np.random.Generator(np.random.PCG64(np.random.SeedSequence([5, *words])))
    assert Design("random", 5, NAMES[:1], 40).points(0, 40)[:, 0] == pytest.approx(generator.random(40), abs=2.0**-51)


def test_a_latin_hypercube_has_one_sample_in_each_slice_and_a_sobol_sequence_too() -> None:
    for method, count in (("latin_hypercube", 100), ("sobol", 128)):
        points = Design(method, 1, NAMES, count).points(0, count)  # type: ignore[arg-type]
        for column in points.T:
            assert sorted(np.floor(column * count).astype(int).tolist()) == list(range(count)), method


@pytest.mark.parametrize(
    ("spread", "name", "shape"),
    [
        (Spread("uniform", 2, 5, 2, 5), "uniform", (2, 3)),
        (Spread("log", 0.1, 1000, 0.1, 1000), "loguniform", (0.1, 1000)),
        (Spread("normal", 8, 2, -np.inf, np.inf), "norm", (8, 2)),
        (Spread("normal", 8, 2, 0, 9), "truncnorm", (-4, 0.5, 8, 2)),
        (Spread("normal", 8, 2, 24, 30), "truncnorm", (8, 11, 8, 2)),
    ],
)
def test_the_quantiles_are_those_of_scipy(spread: Spread, name: str, shape: tuple[float, ...]) -> None:
    reference = getattr(scipy.stats, name)(*shape)
    points = np.array([1e-12, 1e-4, 0.1, 0.5, 0.77, 0.999, 1 - 1e-12])
    drawn = spread.at(points)
    assert drawn == pytest.approx(reference.ppf(points), rel=1e-9)
    assert drawn.min() >= spread.lower
    assert drawn.max() <= spread.upper
    assert [float(f"{value:.11e}") for value in drawn] == drawn.tolist()


def test_samples_outside_of_the_design_are_refused() -> None:
    with pytest.raises(ValueFault, match="from 0 to 10, found 5 to 11"):
        Design("random", 0, NAMES, 10).points(5, 11)


def test_a_latin_hypercube_that_memory_does_not_hold_is_refused() -> None:
    with pytest.raises(ValueFault, match=r"sample.runs: expected at most 5000000 with latin_hypercube"):
        Design("latin_hypercube", 0, ("a", "b"), 10**9)
    Design("sobol", 0, ("a", "b"), 10**9)
