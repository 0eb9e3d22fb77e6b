"""Export of controller and robot as Functional Mock-up Units for co-simulation, FMI 2.0 or 3.0."""

from __future__ import annotations

import hashlib
import io
import platform
import sys
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final, Literal, final
from xml.etree import ElementTree
from xml.sax.saxutils import quoteattr

import casadi as ca

from dmframe.build.compiler import CompileFailed, find_compiler
from dmframe.codegen.source import helpers
from dmframe.common.errors import EngineError
from dmframe.common.files import encoded
from dmframe.common.slices import slices
from dmframe.common.units import base_units
from dmframe.common.version import version
from dmframe.config import BaseGraph
from dmframe.diagram.parts import split
from dmframe.export.c import commented, functions_of, origin, own_file, spelled
from dmframe.export.program import Member, Program, program_of
from dmframe.export.robot import Robot, robot_of

Version = Literal[2, 3]

_EPOCH: Final = (1980, 1, 1, 0, 0, 0)
"""Time stamp of the files in an FMU; `provenance.json` has the time of the export."""


@final
@dataclass(frozen=True)
class Unit:
    """Content of an FMU: members in the order of its numbers, and the C of its steps."""

    name: str
    about: str
    period: float
    inputs: tuple[Member, ...]
    outputs: tuple[Member, ...]
    parameters: tuple[Member, ...]
    states: tuple[Member, ...]
    functions: tuple[Any, ...]
    constants: int
    frame: str
    shows: bool
    substeps: int = 1

    @property
    def members(self) -> Iterator[tuple[str, Member]]:
        """All members, with their causalities."""
        kinds = (
            ("input", self.inputs),
            ("output", self.outputs),
            ("parameter", self.parameters),
            ("local", tuple(replace(item, label=f"state.{item.label}") for item in self.states)),
        )
        for kind, items in kinds:
            for item in items:
                yield kind, item


def fmi2_files(graph: BaseGraph) -> dict[str, bytes]:
    """The controller and the robot of a graph as two units of FMI 2.0."""
    return _units_of(graph, 2)


def fmi3_files(graph: BaseGraph) -> dict[str, bytes]:
    """The controller and the robot of a graph as two units of FMI 3.0."""
    return _units_of(graph, 3)


def _units_of(graph: BaseGraph, fmi: Version) -> dict[str, bytes]:
    """The controller and the robot of a graph as two FMUs, by file name.

    Their steps are one sampling period. Coupled with the controller first, and with its commands passed to the robot
    before the robot's step, they reproduce the simulation. They contain the sources and, if a compiler is available, a
    library for this machine.

    Raises `EngineError` for a graph without a sampled controller, or whose robot cannot be separated from it.
    """
    program, robot = program_of(graph), robot_of(graph)
    units = [_of_controller(program), _of_robot(robot, program.model)]
    made = origin(graph, program.model)
    return {f"{unit.name}.fmu": packed(unit, fmi, made) for unit in units}


def _of_controller(program: Program) -> Unit:
    functions, constants = functions_of(program, free=False)
    return Unit(
        name=program.name,
        about=f"{program.title} (the controller, of model {program.model})".strip(),
        period=program.period,
        inputs=_zero(program.measured),
        outputs=_zero(program.commanded),
        parameters=program.parameters,
        states=_zero(program.states),
        functions=tuple(functions),
        constants=constants,
        frame="controller.c",
        shows=False,
    )


def _of_robot(robot: Robot, model: str) -> Unit:
    x, u, p = (ca.SX.sym(word, robot.rate.numel_in(k)) for k, word in enumerate(("x", "u", "p")))
    made, constants = split({"rate": ([x, u], [robot.rate(x, u, p)]), "measured": ([x], [robot.shown(x, p)])}, p)
    return Unit(
        name=robot.name,
        about=f"{robot.title} (the robot and its servo, of model {model})".strip(),
        period=robot.period,
        inputs=_zero(robot.commanded),
        outputs=_zero(robot.measured),
        parameters=robot.parameters,
        states=robot.states,
        functions=(constants, *made),
        constants=constants.numel_out(0),
        frame="robot.c",
        shows=True,
        substeps=robot.substeps,
    )


def _zero(items: Sequence[Member]) -> tuple[Member, ...]:
    return tuple(replace(item, value=(0.0,) * item.size) for item in items)


def packed(unit: Unit, fmi: Version, more: Mapping[str, str]) -> bytes:
    """FMU file: description, sources, and a library for this machine if a compiler is available."""
    description = described(unit, fmi, "TOKEN")
    token = hashlib.sha256(description.encode() + code(unit, fmi, "").encode()).hexdigest()[:32]
    token = f"{{{token[:8]}-{token[8:12]}-{token[12:16]}-{token[16:20]}-{token[20:]}}}"
    source = code(unit, fmi, token)
    files: dict[str, bytes] = {
        "modelDescription.xml": described(unit, fmi, token).encode(),
        f"sources/{unit.name}.c": source.encode(),
        **{f"resources/{name}": text.encode() for name, text in more.items()},
    }
    if fmi == 3:
        files["sources/buildDescription.xml"] = _build_description(unit).encode()
    library = _library(unit, source)
    if library is not None:
        files[f"binaries/{_PLATFORMS[fmi]()}/{unit.name}{_ENDING}"] = library
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(zipfile.ZipInfo(name, _EPOCH), content, zipfile.ZIP_DEFLATED)
    return packed.getvalue()


def code(unit: Unit, fmi: Version, token: str) -> str:
    """C source of the FMU in one file."""
    sizes = {
        "INPUTS": _count(unit.inputs),
        "OUTPUTS": _count(unit.outputs),
        "P": _count(unit.parameters),
        "Z": _count(unit.states),
        "C": unit.constants,
        "V": sum(item.size for _, item in unit.members),
        "VARIABLES": sum(1 for _ in unit.members),
        "SUBSTEPS": unit.substeps,
        "SHOWS": int(unit.shows),
    }
    items = [item for _, item in unit.members]
    pairs = zip(slices(item.size for item in items), items, strict=True)
    places = [f"    {{{place.start}, {item.size}}}, /* {item.label} */" for place, item in pairs]
    table = ["static const struct { size_t first, size; } dm_variables[] = {", *places, "};"] if fmi == 3 else []
    values = [f"    {', '.join(map(repr, item.value))}, /* {item.label} */" for _, item in unit.members]
    bodies = [spelled(function) for function in unit.functions]
    return "\n".join(
        [
            f"/* {commented(f'{unit.name}: {unit.about}. Written by dmframe {version()}.')} */",
            "#ifndef __GNUC__",
            "#define __attribute__(list)",
            "#endif",
            "#include <stddef.h>",
            helpers(*bodies),
            *(f"#define DM_{key} {size}" for key, size in sizes.items()),
            f"#define DM_PERIOD {unit.period!r}",
            f'#define DM_PERIOD_TEXT "{unit.period!r}"',
            f'#define DM_TOKEN "{token}"',
            "static const double dm_values[] = {",
            *values,
            "};",
            *table,
            *bodies,
            own_file("fmu.c"),
            own_file(unit.frame),
            own_file(f"fmi{fmi}.c"),
        ]
    )


def _count(items: Sequence[Member]) -> int:
    return sum(item.size for item in items)


def described(unit: Unit, fmi: Version, token: str) -> str:
    """modelDescription.xml, checked by a parser.

    Raises `EngineError` for a name that no XML can hold, such as one with a control character.
    """
    lines = list(_TEXTS[fmi](unit, token))
    text = '<?xml version="1.0" encoding="UTF-8"?>\n' + "\n".join(lines) + "\n"
    try:
        root = ElementTree.fromstring(text.encode())
    except (ElementTree.ParseError, UnicodeEncodeError):
        root = ElementTree.Element("nothing")
    tag, about = ("ScalarVariable", "Float64")[fmi == 3], (root.get("modelName"), root.get("description"))
    found = [item.get("name") for item in root.iter(tag) if item.get("causality") != "independent"]
    if found != list(_names(unit, fmi)) or about != (unit.name, unit.about):
        raise EngineError(
            f"{unit.name}: modelDescription.xml is not recovered by a parser; expected a title and names of printable "
            "characters"
        )
    return text


def _names(unit: Unit, fmi: Version) -> Iterator[str]:
    """The variables of modelDescription.xml, in their order."""
    for _, item in unit.members:
        several = fmi == 2 and item.size > 1
        yield from (f"{item.label}[{k + 1}]" for k in range(item.size)) if several else (item.label,)


def _description_2(unit: Unit, token: str) -> Iterator[str]:
    yield (
        f'<fmiModelDescription fmiVersion="2.0" modelName={quoteattr(unit.name)} guid="{token}" '
        f'description={quoteattr(unit.about)} generationTool="dmframe {version()}" '
        'variableNamingConvention="structured" numberOfEventIndicators="0">'
    )
    yield (
        f'  <CoSimulation modelIdentifier={quoteattr(unit.name)} canHandleVariableCommunicationStepSize="false" '
        'canBeInstantiatedOnlyOncePerProcess="false" canNotUseMemoryManagementFunctions="true" '
        'canGetAndSetFMUstate="true" canSerializeFMUstate="true">'
    )
    yield f'    <SourceFiles><File name="{unit.name}.c"/></SourceFiles>'
    yield "  </CoSimulation>"
    yield from _units(unit)
    yield '  <LogCategories><Category name="logStatusError"/></LogCategories>'
    yield f'  <DefaultExperiment startTime="0" stepSize="{unit.period!r}"/>'
    yield "  <ModelVariables>"
    reference, outputs = 0, list[int]()
    for kind, item in unit.members:
        for k in range(item.size):
            reference += 1
            outputs += [reference] * (kind == "output")
            name = item.label if item.size == 1 else f"{item.label}[{k + 1}]"
            start = f' start="{item.value[k]!r}"' if _KINDS[kind, unit.shows].endswith(_STARTED) else ""
            text = f'name={quoteattr(name)} valueReference="{reference - 1}" {_KINDS[kind, unit.shows]}'
            yield f"    <ScalarVariable {text}><Real{_unit_of(item)}{start}/></ScalarVariable>"
    yield "  </ModelVariables>"
    yield "  <ModelStructure>"
    text = "".join(f'<Unknown index="{index}"/>' for index in outputs)
    yield f"    <Outputs>{text}</Outputs>"
    if unit.shows:
        yield f"    <InitialUnknowns>{text}</InitialUnknowns>"
    yield "  </ModelStructure>"
    yield "</fmiModelDescription>"


_KINDS: Final = {
    ("input", False): 'causality="input" variability="discrete" initial="exact"',
    ("input", True): 'causality="input" variability="discrete" initial="exact"',
    ("output", False): 'causality="output" variability="discrete" initial="exact"',
    ("output", True): 'causality="output" variability="continuous" initial="calculated"',
    ("parameter", False): 'causality="parameter" variability="fixed" initial="exact"',
    ("parameter", True): 'causality="parameter" variability="fixed" initial="exact"',
    ("local", False): 'causality="local" variability="discrete" initial="calculated"',
    ("local", True): 'causality="local" variability="continuous" initial="exact"',
}
"""(kind of variable, outputs are defined before the first step) -> XML attributes."""
_STARTED: Final = 'initial="exact"'


def _description_3(unit: Unit, token: str) -> Iterator[str]:
    yield (
        f'<fmiModelDescription fmiVersion="3.0" modelName={quoteattr(unit.name)} instantiationToken="{token}" '
        f'description={quoteattr(unit.about)} generationTool="dmframe {version()}" '
        'variableNamingConvention="structured">'
    )
    yield (
        f'  <CoSimulation modelIdentifier={quoteattr(unit.name)} canHandleVariableCommunicationStepSize="false" '
        f'fixedInternalStepSize="{unit.period!r}" canGetAndSetFMUState="true" canSerializeFMUState="true"/>'
    )
    yield from _units(unit)
    yield '  <LogCategories><Category name="logStatusError"/></LogCategories>'
    yield f'  <DefaultExperiment startTime="0" stepSize="{unit.period!r}"/>'
    yield "  <ModelVariables>"
    yield '    <Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>'
    outputs = list[int]()
    for reference, (kind, item) in enumerate(unit.members, 1):
        outputs += [reference] * (kind == "output")
        start = " ".join(map(repr, item.value))
        text = f' start="{start}"' if _KINDS[kind, unit.shows].endswith(_STARTED) else ""
        size = f'<Dimension start="{item.size}"/>' if item.size > 1 else ""
        yield (
            f'    <Float64 name={quoteattr(item.label)} valueReference="{reference}" {_KINDS[kind, unit.shows]}'
            f"{_unit_of(item)}{text}>{size}</Float64>"
        )
    yield "  </ModelVariables>"
    yield "  <ModelStructure>"
    yield from (f'    <Output valueReference="{reference}"/>' for reference in outputs)
    yield from (f'    <InitialUnknown valueReference="{reference}"/>' for reference in outputs if unit.shows)
    yield "  </ModelStructure>"
    yield "</fmiModelDescription>"


_TEXTS: Final = {2: _description_2, 3: _description_3}


def _unit_of(item: Member) -> str:
    return f" unit={quoteattr(item.unit)}" if item.unit else ""


def _units(unit: Unit) -> Iterator[str]:
    """Unit definitions by powers of SI base units."""
    names = sorted({item.unit for _, item in unit.members if item.unit})
    if not names:
        return
    yield "  <UnitDefinitions>"
    for name in names:
        factor, powers = base_units(name)
        grams = powers.pop("g", 0)
        powers |= {"kg": grams} if grams else {}
        scale = factor * Fraction(1, 1000) ** grams
        text = "".join(f' {base}="{power}"' for base, power in powers.items())
        text += f' factor="{float(scale)!r}"' if scale != 1 else ""
        yield f"    <Unit name={quoteattr(name)}><BaseUnit{text}/></Unit>"
    yield "  </UnitDefinitions>"


def _build_description(unit: Unit) -> str:
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n<fmiBuildDescription fmiVersion="3.0">\n'
        f'  <BuildConfiguration modelIdentifier="{unit.name}">\n'
        f'    <SourceFileSet language="C99"><SourceFile name="{unit.name}.c"/></SourceFileSet>\n'
        '    <Library name="m"/>\n'
        "  </BuildConfiguration>\n</fmiBuildDescription>\n"
    )


def _library(unit: Unit, source: str) -> bytes | None:
    """Library for this machine; None without a compiler."""
    compiler = find_compiler()
    if compiler is None:
        return None
    with TemporaryDirectory(prefix="dmframe-") as folder:
        file, library = Path(folder, f"{unit.name}.c"), Path(folder, "unit.so")
        try:
            file.write_bytes(encoded(source))  # temporary: no sync to the disk
            compiler.build_plain([file], library, define="FMI_SHARED")
        except (OSError, CompileFailed):
            return None
        return library.read_bytes()


_SYSTEM: Final = {"linux": "linux", "darwin": "darwin", "win32": "win"}.get(sys.platform, "linux")
_ENDING: Final = {"linux": ".so", "darwin": ".dylib", "win": ".dll"}[_SYSTEM]


def _machine() -> str:
    word = platform.machine().lower()
    return {"amd64": "x86_64", "x64": "x86_64", "arm64": "aarch64"}.get(word, word)


def _platform_2() -> str:
    return f"{_SYSTEM}64" if _machine() == "x86_64" else f"{_machine()}-{_SYSTEM}"


def _platform_3() -> str:
    return f"{_machine()}-{'windows' if _SYSTEM == 'win' else _SYSTEM}"


_PLATFORMS: Final = {2: _platform_2, 3: _platform_3}
