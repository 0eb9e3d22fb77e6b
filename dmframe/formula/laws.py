"""The laws of a diagram: each block is read, compared with its code, and printed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any, final

import casadi as ca
import numpy as np

from dmframe.block.certificate import Certificate
from dmframe.block.model import BlockModel, symbols_in
from dmframe.block.naming import as_mx, expression_of
from dmframe.common.errors import BlockError, DmframeError
from dmframe.diagram import ClosedLoop, Diagram
from dmframe.diagram.view import View
from dmframe.diagram.wire_checks import same_unit
from dmframe.diagram.wiring import Zero
from dmframe.formula.elements import Elements
from dmframe.formula.fold import folded, is_difference, names_of
from dmframe.formula.formula import Formula
from dmframe.formula.law import Energy, Line, PrintedLaw, line, lines, pieces_of, rate_of
from dmframe.formula.points import MOST, Balls, Draw, Numbers, Pair, equal, in_balls, switching
from dmframe.formula.read import UnreadableError, read
from dmframe.formula.reading import Evaluated, Reading, Signs, place_of
from dmframe.formula.robot import RobotFunctions
from dmframe.formula.tree import SCALAR, Name, Node, Unprinted


def printed(diagram: Diagram, name: str) -> PrintedLaw:
    """The law of one block. Raises `BlockError` if it differs from the code that runs."""
    return laws_of(diagram)[name]


def laws_of(diagram: Diagram) -> dict[str, PrintedLaw]:
    """The laws of all blocks of a diagram. Raises `BlockError`, or several, if one differs from the code that runs."""
    return {name: block.law() for name, block in read_blocks(diagram).items()}


def read_blocks(diagram: Diagram, *, near: bool = False) -> dict[str, ReadBlock]:
    """All blocks of a diagram, read and compared with their code; at a few points if `near`. Raises as `laws_of`."""
    robots = [model.robot for model in diagram.models.values() if model.robot is not None]
    functions = RobotFunctions(robots[0]) if robots else None
    blocks = {name: _read(diagram, name, functions) for name in diagram.blocks}
    certify(blocks)
    for block in blocks.values():
        block.compare(near=near)
    return blocks


def certify(blocks: Mapping[str, ReadBlock]) -> None:
    """Read every certificate, in the order of the true values that they need from each other."""
    waiting, stated = list(blocks), dict[str, Any]()
    for _ in range(2 * len(blocks)):
        later = []
        for name in waiting:
            certificate = blocks[name].certify(stated)
            if certificate is None:
                later.append(name)
            else:
                stated |= certificate.truth
        early = [name for name in blocks if name not in later and blocks[name].lacked(stated)]
        if (len(later) == len(waiting) or not later) and not early:
            return
        waiting = [*later, *early]


def _truths(diagram: Diagram, name: str) -> dict[str, tuple[int, int]]:
    """The shapes of the true values whose letters are bound."""
    shapes = dict[str, tuple[int, int]]()
    for port in diagram.blocks[name].truth:
        if all(word.isdigit() or word in diagram.sizes.bound for word in port.shape.split()):
            shapes[port.name] = diagram.sizes.matrix(port.shape)
    return shapes


def _read(diagram: Diagram, name: str, functions: RobotFunctions | None) -> ReadBlock:
    zero = {port for (block, port), source in diagram.sources.items() if block == name and source == Zero()}
    made = {
        port.name
        for port in diagram.blocks[name].truth
        for model in diagram.models.values()
        for other in model.block.outputs
        if other.name == port.name and other.name in model.equations.outputs and same_unit(other, port)
    }
    shapes = _truths(diagram, name)
    return ReadBlock(diagram.models[name], functions, truths=shapes, made=frozenset(made), zero=frozenset(zero))


@final
class ReadBlock:
    """One block while it is read: as matrices (MX) or, if that fails, as scalars (SX).

    Parameters
    ----------
    model
        The block's equations that run.
    truths
        Shapes of the true values that it may read.
    made
        True values that are outputs of other blocks; the others come from certificates.
    zero
        Inputs that are not driven.
    """

    def __init__(
        self,
        model: BlockModel,
        functions: RobotFunctions | None,
        *,
        truths: Mapping[str, tuple[int, int]],
        made: frozenset[str],
        zero: frozenset[str] = frozenset(),
    ) -> None:
        self.name, self.model, self.made = model.name, model, made
        self.type = type(model.block)
        self.reading = Reading(model.name, model, truths, functions, zero)
        self.certificate, self.scalars, self.claimed = Certificate(), Certificate(), list[str]()
        self.elements, self.names = Elements({}), dict[Node, Name]()
        self._points = dict[int, dict[str, Any]]()
        try:
            self._read(ca.MX)
        except (DmframeError, KeyboardInterrupt):
            raise
        except BaseException:  # a block that mixes SX into MX may fail in any way; it is then read as scalars
            self._read(ca.SX)

    def _read(self, kind: Any) -> None:
        self.signs = self.reading.signs(kind)
        self.scalar_signs = self.signs
        self.stated = self.reading.equations(self.signs)
        self.elements = Elements(self.signs.names if kind is ca.SX else {})

    def certify(self, stated: Mapping[str, Any]) -> Certificate | None:
        """Read the certificate with the true values from other blocks; None if one is missing."""
        self.claimed = list(self._known(stated))
        try:
            self.certificate = self._certificate(self.signs)
        except BlockError as error:
            if error.location:
                raise
            return None
        except KeyboardInterrupt:
            raise
        except BaseException:  # as above
            if self.signs.kind is ca.SX:
                return None
            self._read(ca.SX)
            return self.certify(stated)
        return self.certificate

    def lacked(self, stated: Mapping[str, Any]) -> bool:
        """True if a true value that the certificate reads has become available since the certificate was read."""
        return list(self._known(stated)) != self.claimed

    def _known(self, stated: Mapping[str, Any]) -> Iterator[str]:
        """The true values that this diagram has, as in `dmframe.diagram.view`."""
        found = set[str]()
        for port in self.model.block.truth:
            if port.name in stated:
                value = expression_of(stated[port.name])
                if value.is_constant():
                    number = ca.DM(value) if isinstance(value, ca.SX | ca.DM) else value.to_DM()
                    self.reading.constants[port.name] = number
                    self.signs.columns["truths"][port.name] = self.signs.kind(number)
            if (
                port.name in stated or port.name in self.made or port.derivative_of in found
            ) and port.name in self.reading.truths:
                found.add(port.name)
                yield port.name

    def _certificate(self, signs: Signs) -> Certificate:
        stated = self.reading.certificate(signs, self.claimed)
        return stated if stated is not None else Certificate()

    @cached_property
    def has_switch(self) -> bool:
        """True if the code that runs contains a switch."""
        return self.reading.of_running().turns() is not None

    def compare(self, *, near: bool = False) -> None:
        """Compare the reading with the code that runs; at the first points only if `near`. Raises `BlockError`."""
        reading, signs = self.reading, self.signs
        runs, printed = self.model.equations, self.stated
        names = [f"the output {name}" for name in runs.outputs]
        names += [f"the {'next value' if name in runs.next else 'rate'} of {name}" for name in runs.moves]
        stated = [printed.outputs.get(name) for name in runs.outputs]
        stated += [printed.moves.get(name) for name in runs.moves]
        if None in [item if item is None else 0 for item in stated]:
            raise self._fault("equations", names[[item is None for item in stated].index(True)])
        pairs = [("equations", names, reading.of_signs(signs, stated), reading.of_running())]
        self.scalars, self.scalar_signs = self.certificate, signs
        if signs.kind is ca.MX:
            other = self.scalar_signs = reading.signs(ca.SX)
            self.scalars = self._certificate(other)
            self.elements = Elements(other.names)
            labels, mine = self._labelled(self.certificate, self.scalars)
            theirs = [piece for _, piece in pieces_of(self.scalars)]
            both = reading.of_signs(signs, mine), reading.of_signs(other, theirs)
            pairs.append(("certificate", labels, *both))
        again = [
            *signs.naming.again,
            *((n, self.stated.outputs[n]) for n in signs.naming.definitions if n in self.stated.outputs),
        ]
        if again:
            given = [name for name, _ in again]
            first = reading.of_signs(signs, [signs.naming.definitions[name][1] for name in given])
            second = reading.of_signs(signs, [expression for _, expression in again])
            pairs.insert(0, ("equations", [f"{name}, named twice," for name in given], first, second))
        self._points.clear()
        for method, labels, first, second in pairs:
            self._compared(method, labels, first, second, near=near)

    def _compared(self, method: str, labels: Sequence[str], first: Evaluated, second: Evaluated, *, near: bool) -> None:
        """Compare expressions: exactly, or at points on both sides of each switch. Raises `BlockError`."""
        both = None if near else self.reading.exactly(first, second)
        known = [False] * len(labels)
        if both is not None:
            known = equal(both[0].expressions, both[1].expressions)
            first, second = both[0].only(known), both[1].only(known)
        if all(known):
            return
        turns = [] if near else [found for side in (first, second) if (found := side.turns()) is not None]
        left = [label for label, done in zip(labels, known, strict=True) if not done]
        pair = Pair(
            self._values,
            lambda values: (first.at(values), second.at(values), [found.at(values)[0] for found in turns]),
            lambda values, place: (first.in_balls(values, place), second.in_balls(values, place)),
        )
        self._same(method, left, pair, near=near)

    def _same(self, method: str, labels: Sequence[str], pair: Pair, *, near: bool) -> None:
        """Compare at points. Raises `BlockError`."""
        place, covered = pair.compared(near=near)
        if place is not None:
            raise self._fault(method, labels[place])
        if not covered:
            raise self._one_sided(method, labels)

    def _values(self, seed: int) -> dict[str, Any]:
        if seed not in self._points:
            self._points[seed] = self.reading.values(self.signs, seed)
        return self._points[seed]

    def compare_certificate(self, proved: Certificate, seen: View, loop: ClosedLoop, *, near: bool = False) -> None:
        """Compare the printed certificate with the one that is proved for the whole closed loop.

        If `near`, at the first points only. Raises `BlockError`: a method that returns different results to its callers
        could prove one law and print another.
        """
        given = (seen.u, seen.x, seen.p, seen.truth)
        pairs = dict[str, tuple[Any, Any]]()
        for columns, signals in zip(self.scalar_signs.columns.values(), given, strict=True):
            for name, symbol in columns.items():
                if symbol.nnz() and symbol.is_valid_input() and name in signals:  # else a number
                    pairs.setdefault(str(symbol), (symbol, ca.project(getattr(signals, name), symbol.sparsity())))
        labels, mine = self._labelled(self.scalars, proved)
        symbols, meanings = zip(*pairs.values(), strict=True) if pairs else ((), ())
        expected = ca.substitute(
            [ca.SX(piece) for piece in self.scalar_signs.meant(mine)], list(symbols), list(meanings)
        )
        found = [ca.SX(piece) for _, piece in pieces_of(proved)]
        both = loop.joined([*expected, *found])
        functions = self.reading.functions
        nothing = ca.SX(0, 1), ca.DM(0, 1)
        constants, numbers_of = nothing if functions is None else (functions.constants, functions.values)
        ones, others = both[: len(mine)], both[len(mine) :]
        done = [False] * len(ones) if near else equal(ones, others)
        if all(done):
            return
        known = symbols_in([constants])  # other values would not be rotations, and M(q) would not be symmetric
        leaves = [leaf for leaf in ca.symvar(ca.veccat(*both)) if leaf.element_hash() not in known]
        left = [item for side in (ones, others) for item, shown in zip(side, done, strict=True) if not shown]
        open_labels = [label for label, shown in zip(labels, done, strict=True) if not shown]
        turns = ca.veccat(ca.SX(0, 1), *([] if near else switching(left)))
        function = ca.Function("proved", [ca.veccat(*leaves), constants], [*left, turns])
        positive = symbols_in([loop.p])
        above = np.array([leaf.element_hash() in positive for leaf in leaves], dtype=bool)
        count = len(open_labels)

        def point(seed: int) -> dict[str, Any]:
            draw = Draw(seed)
            free = [draw.numbers(len(leaves), positive=sign) for sign in (True, False)]
            return {"point": np.where(above, *free)}

        def at(values: Mapping[str, Any]) -> Numbers:
            *numbers, turned = (item.full() for item in function.call([values["point"], numbers_of]))
            return numbers[:count], numbers[count:], [turned]

        def enclosed(values: Mapping[str, Any], place: int) -> Balls:
            one, other = (in_balls(function, [values["point"], numbers_of], k) for k in (place, place + count))
            return one, other

        self._same("certificate", open_labels, Pair(point, at, enclosed), near=near)

    def _labelled(self, one: Certificate, other: Certificate) -> tuple[list[str], list[Any]]:
        """The labels and the expressions of a certificate. Raises `BlockError` where another has other terms."""
        labels = [label for label, _ in pieces_of(one)]
        if labels != [label for label, _ in pieces_of(other)]:
            raise self._fault("certificate", "the list of terms")
        return labels, [piece for _, piece in pieces_of(one)]

    def _fault(self, method: str, label: str) -> BlockError:
        where = place_of(self.type, method)
        text = f"{where}: {label} differs when {method}() is called again; the printed law would not be what runs"
        return BlockError(f"{self.name}: {text}", path=("blocks", self.name))

    def _one_sided(self, method: str, labels: Sequence[str]) -> BlockError:
        where = place_of(self.type, method)
        text = (
            f"{where}: {', '.join(dict.fromkeys(labels))}: a switch, such as a min or a comparison, takes one side at "
            f"all of {MOST} points, so that the printed law cannot be checked on the other side; expected one that "
            f"switches at magnitudes from 1e-3 to 1e3"
        )
        return BlockError(f"{self.name}: {text}", path=("blocks", self.name))

    def law(self) -> PrintedLaw:
        """The printed law."""
        running = self.model.equations
        scalars = Elements(self.reading.running_names())

        nodes = {name: self._node(self.stated.outputs[name], runs, scalars) for name, runs in running.outputs.items()}
        self.names = names_of(nodes, self.signs.naming.taken)
        outputs = [(Name(name, node.shape), folded(node, self.names, name)) for name, node in nodes.items()]
        rates = [
            (
                rate_of(name, runs.shape, sampled=name in running.next),
                self._folded(self.stated.moves[name], runs, scalars),
            )
            for name, runs in running.moves.items()
        ]
        energy = Energy(
            self.certificate,
            self.scalars,
            lambda mine, theirs: self._folded(mine, theirs, self.elements),
            lambda mine, theirs: self._vector(mine, theirs, self.elements),
        )
        stored = bool(energy.terms("storage"))
        claims = stored or bool(energy.terms("dissipation"))
        consumption = energy.consumption()
        return PrintedLaw(
            name=self.name,
            outputs=lines(outputs),
            rates=lines(rates),
            storage=energy.terms("storage"),
            dissipation=energy.terms("dissipation"),
            residual=energy.terms("residual"),
            errors=energy.terms("errors"),
            linear=energy.linear(),
            estimates=energy.estimates(),
            truths=energy.truths(),
            supply=Formula(energy.supply()) if claims else None,
            consumption=consumption,
            definitions=tuple(self._definitions()),
            S=line(Name("S"), energy.S()) if stored else None,
            dS=line(rate_of("S", SCALAR), energy.dS()) if claims else None,
            matrices=self.signs.kind is ca.MX,
        )

    def _definitions(self) -> Iterator[Line]:
        for name, (symbol, expression) in self.signs.naming.definitions.items():
            if name not in self.model.equations.outputs:
                yield line(Name(name, symbol.shape), self._folded(expression, None, self.elements))

    def _folded(self, read_as: Any, runs: Any, elements: Elements) -> Node:
        return folded(self._node(read_as, runs, elements), self.names)

    def _vector(self, read_as: Any, runs: Any, elements: Elements) -> Node:
        """The tree of a vector; a difference of two signals is not replaced by the name of an output."""
        node = self._node(read_as, runs, elements)
        return node if is_difference(node) else folded(node, self.names)

    def _node(self, read_as: Any, runs: Any, elements: Elements) -> Node:
        """The tree from matrices, else element by element from the code that runs, else the names it depends on."""
        if self.signs.kind is ca.MX:
            try:
                return read(as_mx(read_as))
            except UnreadableError:
                if runs is None:
                    return Unprinted(tuple(symbol.name() for symbol in ca.symvar(as_mx(read_as))), read_as.shape)
                return elements.read(self._driven(expression_of(runs)))
        return elements.read(self._driven(ca.SX(expression_of(read_as if runs is None else runs))))

    def _driven(self, expression: Any) -> Any:
        """The expression with zeros for inputs that are not driven."""
        zero = [self.model.inputs[name] for name in self.reading.zero]
        return (
            ca.substitute([ca.SX(expression)], zero, [ca.SX.zeros(*s.shape) for s in zero])[0] if zero else expression
        )
