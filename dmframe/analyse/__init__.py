"""Linear analysis: the servo as transfer functions, poles of the loop, how slow its clock may be, the least K_c."""

from __future__ import annotations

from dmframe.analyse.figures import bode_svg, nyquist_svg
from dmframe.analyse.linear import Linear, linearise, tick_jacobian
from dmframe.analyse.period import Bracket, StablePeriods, largest_stable_period, linearised_period, simulated_period
from dmframe.analyse.rank_region import RankLoss, RankRegion, rank_region
from dmframe.analyse.rank_report import option_value, rank_summary
from dmframe.analyse.rational import Passivity, Rational, passivity, transfer
from dmframe.analyse.servo import JointLoop, Margins, margins, servo_transfer
from dmframe.analyse.set_point import equilibrium, frozen, true_values
from dmframe.analyse.summary import Analysis, analyse, summary
from dmframe.analyse.tie import TieGain, least_K_c, tie_gains

__all__ = [
    "Analysis",
    "Bracket",
    "JointLoop",
    "Linear",
    "Margins",
    "Passivity",
    "RankLoss",
    "RankRegion",
    "Rational",
    "StablePeriods",
    "TieGain",
    "analyse",
    "bode_svg",
    "equilibrium",
    "frozen",
    "largest_stable_period",
    "least_K_c",
    "linearise",
    "linearised_period",
    "margins",
    "nyquist_svg",
    "option_value",
    "passivity",
    "rank_region",
    "rank_summary",
    "servo_transfer",
    "simulated_period",
    "summary",
    "tick_jacobian",
    "tie_gains",
    "transfer",
    "true_values",
]
