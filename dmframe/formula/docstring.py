r"""Check of the equations in a block's docstring: each displayed equation is evaluated and compared with the code.

The left side of an equation is an output, the rate of a state, S, :math:`\dot S`, or a new name that other equations
use; a name may also be defined in the text, ``:math:`e = q - q_r```. If an option changes the law, the docstring may
state the laws of several options: each equation has to hold for one option, and each output and rate in the docstring
needs an equation that holds for the default options.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Iterator, Mapping, Sequence
from enum import Enum
from itertools import chain
from typing import Any, Final, final

import numpy as np

from dmframe.block import AbstractBlock
from dmframe.block.parameter import specs
from dmframe.common.errors import BlockError, DmframeError, raise_all
from dmframe.common.names import Symbol
from dmframe.formula.alone import variants
from dmframe.formula.latex import evaluate, name_in, spelled
from dmframe.formula.laws import ReadBlock
from dmframe.formula.matrices import Numbers, UnreadableLatexError
from dmframe.formula.meanings import point_of, undotted, values_at
from dmframe.formula.points import ALL_SIZES, FEW, NEAR, differs, differs_near, is_rounding, jittered
from dmframe.formula.stated import Stated, equations_of, shown, source_of


@final
class UnreadError(DmframeError):
    """An equation of a docstring that cannot be read, so that it cannot be compared with the code."""


def check_docstring(block: type[AbstractBlock]) -> list[DmframeError]:
    """Equations in the docstring of a block that its code does not compute; each with file and line."""
    return list(_checked(block))


def check_docstrings(blocks: Mapping[str, ReadBlock]) -> list[str]:
    """Raise the equations in the docstrings of a diagram's blocks that their code does not compute.

    Returns the equations that cannot be compared, each with file and line.
    """
    found = _faults(blocks)
    raise_all([fault for fault in found if not isinstance(fault, UnreadError)])
    return [fault.text for fault in found]


def _faults(blocks: Mapping[str, ReadBlock]) -> list[DmframeError]:
    """Faults of the docstrings, for block types and for the blocks with the values of this diagram."""
    kinds = dict.fromkeys(type(read.model.block) for read in blocks.values())
    found = [fault for kind in kinds for fault in check_docstring(kind)]
    if any(not isinstance(fault, UnreadError) for fault in found):
        return found
    stated = {kind: list(equations_of(kind)) for kind in kinds}
    if not any(stated.values()):
        return found
    here = list[DmframeError]()
    for read in blocks.values():
        equations = stated[type(read.model.block)]
        if equations and (seen := _identity(read)) not in _CONFIRMED:
            faults = list(_with_these_values(read, equations))
            here += faults
            if not faults:
                _CONFIRMED.add(seen)
    known = {fault.text for fault in found}
    return found + [fault for fault in here if fault.text not in known]


_CONFIRMED: Final = set[tuple[Any, ...]]()
"""Blocks whose docstrings are correct, so that a sweep or another check of a graph does not read them again."""


def _identity(read: ReadBlock) -> tuple[Any, ...]:
    """A block with its values, and its sizes and true values in a diagram."""
    model = read.model
    symbols = (*model.inputs.items(), *model.states.items(), *model.parameters.items())
    sizes = tuple((name, symbol.shape) for name, symbol in symbols)
    return type(model.block), repr(model.block), sizes, read.reading.zero, tuple(read.claimed)


def _with_these_values(read: ReadBlock, equations: Sequence[Stated]) -> Iterator[DmframeError]:
    """Equations of the docstring that the block does not compute with the values of this diagram.

    Docstrings are checked for a type with each option separately. An option may have a law that is not in the
    docstring. If such options are combined in a diagram, a missing equation is reported, but it is not a fault of the
    equations that are stated.
    """
    block = read.model.block
    checker = _Checker(equations)
    checker.compare(read, plain=True)
    file, _ = source_of(type(block))
    if next(variants(type(block)), None) is None:
        yield from (kind(f"{file}:{line}: {text}") for line, text, kind in checker.faults())
        return
    if not checker.late:  # reading the block with all its options is slow
        return
    known = [(_options(other.model.block), plain) for other, plain in variants(type(block))]
    if (_options(block), False) in known:  # an option whose law is not in the docstring
        return
    fault = BlockError if (_options(block), True) in known else UnreadError
    for item in checker.late:
        text = f"{shown(item.left)}: no equation for it is what {read.name} computes with the values of this diagram"
        yield fault(f"{file}:{item.line}: {text}")


def _options(block: AbstractBlock) -> dict[str, Any]:
    """The values of a block's options, and the parameters that it has."""
    known = specs(type(block))
    held = {name: getattr(block, name) for name in type(block).model_fields}
    return {name: value is not None if name in known else value for name, value in held.items()}


@functools.lru_cache(maxsize=256)
def _checked(block: type[AbstractBlock]) -> tuple[DmframeError, ...]:
    equations = list(equations_of(block))
    if not equations:
        return ()
    checker = _Checker(equations)
    for read, plain in variants(block):
        if checker.compare(read, plain=plain):
            break
    if not checker.tried:
        return ()
    file, _ = source_of(block)
    return tuple(kind(f"{file}:{line}: {text}") for line, text, kind in checker.faults())


_SWITCHES: Final = re.compile(r"max|min|sgn|clip|[<>]")
"""Switching functions in readable LaTeX."""


def _name_of(item: Stated) -> tuple[Symbol, bool] | None:
    """The name on the left of an equation; None if the left side is something else."""
    try:
        return name_in(item.left)
    except UnreadableLatexError:
        return None


class _Verdict(Enum):
    """Result of checking an equation with some options."""

    HOLDS = "holds"
    DIFFERS = "is not what the code computes"
    UNREADABLE = "cannot be read"
    DEFINES = "defines a name"
    SKIPPED = "is about something else"


_BAD: Final = (_Verdict.DIFFERS, _Verdict.UNREADABLE)


@final
class _Trial:
    """A docstring's equations with some options of the block, at one point."""

    def __init__(
        self, read: ReadBlock, values: Mapping[str, Any], equations: Sequence[Stated], *, is_near: bool = False
    ) -> None:
        self._is_near = is_near
        self.point, self.used = point_of(read, values), set[Symbol]()
        self._read, self._values, self._equations = read, values, equations
        self.compared = (np.zeros(0), np.zeros(0))
        self._open = dict[Symbol, Stated]()
        self._known = dict[Symbol, Numbers]()
        for item in equations:
            left = _name_of(item)
            if left is not None and self._is_new(left[0]):
                self._open.setdefault(left[0], item)

    def _is_new(self, name: Symbol) -> bool:
        return self.point.look(name) is None and undotted(name) is None and not name.start

    def is_computed(self, item: Stated) -> bool:
        """True if the block computes its left side with these options."""
        left = _name_of(item)
        if left is None:
            return False
        return left[0] in self.point.computed or self.point.moved(left[0]) is not None

    def _look(self, name: Symbol) -> Numbers | None:
        found = self.point.look(name)
        if found is not None or name in self._known:
            return self._known.get(name) if found is None else found
        if name not in self._open:
            return None
        self.used.add(name)
        meant = self._open.pop(name)  # removed while it is read, so that it cannot depend on itself
        try:
            self._known[name] = self._value(meant.right)
        finally:
            self._open[name] = meant
        return self._known[name]

    def _value(self, words: Sequence[str]) -> Numbers:
        value: Numbers = evaluate(words, self._look, self.point.call)
        return value

    def verdict(self, item: Stated) -> tuple[_Verdict, str]:
        """The result for an equation, and the message."""
        try:
            with np.errstate(all="ignore"):  # values that are not finite are compared, without warnings
                self.compared = (np.zeros(0), np.zeros(0))
                found = self._verdict(item)
                differ = found[0] is _Verdict.DIFFERS and self.compared[0].size
                doubted = differ and not (self._is_near and differs_near(*self.compared))
                return (_Verdict.HOLDS, "") if doubted and is_rounding(*self.compared, self._near(item)) else found
        except UnreadableLatexError as error:
            return _Verdict.UNREADABLE, f"{item.source}: it cannot be read: {error}"
        except Exception as error:  # a docstring may contain anything; that is not a fault of the code
            return _Verdict.UNREADABLE, f"{item.source}: it cannot be read: {type(error).__name__}: {error}"

    def _near(self, item: Stated) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """The compared values at points that differ in their last digits."""
        for values in jittered(self._values):
            trial = _Trial(self._read, values, self._equations)
            trial._verdict(item)
            yield trial.compared

    def _verdict(self, item: Stated) -> tuple[_Verdict, str]:
        left = name_in(item.left)
        if not item.left:
            raise UnreadableLatexError("it is not an equation")
        if left is None:
            if not item.displayed:
                return _Verdict.SKIPPED, ""
            return self._compared(self._value(item.left), item.right, shown(item.left))
        name, label = left[0], spelled(left[0])
        bare = undotted(name)
        if "\\int" in item.right:
            return self._integral(name, item)
        if name in self.point.computed:
            return self._compared(self.point.computed[name], item.right, label)
        moved = self.point.moved(name)
        if moved is not None:
            return self._compared(moved, item.right, label)
        if not item.displayed:
            return _Verdict.SKIPPED, ""
        if self.point.look(name) is not None or name.start:
            return _Verdict.DIFFERS, f"{label}: an equation for it, but the block does not compute it"
        if bare is not None and bare in self.point.after:
            text = f"an equation for its rate, but {spelled(bare)} is a sampled state; write {spelled(bare)}^+"
            return _Verdict.DIFFERS, f"{label}: {text}"
        if bare is not None:
            return _Verdict.DIFFERS, f"{label}: an equation for its rate, but the block has no state {spelled(bare)}"
        self._value(item.right)
        return _Verdict.DEFINES, label

    def _integral(self, name: Symbol, item: Stated) -> tuple[_Verdict, str]:
        r"""A = \int b of a state a: its rate is b."""
        words = item.right[item.right.index("\\int") + 1 :]
        if name in self.point.rates:
            return self._compared(self.point.rates[name], words, f"rate of {spelled(name)}")
        if item.displayed:
            raise UnreadableLatexError("an integral is allowed for a state only")
        return _Verdict.SKIPPED, ""

    def _compared(self, computed: Numbers, words: Sequence[str], shown: str) -> tuple[_Verdict, str]:
        value = self._value(words)
        if value.shape == (1, 1) != computed.shape:
            value = np.full(computed.shape, value[0, 0])
        self.compared = computed, value
        text = f"{shown}: the docstring's law is not what the equations compute"
        if shown in ("S", r"\dot{S}"):
            text = f"{shown}: the docstring's law is not that of the certificate"
        return (_Verdict.DIFFERS, text) if differs(computed, value) else (_Verdict.HOLDS, "")


@final
class _Checker:
    """Compares one block's docstring with its code for several choices of options."""

    def __init__(self, equations: Sequence[Stated]) -> None:
        self._equations = equations
        self._verdicts = dict[Stated, tuple[_Verdict, str]]()
        self._fine, self._used = set[Stated](), set[str]()
        self._late = dict[str, Stated]()
        self.late = list[Stated]()
        self._meant = set[str]()
        self.tried = 0
        self._switches = any(_SWITCHES.search("".join(item.right)) for item in equations)

    def compare(self, read: ReadBlock, *, plain: bool) -> bool:
        """Compare all equations with a block; returns true if every equation has been confirmed."""
        seeds = range(ALL_SIZES) if self._switches or read.has_switch else FEW
        points = [values_at(read, seed, self._equations) for seed in seeds]
        trials = [
            _Trial(read, item, self._equations, is_near=seed < NEAR) for seed, item in zip(seeds, points, strict=True)
        ]
        fine = set[Stated]()
        for item in self._equations:
            found = (trial.verdict(item) for trial in trials)
            first = next(found)
            worst = next((one for one in chain([first], found) if one[0] in _BAD), first)
            if worst[0] in (_Verdict.HOLDS, _Verdict.DEFINES, _Verdict.SKIPPED):
                fine.add(item)
            if item not in self._verdicts or (
                self._verdicts[item][0] is not _Verdict.DIFFERS and worst[0] is _Verdict.DIFFERS
            ):
                self._verdicts[item] = worst
        self._used |= {spelled(name) for trial in trials for name in trial.used}
        self._meant |= {shown(item.left) for item in self._equations if trials[0].is_computed(item)}
        if plain:
            self._late = self._not_yet(fine, trials[0])
        self._fine |= fine
        self.tried += 1
        # an equation in the text with unknown names is not a law, and requires no further options
        return all(
            item in self._fine or (not item.displayed and self._verdicts[item][0] is _Verdict.UNREADABLE)
            for item in self._equations
        )

    def _not_yet(self, fine: set[Stated], trial: _Trial) -> dict[str, Stated]:
        """Left sides without an equation that holds with the default options, each with its first equation."""
        sides = dict[str, list[Stated]]()
        for item in self._equations:
            if trial.is_computed(item):
                sides.setdefault(shown(item.left), []).append(item)
        bad = [items for items in sides.values() if not any(item in fine for item in items)]
        self.late = [items[0] for items in bad if all(self._verdicts[item][0] is _Verdict.DIFFERS for item in items)]
        return {shown(items[0].left): items[0] for items in bad if any(item.displayed for item in items)}

    def faults(self) -> Iterator[tuple[int, str, type[DmframeError]]]:
        """Faults, each with its line."""
        held = {shown(item.left) for item in self._fine}
        for item in self._equations:
            verdict, text = self._verdicts[item]
            if item not in self._fine:
                if item.displayed or verdict is _Verdict.DIFFERS or shown(item.left) in self._meant - held:
                    yield item.line, text, UnreadError if verdict is _Verdict.UNREADABLE else BlockError
            elif verdict is _Verdict.DEFINES and text not in self._used:
                text = f"{text}: the block has no signal or parameter of this name, and no other equation uses it"
                yield item.line, text, UnreadError
            elif self._late.get(shown(item.left)) is item:
                text = f"{' '.join(item.left)}: no equation for it holds with the options at their defaults"
                yield item.line, text, BlockError
