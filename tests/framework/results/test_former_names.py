"""Former names of attributes of results: they work, with a warning."""

from types import SimpleNamespace

import numpy as np
import pytest

from dmframe.analysis.summary import LoopAnalysis
from dmframe.results.climb import climb_of
from dmframe.results.reported import ReportedEstimate


def test_the_former_name_of_excitation_gives_a_warning() -> None:
    estimate = ReportedEstimate("payload.mass", "mass", "kg", (1.5,), (2.0,))
    with pytest.warns(DeprecationWarning, match="felt is now excitation"):
        assert estimate.felt == (2.0,)


def test_ties_are_the_reference_gains_with_a_warning() -> None:
    with pytest.warns(DeprecationWarning, match="ties is now reference_gains"):
        assert LoopAnalysis.ties.fget(SimpleNamespace(reference_gains=(1,))) == (1,)


def test_share_is_the_fraction_of_a_climb_with_a_warning() -> None:
    climb = climb_of(np.arange(4.0), np.array([4.0, 1.0, 2.5, 0.0]), np.zeros(4))
    with pytest.warns(DeprecationWarning, match="share is now fraction"):
        assert climb.share == climb.fraction == 1.5 / 4
