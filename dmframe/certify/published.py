"""The certificate file of a proved claim, for a checker that does not use this framework (`dmframe.checker`).

The file contains what a proof starts from, and nothing that was derived: symbols, one program of rational operations,
the parts of the terms of V and of its decrease, rates or next values, projections, conditions and conclusions. It
contains no derivative and no value of V.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from fractions import Fraction
from importlib.resources import files
from types import MappingProxyType
from typing import Any, Final, final

import casadi as ca

from dmframe.block.certificate import SX, Lemma, Potential, Square, StableLinear, soft_clip
from dmframe.block.model import symbols_in
from dmframe.certify.assemble import assembled
from dmframe.certify.canonical import canonical
from dmframe.certify.checked import Checked
from dmframe.certify.claim import Claim, Part
from dmframe.certify.definite import body_matrix, is_matrix
from dmframe.certify.limits import Combinations, full_rank, solutions
from dmframe.certify.statements import linear_subsystems, signals_of
from dmframe.certify.symbols import exact_values, symbols_of
from dmframe.certify.verdict import Verdict
from dmframe.common.errors import ValueFault
from dmframe.diagram.projection import Box
from dmframe.diagram.view import view
from dmframe.exact import MERSENNE_127
from dmframe.exact.rational import Interval
from dmframe.prove import claim as data
from dmframe.prove.columns import by_columns

FORMAT: Final = "dmframe-certificate"
VERSION: Final = 3

ROLES: Final = {"stored": "stored", "dissipation": "dissipated", "residual": "residual"}
"""Role in the file, by the role in the claim."""

PARTS: Final = {
    "norm_square": ("vector", "weight", "by"),
    "monotone": ("weight", "first", "second", "scale"),
    "gathered": ("vector", "weight", "memory", "regressor", "by", "forgetting"),
    "potential": ("vector", "width", "weight"),
    "log_det": ("matrix", "true", "weight"),
    "clipped": ("first", "width", "other"),
}
"""Fields from which the checker forms a term; a square has its parts in the claim."""


Intervals = Mapping[str, Sequence[Interval]]


def certificate_text(verdict: Verdict, about: Mapping[str, str], uncertain: Intervals = MappingProxyType({})) -> str:
    """The file, with the intervals of uncertain parameters. Raises `ValueFault` for a graph that is not proved."""
    return json.dumps(certificate_of(verdict, about, uncertain), separators=(",", ":"), ensure_ascii=False) + "\n"


def certificate_of(
    verdict: Verdict, about: Mapping[str, str], uncertain: Intervals = MappingProxyType({})
) -> dict[str, Any]:
    """Content of the file, as JSON data."""
    if verdict.claim is None or verdict.exact is None or verdict.outcome != "proved":
        raise ValueFault(f"a certificate: expected a proved graph, found {verdict.outcome}: {verdict.reason}")
    return _Writer(verdict.claim, verdict, uncertain).content(about)


def certificate_schema() -> dict[str, Any]:
    """JSON Schema of the file."""
    text = files("dmframe.checker").joinpath("certificate.schema.json").read_text(encoding="utf-8")
    schema: dict[str, Any] = json.loads(text)
    return schema


@final
class _Writer:
    """Collects the vectors that the file's statements refer to."""

    def __init__(self, claim: Claim, verdict: Verdict, uncertain: Intervals) -> None:
        self._of, self._verdict, self._uncertain = claim, verdict, uncertain
        self._more = dict[str, SX]()
        self._named = dict[str, str | int]()
        self._used = list[str]()

    def content(self, about: Mapping[str, str]) -> dict[str, Any]:
        """The whole file."""
        of = self._of
        parts = {part.block: self._extra_parts(part) for part in of.parts}
        own = self._own_statements()
        rates = {} if of.over_samples else self._rates()
        self._claim = claim = assembled(of, self._verdict.uncertain, self._more)
        terms = list(self._terms(claim, parts))
        found: dict[str, Any] = {
            "format": FORMAT,
            "version": VERSION,
            "about": dict(about),
            "over": claim.operator,
            "terms": [term for *_, term in terms],
        }
        moved = dict(claim.moved) if of.over_samples else rates
        self._moving = moved.keys()
        found["rates"] = {label: self._id(out) for label, out in moved.items()}
        places = {(block, role, at): k for k, (block, role, at, _) in enumerate(terms)}
        if of.over_samples:
            found |= self._over_samples(claim)
        else:
            found["cross"] = list(self._cross(places))
            found["projections"] = list(self._projections(places))
        found |= {name: self._with_ids(items) for name, items in own.items()}
        found["assumed"] = [str(item.text) for item in self._verdict.assumptions]
        symbols, program, vectors = by_columns(claim, self._used, self._labels(claim))
        exact = exact_values(of.diagram)
        numbers = {label: [[str(x)] * 2 for x in values] for label, values in exact.items()}
        numbers |= {label: [[str(x.lower), str(x.upper)] for x in given] for label, given in self._uncertain.items()}
        for item in symbols:
            if item["kind"] == "parameter" and item["label"] in numbers and "values" not in item:
                item["numbers"] = numbers[item["label"]]
        kappa = self._verdict.kappa
        found |= {"symbols": symbols, "program": program, "vectors": vectors}
        return canonical(found, kappa.chosen if kappa else Fraction(1))

    def _vector(self, name: str, expression: Any) -> str:
        """Enter an expression as an output of the program; return its name."""
        unique, count = f"certificate: {name}", 1
        while unique in self._more:
            count += 1
            unique = f"certificate: {name} ({count})"
        self._more[unique] = ca.SX(expression)
        return unique

    def _id(self, out: str) -> int:
        """Position of an output among the file's vectors."""
        if out not in self._named:
            self._named[out] = len(self._used)
            self._used.append(out)
        return int(self._named[out])

    def _with_ids(self, item: Any) -> Any:
        """The item with positions in place of the names of vectors."""
        if isinstance(item, str) and item in self._more:
            return self._id(item)
        if isinstance(item, dict):
            return {key: self._with_ids(value) for key, value in item.items()}
        return [self._with_ids(value) for value in item] if isinstance(item, list | tuple) else item

    def _rates(self) -> dict[str, str]:
        """Rates of all states, and of the trajectories in the claim and in the file's signals.

        They do not depend on derivatives of trajectories that another computation has formed.
        """
        of, exact = self._of, self._verdict.exact
        assert exact is not None
        claimed, used = {symbol.label for symbol in exact.symbols}, symbols_in(self._more.values())
        moving = {x for variable in of.loop.variables for x in variable.identities}
        for leaf in of.diagram.resolver.trajectories.values():
            if leaf.name in claimed or used & leaf.identities:
                moving |= leaf.identities
        return {label: self._vector(f"rate of {label}", rate) for label, rate in of.flow.rates_of(moving).items()}

    def _extra_parts(self, part: Part) -> dict[tuple[str, int], dict[str, str]]:
        """Fields of the terms that are no squares, by role and position."""
        stated = part.certificate
        found = dict[tuple[str, int], dict[str, str]]()
        for role, items in (
            ("stored", stated.storage),
            ("dissipation", stated.dissipation),
            ("residual", stated.residual),
        ):
            for k, term in enumerate(items):
                if not isinstance(term, Square):
                    rule = data_rule(term)
                    found[role, k] = {
                        name: self._vector(f"{part.block}.{role} {k}: {name}", ca.SX(getattr(term, name)))
                        for name in PARTS[rule]
                    }
        return found

    def _terms(self, claim: data.Claim, extra: Mapping[str, Any]) -> Iterator[tuple[str, str, int, dict[str, Any]]]:
        """Block, role and position of each term, and the term."""
        stated = {part.block: part.certificate for part in self._of.parts}
        for part in claim.parts:
            own = stated[part.block]
            given = {"stored": own.storage, "dissipation": own.dissipation, "residual": own.residual}
            for role, name in ROLES.items():
                for k, (term, source) in enumerate(zip(getattr(part, role), given[role], strict=True)):
                    parts = term.parts if term.rule == "square" else extra[part.block][role, k]
                    item = {
                        "name": f"{part.block}: {term.name}",
                        "level": part.weight,
                        "role": name,
                        "rule": term.rule,
                        "parts": {key: self._id(out) for key, out in parts.items()},
                    }
                    if isinstance(source, Square) and source.positive:
                        item["assumed"] = source.positive
                    if isinstance(source, Lemma):
                        item["phi"] = source.phi
                    yield part.block, role, k, item
            if part.consumed is not None:
                ids = {key: self._id(out) for key, out in part.consumed.parts.items()}
                yield (
                    part.block,
                    "cross",
                    0,
                    {"name": part.block, "level": part.weight, "role": "cross", "rule": "square", "parts": ids},
                )

    def _cross(self, places: Mapping[Any, int]) -> Iterator[dict[str, Any]]:
        for consumer, block in self._of.cross_terms:
            assert block is not None
            by = [
                [self._id(self._shares[block.block][k]), places[block.block, "dissipation", k]]
                for k, share in enumerate(block.certificate.dominates)
                if not ca.SX(share).is_zero()
            ]
            yield {"term": places[consumer.block, "cross", 0], "by": by}

    def _projections(self, places: Mapping[Any, int]) -> Iterator[dict[str, Any]]:
        for key, item in self._projected:
            yield {"term": places[key], **self._with_ids(item)}

    def _own_statements(self) -> dict[str, Any]:
        """Statements whose expressions are entered before the program is read."""
        of = self._of
        self._shares = {
            part.block: [self._vector(f"{part.block}: share", share) for share in part.certificate.dominates]
            for part in of.parts
        }
        self._projected = [] if of.over_samples else list(self._projection_data())
        found: dict[str, Any] = {"conditions": list(map(self._condition, self._verdict.conditions))}
        if not of.over_samples:
            found["masses"] = list(self._masses())
            found["linear"] = [self._linear(item) for _, item in linear_subsystems(of) if not item.inputs]
            found["ranks"] = list(self._ranks())
        found["conclusions"] = self._conclusions()
        return found

    def _projection_data(self) -> Iterator[tuple[tuple[str, str, int], dict[str, Any]]]:
        """Key of the stored square of each projected estimate, and the data of its projection."""
        of = self._of
        for part in of.parts:
            for projection in of.loop.projections:
                estimate = part.certificate.estimates.get(projection.of) if projection.block == part.block else None
                if estimate is None:
                    continue
                own = {x.element_hash() for x in ca.symvar(projection.state)}
                (place,) = (
                    k
                    for k, term in enumerate(part.certificate.storage)
                    if own & {x.element_hash() for piece in term.pieces for x in ca.symvar(ca.SX(piece))}
                )
                name, item = projection.name, dict[str, Any]()
                true = of.loop.joined([estimate.value + ca.SX.zeros(projection.state.shape[0])])[0]
                item["state"] = name
                item["set"], item["true"] = projection.kind, self._vector(f"{name}: true value", true)
                if isinstance(projection.set, Box):
                    ends = (projection.set.lower, projection.set.upper)
                    wide = [end + ca.SX.zeros(projection.state.shape[0]) for end in map(ca.SX, ends)]
                    item["lower"], item["upper"] = (self._vector(f"{name}: bound", end) for end in wide)
                yield (part.block, "stored", place), item

    def _masses(self) -> Iterator[dict[str, Any]]:
        """Weights that are mass matrices, with the chain of bodies."""
        of = self._of
        for part in of.parts:
            for term in (*part.certificate.storage, *part.certificate.dissipation):
                if isinstance(term, Square) and (is_matrix(of, term.weight) or term.vector.is_scalar()):
                    found = body_matrix(of, (term.weight + term.weight.T) / 2)
                    if found is not None:
                        q, robot, inertia, rotors = found
                        yield {
                            "weight": self._vector("a mass matrix", term.weight),
                            "position": self._vector("q", q),
                            "translations": self._vector("translations", robot.a_k),
                            "inertia": self._vector("inertia", inertia),
                            "rotors": None if rotors.is_zero() else self._vector("rotors", rotors),
                            "motion": self._motion(q, robot, inertia),
                            "joints": [
                                {
                                    "kind": joint.kind,
                                    "axis": [str(x) for x in joint.axis],
                                    "rotation": [str(x) for row in joint.rotation for x in row],
                                }
                                for joint in robot.chain.joints
                            ],
                        }

    def _motion(self, q: SX, robot: Any, inertia: SX) -> dict[str, str] | None:
        """The robot's equation of motion: the torque of servo, environment and friction; None for another plant."""
        of = self._of
        for name, model in of.diagram.models.items():
            outputs = set(model.equations.outputs)
            if model.robot is not robot or not {"q", "dq", "ddq", "K", "B", "D"} <= outputs:
                continue
            seen = view(of.diagram, name, of.truths).u
            out = {key: of.diagram.resolver.output(name, key) for key in ("q", "dq", "ddq", "K", "B", "D")}
            share = of.diagram.resolver.output(name, "g_share") if "g_share" in outputs else ca.SX(1)
            torque = out["K"] * seen.u - out["B"] * out["dq"] - out["D"] * robot.coulomb(out["dq"])
            torque = torque + (seen.tau_ext if "tau_ext" in seen else 0)
            names = ("velocity", "acceleration", "gravity", "torque", "position")
            wanted = (out["dq"], out["ddq"], share * robot.gravity, torque, out["q"])
            velocity, acceleration, gravity, torque, position = of.loop.joined(list(wanted))
            if not ca.is_equal(position, q, 2):
                continue
            (share,) = of.loop.joined([share])
            moved = robot.inverse_dynamics(q, velocity, velocity, acceleration, inertia, gravity_share=share)
            if "I_r" in outputs:
                moved = moved + of.loop.joined([of.diagram.resolver.output(name, "I_r")])[0] * acceleration
            if not symbols_of(of).vanishes("motion", moved - torque, trials=1):
                return None
            found = zip(names, (velocity, acceleration, gravity, torque), strict=False)
            return {key: self._vector(f"{name}: {key}", value) for key, value in found}
        return None

    def _linear(self, item: StableLinear) -> dict[str, Any]:
        joined = self._of.loop.joined
        return {
            "vectors": [self._vector("z", z) for z in joined(list(item.vectors))],
            "rates": [[self._vector("rate", rate) for rate in joined(list(map(ca.SX, row)))] for row in item.rates],
        }

    def _ranks(self) -> Iterator[dict[str, Any]]:
        """Matrices R of full row rank, with vectors b that go to zero since R'b does: errors, their forces in a
        potential, or solutions of R'b = z.
        """
        signals = signals_of(self._of)
        ends = [item for item in self._verdict.statements if item.says == "goes to zero" and item.signal in signals]
        field = Combinations(self._of, MERSENNE_127, 0, frozenset(self._uncertain))
        widths = {
            term.of: term.width
            for part in self._of.parts
            for term in part.certificate.storage
            if isinstance(term, Potential)
        }
        for name, R in full_rank(self._of):
            used = [item for item in ends if f"{name} keeps full row rank, uniformly" in map(str, item.assumes)]
            matrix = self._vector(f"{name}, full rank", R) if used else ""
            for item in used:
                b, size = [signals[item.signal]], signals[item.signal].numel()
                if size != R.shape[0]:
                    vanishing = [signals[other.signal] for other in ends if other not in used]
                    b = [x for z in vanishing for x in solutions(R, z) if field.is_part(signals[item.signal], x)]
                elif item.signal in widths:
                    b = [soft_clip(b[0], widths[item.signal])]
                for vector in b:
                    yield {"name": str(name), "matrix": matrix, "vector": self._vector(f"{name}, vanishing", vector)}

    def _condition(self, item: Checked) -> dict[str, Any]:
        """A condition: the vector whose elements decide it, or only its text."""
        found: dict[str, Any] = {"name": str(item.name)}
        if item.margin is not None and item.margin.numel():
            (margin,) = self._of.loop.joined([ca.vec(ca.densify(item.margin))])
            known = {x.element_hash() for p in self._of.loop.parameters for x in ca.symvar(ca.SX(p.symbol))}
            if all(x.element_hash() in known for x in ca.symvar(margin)):
                found |= {"margin": self._vector("margin", margin), "strict": item.strict}
        return found

    def _conclusions(self) -> list[dict[str, Any]]:
        """What `verify` concludes, with the signal's vector where it is known."""
        signals = {} if self._of.over_samples else signals_of(self._of)
        found = list[dict[str, Any]]()
        for item in self._verdict.statements:
            if not item.estimate:  # the checker derives from the steps what it says of an estimate
                known = item.signal in signals
                vector = self._vector(f"signal {item.signal}", signals[item.signal]) if known else None
                found.append({"signal": str(item.signal), "says": item.says, "vector": vector})
        return found

    def _over_samples(self, claim: data.Claim) -> dict[str, Any]:
        steps = [
            {
                "rule": item.rule,
                "estimate": f"{part.block}.{item.estimate}",
                "sizes": list(item.sizes),
                "rows": item.rows,
                "box": item.box,
                "parts": {name: self._id(out) for name, out in item.parts.items() if name != "theta"},
            }
            for part in claim.parts
            for item in part.steps
        ]
        return {"steps": steps}

    def _labels(self, claim: data.Claim) -> set[str]:
        """Labels that the file's statements name."""
        states = {symbol.label for symbol in claim.symbols if symbol.kind in ("state", "time")}
        states |= self._moving
        return states | {f"{item['state']}, correction" for _, item in self._projected} | set(claim.moves)


def data_rule(term: Any) -> str:
    """Name of a term's rule in a claim."""
    from dmframe.certify.assemble import RULES

    return RULES[type(term).__name__]
