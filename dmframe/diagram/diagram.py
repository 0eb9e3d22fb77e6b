"""Diagrams: blocks, sizes and wires, and the closed loop made from them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Any, Final, final

from dmframe.block import AbstractBlock, type_name
from dmframe.block.model import SYMBOLIC, BlockModel, model_block
from dmframe.block.port import Output
from dmframe.block.sizes import Sizes, bind_sizes, parameter_arrays
from dmframe.block.steady import Steadiness
from dmframe.block.symmetric import unique
from dmframe.common.copies import shared
from dmframe.common.errors import (
    BlockError,
    DmframeError,
    MissingError,
    SizeError,
    UnitError,
    WiringError,
    raise_all,
)
from dmframe.diagram.closed_loop import ClosedLoop, Parameter
from dmframe.diagram.fingerprint import fingerprint
from dmframe.diagram.flatten import flatten
from dmframe.diagram.resolve import Resolver
from dmframe.diagram.wire_checks import check_truths, check_wires
from dmframe.diagram.wiring import (
    End,
    Outputs,
    Source,
    Way,
    Wire,
    unread,
    ways,
    wire_blocks,
)

LONG: Final = 5000
"""Operations of all blocks from which on the check of their equations takes longer than a copy of the process."""


@final
@dataclass(frozen=True, repr=False)
class Diagram:
    """Checked and wired blocks with their closed loop.

    Parameters
    ----------
    blocks
        By name, in the order of the file.
    sources
        What drives each input.
    models
        Symbolic equations of each block.
    sizes
        Numbers bound to the letters of the shapes.
    robot
        The `dmframe.robot.SerialChain`, if there is one.
    loop
        The flattened diagram.
    """

    blocks: Mapping[str, AbstractBlock]
    sources: Mapping[End, Source]
    models: Mapping[str, BlockModel]
    sizes: Sizes
    robot: Any
    loop: ClosedLoop
    resolver: Resolver = field(repr=False)

    @classmethod
    def build(
        cls, blocks: Mapping[str, AbstractBlock], wires: Mapping[str, str] | None = None, robot: Any = None
    ) -> Diagram:
        """Wire and flatten blocks.

        Parameters
        ----------
        blocks
            The blocks by name.
        wires
            ``{"task.x": "observer.x_o"}``: the input takes this output. An input not named here takes the one output of
            its own name.
        robot
            A `dmframe.robot.SerialChain`, required if a block uses one.

        Raises
        ------
        DmframeError
            All faults that can be found, together: `Faults` if there are several.
        """
        if not blocks:
            raise MissingError("blocks: expected at least one block, found none", path=("blocks",))
        raise_all(_contracts(blocks))
        sizes, faults = bind_sizes(blocks, robot)
        values = dict[str, Any]()
        if not faults:
            for name, block in blocks.items():
                values[name], wrong = parameter_arrays(name, block, sizes, blocks, robot)
                faults += wrong
        if faults:
            _, more = wire_blocks(blocks, declared_outputs(blocks), wires or {})
            raise_all([*_causes(faults, blocks, more), *more])
        symbolic = _symbolic(robot)
        models, unchecked = dict[str, BlockModel](), list[Steadiness]()
        for name, block in blocks.items():
            try:
                models[name] = model_block(name, block, values[name], sizes, symbolic, unchecked)
            except DmframeError as fault:
                fault.path = fault.path or ("blocks", name)
                faults.append(fault)
        jobs = [partial(_unsteady, each) for each in unchecked]
        with shared(jobs, busy=True, small=sum(model.size for model in models.values()) < LONG) as finished:
            result: Diagram | DmframeError | None = None
            if not faults:
                try:
                    result = cls._wired(blocks, wires or {}, robot, models, sizes, symbolic)
                except DmframeError as fault:
                    result = fault
            faults += [fault for fault in finished() if fault is not None]
        raise_all(faults)
        if not isinstance(result, Diagram):
            raise result or TypeError(blocks)
        for each in unchecked:
            each.confirm()
        return result

    @classmethod
    def _wired(
        cls,
        blocks: Mapping[str, AbstractBlock],
        wires: Mapping[str, str],
        robot: Any,
        models: Mapping[str, BlockModel],
        sizes: Sizes,
        symbolic: Any,
    ) -> Diagram:
        """Wire and flatten blocks whose equations are well-formed."""
        produced = _produced(models)
        sources, faults = wire_blocks(blocks, produced, wires)
        faults += check_wires(blocks, produced, sources, sizes, wires)
        faults += check_truths(blocks, produced)
        raise_all(faults)
        resolver = Resolver(models, sources, sizes)
        try:
            loop = flatten(resolver, _parameters(models, symbolic))
        except RecursionError:
            text = "blocks: too many blocks in a chain of direct feedthrough; put one with a state between them"
            raise WiringError(text, path=("blocks",)) from None
        raise_all(resolver.faults)
        return cls(dict(blocks), sources, dict(models), sizes, robot, loop, resolver)

    @cached_property
    def fingerprint(self) -> str:
        """The hash of the model: closed loop, wires and initial values; see `fingerprint`."""
        starts = {name: model.stated_start(self.sizes) for name, model in self.models.items()}
        values = {name: model.values for name, model in self.models.items()}
        return fingerprint(self.loop, {"wires": self.sources, "starts": starts, "values": values})

    @cached_property
    def unit_faults(self) -> list[UnitError]:
        """Inconsistent units in blocks' equations, certificates and conditions; see `dmframe.dimensions`.

        It takes 0.1 s for most graphs, 0.5 s for sampled inverses; `check` and `verify` call it.
        """
        from dmframe.dimensions import unit_faults  # a run checks no units

        with SYMBOLIC:
            return unit_faults(self.models, self.sizes, self.robot)

    @cached_property
    def ways(self) -> list[Way]:
        """The signals between controller and robot that channel models change, with these blocks."""
        return ways(self.blocks, _produced(self.models), self.sources)

    @cached_property
    def unread(self) -> list[Wire]:
        """Unused outputs of sources, and of blocks that have no effect because all their outputs are unused."""
        return unread(self.blocks, _produced(self.models), self.sources)

    def type_of(self, name: str) -> str:
        """The type of a block, as graph files write it."""
        return type_name(type(self.blocks[name]))

    def __repr__(self) -> str:
        return f"<Diagram of {len(self.blocks)} blocks: {', '.join(self.blocks)}>"


def _unsteady(steady: Steadiness) -> BlockError | None:
    """The fault of equations that differ at other numbers."""
    try:
        steady.check()
    except BlockError as fault:
        fault.path = fault.path or ("blocks", steady.name)
        return fault
    return None


def doubtful(blocks: Mapping[str, AbstractBlock], wires: Mapping[str, str], robot: Any = None) -> bool:
    """True if `Diagram.build` may raise, as far as it shows without the blocks' equations, which take much longer."""
    outputs = declared_outputs(blocks)
    sizes, faults = bind_sizes(blocks, robot)
    sources, more = wire_blocks(blocks, outputs, wires)
    if faults or more or _contracts(blocks) or check_wires(blocks, outputs, sources, sizes, wires):
        return True
    return any(parameter_arrays(name, block, sizes, blocks, robot)[1] for name, block in blocks.items())


def _causes(
    faults: Sequence[DmframeError], blocks: Mapping[str, AbstractBlock], wiring: Sequence[DmframeError]
) -> list[DmframeError]:
    """The faults without those of a size that is unknown because the block that defines it is missing."""
    lost = set[tuple[str | int, str]]()
    for fault in wiring:
        if isinstance(fault, WiringError) and fault.missing:
            name = str(fault.path[-1])
            shapes = [port.shape for port in blocks[name].inputs if port.name == fault.missing]
            lost |= {(name, letter) for shape in shapes for letter in shape.split()}
    return [fault for fault in faults if not (isinstance(fault, SizeError) and (fault.path[-1], fault.letter) in lost)]


def _contracts(blocks: Mapping[str, AbstractBlock]) -> list[DmframeError]:
    faults = list[DmframeError]()
    for name, block in blocks.items():
        for fault in block.contract(name):
            fault.path = ("blocks", name)
            faults.append(fault)
    return faults


def _symbolic(robot: Any) -> Any:
    if robot is None:
        return None
    from dmframe.robot.symbolic import SymbolicRobot

    return SymbolicRobot(robot)


def declared_outputs(blocks: Mapping[str, AbstractBlock]) -> Outputs:
    """Outputs declared by the classes; an optional one is included if no other block is certain to have it."""
    sure = {port.name for block in blocks.values() for port in block.outputs if not port.optional}
    declared = dict[str, dict[str, Output]]()
    for name, block in blocks.items():
        declared[name] = {port.name: port for port in block.outputs if not port.optional or port.name not in sure}
        sure |= declared[name].keys()
    return declared


def _produced(models: Mapping[str, BlockModel]) -> Outputs:
    return {
        name: {port.name: port for port in model.block.outputs if port.name in model.equations.outputs}
        for name, model in models.items()
    }


def _parameters(models: Mapping[str, BlockModel], robot: Any) -> list[Parameter]:
    from dmframe.block.parameter import specs

    found = list[Parameter]()
    for name, model in models.items():
        units = {key: spec.unit for key, spec in specs(type(model.block)).items()}
        units |= {f"{key}_0": unit for key, unit in units.items()}
        for key, leaf in model.parameters.items():
            symbols, value = unique(specs(type(model.block)).get(key), leaf, model.values[key])
            found.append(Parameter(f"{name}.{key}", symbols, value, units[key]))
    if robot is not None:
        values = robot.values()
        found += [Parameter(c.name, c.symbol, values[c.name], c.unit, tuple(c.values)) for c in robot.constants]
    return found


__all__ = ["Diagram", "DmframeError"]
