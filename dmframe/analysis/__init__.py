"""Linear analysis: servo transfer functions, poles, largest stable sampling period, least feedback gain K_c."""

from __future__ import annotations

from dmframe.analysis.delay import FittedDelay, fitted_delay, recorded_delay
from dmframe.analysis.emulation import EmulationLimit, emulation_limits
from dmframe.analysis.figures import bode_svg, nyquist_svg
from dmframe.analysis.linear import Linear, linearise, tick_jacobian
from dmframe.analysis.period import Bracket, StablePeriods, largest_stable_period, linearised_period, simulated_period
from dmframe.analysis.rank_region import RankLoss, RankRegion, rank_region
from dmframe.analysis.rank_report import option_value, rank_summary
from dmframe.analysis.rational import Passivity, Rational, passivity, transfer
from dmframe.analysis.reference_gain import ReferenceGain, least_K_c, reference_gains
from dmframe.analysis.servo import JointLoop, Margins, margins, servo_transfer
from dmframe.analysis.set_point import equilibrium, frozen
from dmframe.analysis.stability_proof import StabilityProof, prove_stability, proved_schur
from dmframe.analysis.summary import LoopAnalysis, analyse, summary

__all__ = [
    "Bracket",
    "EmulationLimit",
    "FittedDelay",
    "JointLoop",
    "Linear",
    "LoopAnalysis",
    "Margins",
    "Passivity",
    "RankLoss",
    "RankRegion",
    "Rational",
    "ReferenceGain",
    "StabilityProof",
    "StablePeriods",
    "analyse",
    "bode_svg",
    "emulation_limits",
    "equilibrium",
    "fitted_delay",
    "frozen",
    "largest_stable_period",
    "least_K_c",
    "linearise",
    "linearised_period",
    "margins",
    "nyquist_svg",
    "option_value",
    "passivity",
    "prove_stability",
    "proved_schur",
    "rank_region",
    "rank_summary",
    "recorded_delay",
    "reference_gains",
    "servo_transfer",
    "simulated_period",
    "summary",
    "tick_jacobian",
    "transfer",
]
