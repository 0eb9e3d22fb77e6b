"""Former names of attributes of results: they work, with a warning."""

from types import SimpleNamespace

import pytest

from dmframe.analysis.summary import LoopAnalysis
from dmframe.results.reported import ReportedEstimate


def test_felt_is_the_excitation_with_a_warning() -> None:
    estimate = ReportedEstimate("payload.mass", "mass", "kg", (1.5,), (2.0,))
    with pytest.warns(DeprecationWarning, match="felt is now excitation"):
        assert estimate.felt == (2.0,)


def test_ties_are_the_reference_gains_with_a_warning() -> None:
    with pytest.warns(DeprecationWarning, match="ties is now reference_gains"):
        assert LoopAnalysis.ties.fget(SimpleNamespace(reference_gains=(1,))) == (1,)
