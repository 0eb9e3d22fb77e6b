"""The certificate file of a proved claim, for a checker that does not use this framework (`dmframe.checker`).

The file contains what a proof starts from, and nothing that was derived: symbols, one program of rational operations,
the parts of the terms of V and of its decrease, rates or next values, projections, conditions and conclusions. It
contains no derivative and no value of V.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from importlib.resources import files
from types import MappingProxyType
from typing import Any, Final, final

import casadi as ca

from dmframe.block.certificate import SX, Lemma, NormalisedSteps, Potential, Square, StableLinear, soft_clip
from dmframe.block.model import symbols_in
from dmframe.certify.assemble import RULES, assembled
from dmframe.certify.canonical import canonical
from dmframe.certify.checked import Checked
from dmframe.certify.claim import Claim, Part
from dmframe.certify.definite import body_matrix, is_matrix
from dmframe.certify.limits import Combinations, full_rank, solutions
from dmframe.certify.statements import linear_subsystems, signals_of
from dmframe.certify.symbols import exact_values, symbols_of
from dmframe.certify.unfolded import Unfolded, energy, lyapunov, square, stepped
from dmframe.certify.verdict import Verdict
from dmframe.common.errors import ValueFault
from dmframe.diagram.projection import Box
from dmframe.diagram.view import view
from dmframe.exact import MERSENNE_127
from dmframe.exact.rational import Interval
from dmframe.prove import claim as data
from dmframe.prove.columns import by_columns
from dmframe.robot.parameters import INERTIAL
from dmframe.robot.pseudo_inertia import pseudo_inertia

FORMAT: Final = "dmframe-certificate"
VERSION: Final = 4

PARTS: Final = {
    "monotone": {"vector": "first", "other": "second", "scale": "scale", "weight": "weight"},
    "potential": {"vector": "vector", "scale": "width", "weight": "weight"},
}
"""Fields of a term from which the checker forms it, by their names in the file; another rule is only named."""


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


def _in_ascii(item: Any) -> Any:
    """The item with other letters escaped in all its texts: a checker accepts none, since some of them look alike."""
    if isinstance(item, str):
        return item.encode("ascii", "backslashreplace").decode()
    if isinstance(item, dict):
        return {_in_ascii(key): _in_ascii(value) for key, value in item.items()}
    return list(map(_in_ascii, item)) if isinstance(item, list | tuple) else item


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
        own = self._own_statements()
        rates = {} if of.over_samples else self._rates()
        self._claim = claim = assembled(of, self._verdict.uncertain, self._more)
        found: dict[str, Any] = {"format": FORMAT, "version": VERSION, "about": dict(about), "over": claim.operator}
        moved = dict(claim.moved) if of.over_samples else rates
        self._moving = moved.keys()
        found["rates"] = {label: self._id(out) for label, out in moved.items()}
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
        found = canonical(found, kappa.chosen if kappa else Fraction(1))
        kept = {key: found[key] for key in ("about", "program", "vectors")}
        return {**_in_ascii(found), **kept}

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

    def _own_statements(self) -> dict[str, Any]:
        """Statements whose expressions are entered before the program is read."""
        of = self._of
        places, terms = dict[tuple[str, str, int], int](), list[dict[str, Any]]()
        for part in of.parts:
            for role, k, item in self._unfolded(part):
                places.setdefault((part.block, role, k), len(terms))
                terms.append(self._entered(item, part))
        found: dict[str, Any] = {"conditions": list(map(self._condition, self._verdict.conditions))}
        self._projected = [] if of.over_samples else list(self._projections(terms, places))
        found["cross"] = [] if of.over_samples else list(self._cross(places, terms))
        found["terms"] = terms + self._projected
        if not of.over_samples:
            found["robots"] = list(self._robots())
            pairs = [lyapunov(self._joined(item)) for _, item in linear_subsystems(of) if not item.inputs]
            found["stable"] = [{key: self._vector(key, x) for key, x in item.items()} for item in pairs if item]
            found["ranks"] = list(self._ranks())
        found["conclusions"] = self._conclusions()
        return found

    def _unfolded(self, part: Part) -> Iterator[tuple[str, int, Unfolded]]:
        """Role and position in the block's certificate of each term of the file, and the term."""
        stated = part.certificate
        for item in stated.steps:
            label = f"{part.block}.{item.estimate}"
            if isinstance(item, NormalisedSteps):
                yield from (("steps", 0, term) for term in stepped(label, item))
            else:
                yield "steps", 0, Unfolded(label, "dissipated", item.rule, {})
        for role, name, terms in (
            ("stored", "stored", stated.storage),
            ("dissipation", "dissipated", stated.dissipation),
            ("residual", "residual", stated.residual),
        ):
            for k, term in enumerate(terms):
                yield from ((role, k, item) for item in self._of_term(f"{part.block}: {term.of}", name, term))
        if stated.consumes is not None:
            yield "cross", 0, square(part.block, "cross", stated.consumes.vector, stated.consumes.c)

    def _of_term(self, name: str, role: str, term: Any) -> Iterator[Unfolded]:
        if isinstance(term, Square):
            found = None
            if role == "stored" and (is_matrix(self._of, term.weight) or term.vector.is_scalar()):
                found = body_matrix(self._of, (term.weight + term.weight.T) / 2)
            if found is None:
                yield square(name, role, term.vector, term.weight, term.positive or None)
            else:
                q, robot, inertia, rotors = found
                yield from energy(name, robot, q, term.vector, inertia, rotors)
        else:
            rule = RULES[type(term).__name__]
            parts = {key: ca.SX(getattr(term, own)) for key, own in PARTS.get(rule, {}).items()}
            yield Unfolded(name, role, term.phi if isinstance(term, Lemma) else rule, parts)

    def _entered(self, item: Unfolded, part: Part) -> dict[str, Any]:
        """A term with the names of its vectors; `level` is that of its block in a cascade."""
        cascade = part.cascade or not self._of.cascaded
        parts = {key: self._vector(f"{item.name}: {key}", x) for key, x in item.parts.items()}
        own = {"name": item.name, "role": item.role, "rule": item.rule, "assumed": item.assumed}
        return {**own, "level": "" if cascade else "kappa", "parts": parts}

    def _cross(self, places: Mapping[Any, int], terms: Sequence[Any]) -> Iterator[dict[str, Any]]:
        """Cross terms, each with its shares of the squares that dominate it."""
        for consumer, block in self._of.cross_terms:
            assert block is not None
            by = [
                [self._vector(f"{block.block}: share", share), places[block.block, "dissipation", k]]
                for k, share in enumerate(block.certificate.dominates)
                if not ca.SX(share).is_zero()
            ]
            yield {"term": places[consumer.block, "cross", 0], "by": by}

    def _projections(self, terms: Sequence[Any], places: Mapping[Any, int]) -> Iterator[dict[str, Any]]:
        """Terms of the projected estimates, with the weight that the stored square of the error has."""
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
                wide = ca.SX.zeros(projection.state.shape[0])
                true = of.loop.joined([estimate.value + wide])[0]
                parts = {"vector": projection.state, "correction": projection.correction, "true": true}
                if isinstance(projection.set, Box):
                    parts |= {"lower": projection.set.lower + wide, "upper": projection.set.upper + wide}
                rule = "projected" if isinstance(projection.set, Box) else projection.kind
                item = self._entered(Unfolded(projection.name, "dissipated", rule, parts), part)
                stored = terms[places[part.block, "stored", place]]
                item["parts"] |= {"weight": stored["parts"]["weight"]} if "weight" in stored["parts"] else {}
                yield item

    def _joined(self, item: StableLinear) -> StableLinear:
        joined = self._of.loop.joined
        rates = tuple(tuple(joined(list(map(ca.SX, row)))) for row in item.rates)
        return replace(item, vectors=tuple(joined(list(item.vectors))), rates=rates)

    def _robots(self) -> Iterator[dict[str, Any]]:
        """Robots whose acceleration follows from the torque of servo, environment and friction."""
        of = self._of
        for name, model in of.diagram.models.items():
            outputs, robot = set(model.equations.outputs), model.robot
            if robot is None or not {"q", "dq", "ddq", "K", "B", "D"} <= outputs:
                continue
            seen = view(of.diagram, name, of.truths).u
            out = {key: of.diagram.resolver.output(name, key) for key in ("q", "dq", "ddq", "K", "B", "D")}
            share = of.diagram.resolver.output(name, "g_share") if "g_share" in outputs else ca.SX(1)
            torque = out["K"] * seen.u - out["B"] * out["dq"] - out["D"] * robot.coulomb(out["dq"])
            torque = torque + (seen.tau_ext if "tau_ext" in seen else 0)
            wanted = (out["q"], out["dq"], out["ddq"], share, torque)
            q, dq, ddq, share, torque = of.loop.joined(list(wanted))
            moved = robot.inverse_dynamics(q, dq, dq, ddq, robot.inertia, gravity_share=share)
            rotors = ca.SX.zeros(robot.n)
            if "I_r" in outputs:
                rotors = ca.densify(of.loop.joined([of.diagram.resolver.output(name, "I_r")])[0] + rotors)
            labels = [v.label for v in of.loop.plant if ca.is_equal(v.symbol, q)]
            if labels and symbols_of(of).vanishes("motion", moved + rotors * ddq - torque, trials=1):
                own = {"rotors": rotors, "gravity": share * robot.gravity, "torque": torque}
                own = {key: self._vector(f"{name}: {key}", x) for key, x in own.items()}
                yield {"position": labels[0], "joints": list(self._joints(robot, q)), **own}

    def _joints(self, robot: Any, q: SX) -> Iterator[dict[str, Any]]:
        """Joints with the transforms of their bodies, [R r] at q, and the bodies' pseudo-inertias."""
        rows = ca.vertsplit(robot.inertia, len(INERTIAL))
        for joint, link, body in zip(robot.chain.joints, robot.links(q), rows, strict=True):
            S = pseudo_inertia(ca.vertsplit(body))
            lower = ca.vertcat(*(S[i][k] for i in range(4) for k in range(i + 1)))
            own = {"axis": link.axis, "place": ca.horzcat(link.rotation, link.offset), "body": lower}
            yield {"kind": joint.kind, **{key: self._vector(f"{joint.name}: {key}", x) for key, x in own.items()}}

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

    def _labels(self, claim: data.Claim) -> set[str]:
        """Labels that the file's statements name."""
        states = {symbol.label for symbol in claim.symbols if symbol.kind in ("state", "time")}
        states |= self._moving
        return states | {f"{item['name']}, correction" for item in self._projected} | set(claim.moves)
