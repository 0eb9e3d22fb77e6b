"""Linear analysis of a graph, as an object and as plain data."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, final

from dmframe.analysis.additional_friction import AdditionalFriction
from dmframe.analysis.emulation import SECONDS, EmulationLimit, emulation_limits
from dmframe.analysis.linear import Linear, linearise
from dmframe.analysis.period import Bracket, StablePeriods, linearised_period, simulated_period
from dmframe.analysis.rational import Passivity, Rational
from dmframe.analysis.reference_gain import ReferenceGain, reference_gains
from dmframe.analysis.rounding import averaged
from dmframe.analysis.servo import JointLoop, left_out, servo_transfer
from dmframe.analysis.stability_proof import StabilityProof, prove_stability
from dmframe.certify.true_values import estimates_of
from dmframe.common.errors import listed
from dmframe.diagram import Diagram
from dmframe.exact.rational import Interval
from dmframe.simulate import Solver

NOTE = (
    "The certificate holds in continuous time. The poles are those of the loop linearised near the set-point with "
    "every estimate at its true value; a run with other estimates may stay bounded at a longer period, or at none."
)


NOTE_OF_A_CLOCK = (
    "This loop is discrete-time: it was linearised from sample to sample at its set-point, without random signals and "
    "jitter, with estimates at their stated true values. A run with other estimates may stay bounded at a longer "
    "period, or at none."
)


@final
@dataclass(frozen=True, repr=False)
class LoopAnalysis:
    """Linear analysis of a diagram at its set-point, the trajectory at t = 0.

    Parameters
    ----------
    clock
        Sampling period [s], or None.
    at_rest, moving
        The linearised loop with and without the slope of smooth Coulomb friction at rest.
    joints
        Servo and inverse, joint by joint.
    periods
        Largest stable sampling periods.
    reference_gains
        K_c of each PID inverse, joint by joint.
    proofs
        Interval proofs for `at_rest` and `moving`.
    emulation
        Quasi-static limits of adaptation gains; empty without a clock.
    unknown
        Estimates without known true values: they have their values at the set-point.
    averaged
        Outputs declared as rounded, such as encoders, with their largest steps.
    field_hash
        `Diagram.fingerprint`.
    left_out
        Friction that the joint loops leave out.
    """

    clock: float | None
    at_rest: Linear
    moving: Linear
    joints: tuple[JointLoop, ...]
    periods: StablePeriods
    reference_gains: tuple[ReferenceGain, ...]
    proofs: tuple[StabilityProof, StabilityProof]
    emulation: tuple[EmulationLimit, ...] = ()
    unknown: tuple[str, ...] = ()
    averaged: Mapping[str, float] = field(default_factory=dict)
    field_hash: str = ""
    left_out: tuple[AdditionalFriction, ...] = ()

    @property
    def ties(self) -> tuple[ReferenceGain, ...]:
        """Former name of `reference_gains`."""
        warnings.warn("LoopAnalysis: ties is now reference_gains", DeprecationWarning, stacklevel=2)
        return self.reference_gains

    @property
    def note(self) -> str:
        """Scope of the numbers."""
        note = NOTE if self.at_rest.clock is None else NOTE_OF_A_CLOCK
        if self.averaged:
            steps = ", ".join(f"{label} (steps of {step:.3g})" for label, step in self.averaged.items())
            note += f" Rounded signals are replaced by their means: {steps}."
        if self.at_rest.kinks:
            note += f" The equilibrium is at an edge of {listed(self.at_rest.kinks)}: the linearisation is one-sided."
        if self.left_out:
            note += (
                f" The joint loops are {'; '.join(map(str, self.left_out))}. The linearised loop contains it at rest."
            )
        if self.unknown:
            note += f" True values of {', '.join(self.unknown)} are unknown: they have their values at the set-point."
        return note

    def __repr__(self) -> str:
        return f"<LoopAnalysis of {len(self.at_rest.states)} states>"


def analyse(
    diagram: Diagram,
    clock: float | None,
    *,
    solver: Solver | None = None,
    start: Mapping[str, Any] | None = None,
    horizon: float = 20.0,
    uncertain: Mapping[str, Sequence[Interval]] | None = None,
    tell: Callable[[str], None] = lambda _: None,
) -> LoopAnalysis:
    """Linearise, find margins and poles, search for the largest stable sampling period, and find the least K_c.

    The least K_c holds over the intervals of `uncertain`; all other parameters have the values of the graph.
    `tell` receives progress messages; the analysis may take half a minute.

    Raises
    ------
    DmframeError
        See `linearise`, `servo_transfer` and `largest_stable_period`.
    """
    tell("linearising")
    at_rest = linearise(diagram, start=start, clock=clock)
    moving = linearise(diagram, at_rest.point, moving=True, clock=clock)
    periods = StablePeriods(
        linearised_period(at_rest),
        linearised_period(moving),
        simulated_period(diagram, clock, solver=solver, start=start, horizon=horizon, tell=tell),
    )
    tell("finding the least K_c")
    gains = reference_gains(diagram, uncertain)
    tell("proving that the linearised loop is stable")
    proof, split = prove_stability(diagram, at_rest, periods.at_rest, clock)
    proofs = proof, prove_stability(diagram, moving, periods.moving, clock, moving=True, split=split)[0]
    seconds = min(SECONDS, horizon)
    limits = (
        ()
        if clock is None
        else emulation_limits(diagram, clock, at_rest.point, solver=solver, start=start, seconds=seconds)
    )
    unknown = tuple(label for label, value in estimates_of(diagram, resting=True).items() if value is None)
    joints = servo_transfer(diagram, at_rest.point)
    means, field_hash, left = averaged(diagram), diagram.fingerprint, left_out(diagram)
    return LoopAnalysis(
        clock, at_rest, moving, joints, periods, gains, proofs, limits, unknown, means, field_hash, left
    )


def summary(name: str, analysis: LoopAnalysis) -> dict[str, Any]:
    """Plain data for JSON; non-finite numbers become None."""
    return {
        "graph": name,
        "field_hash": analysis.field_hash,
        "clock": analysis.clock if analysis.clock is not None else "continuous",
        "set_point": dict(zip(analysis.at_rest.states, analysis.at_rest.point.tolist(), strict=True)),
        "at_rest": _linear(analysis.at_rest, analysis.clock),
        "moving": _linear(analysis.moving, analysis.clock),
        "joints": [_joint(joint) for joint in analysis.joints],
        "largest_stable_period": {
            "at_rest": _bracket(analysis.periods.at_rest),
            "moving": _bracket(analysis.periods.moving),
            "simulated": _bracket(analysis.periods.simulated),
        },
        "proof": {
            name: {
                "proved_radius": proof.radius,
                "proved_period": proof.period,
                "directions": proof.directions,
                "resting": proof.resting,
                "kept": proof.kept,
                "within": proof.within,
                "reason": proof.reason,
                "disagrees": proof.disagrees,
            }
            for name, proof in zip(("at_rest", "moving"), analysis.proofs, strict=True)
        },
        "emulation": [
            {
                "gain": limit.gain,
                "value": limit.value,
                "most_at_rest": _finite(limit.at_rest),
                "most_on_path": _finite(limit.on_path),
                "most_at_bound": None if limit.at_bound is None else _finite(limit.at_bound),
                "meaning": limit.meaning,
            }
            for limit in analysis.emulation
        ],
        "K_c": [_gain(gain) for gain in analysis.reference_gains],
        "averaged": dict(analysis.averaged),
        "kinks": list(analysis.at_rest.kinks),
        "note": analysis.note,
    }


def _linear(linear: Linear, clock: float | None) -> dict[str, Any]:
    return {
        "poles": None if linear.clock is not None else _complex(linear.poles),
        "zero_poles": linear.at_rest,
        "sampled_poles": None if clock is None else _complex(linear.sampled_poles(clock)),
        "spectral_radius": None if clock is None else _finite(linear.spectral_radius(clock)),
    }


def _joint(joint: JointLoop) -> dict[str, Any]:
    return {
        "joint": joint.joint,
        "inertia": joint.inertia,
        "viscous": joint.viscous,
        "servo": _rational(joint.servo),
        "servo_passive": _passive(joint.passive_servo),
        "loop": _rational(joint.loop),
        "tracking_poles": _complex(joint.tracking.poles),
        "gain_margin": _finite(joint.margins.gain),
        "phase_margin_deg": _finite(joint.margins.phase),
        "crossover": _finite(joint.margins.gain_crossover),
        "inverse": None if joint.inverse is None else _rational(joint.inverse),
        "servo_with_inverse": None if joint.port is None else _rational(joint.port),
        "servo_with_inverse_passive": None if joint.passive_port is None else _passive(joint.passive_port),
    }


def _gain(gain: ReferenceGain) -> dict[str, Any]:
    return {
        "block": gain.block,
        "joint": gain.joint,
        "own": float(gain.own),
        "holds": gain.holds,
        "least": float(gain.least),
        "least_without_friction": float(gain.least_without_friction),
    }


def _bracket(bracket: Bracket) -> dict[str, Any]:
    return {"stable": bracket.stable, "unstable": _finite(bracket.unstable), "meaning": bracket.meaning}


def _rational(system: Rational) -> dict[str, list[float]]:
    return {"num": (system.num + 0.0).tolist(), "den": (system.den + 0.0).tolist()}


def _passive(found: Passivity) -> dict[str, Any]:
    return {"holds": found.holds, "least_real_part": _finite(found.least), "at": _finite(found.frequency)}


def _complex(values: Any) -> list[list[float]]:
    return [[float(value.real), float(value.imag)] for value in values]


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
