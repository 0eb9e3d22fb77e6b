"""Export of a controller as C99: source, header, and a test that compares the compiled code with a simulation."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from importlib.resources import files
from typing import Any, Final

import casadi as ca

from dmframe.codegen.function import ONE, written
from dmframe.codegen.source import helpers
from dmframe.common.slices import slices
from dmframe.common.units import plain
from dmframe.common.version import version
from dmframe.config import BaseGraph
from dmframe.config.resolved import resolved_text
from dmframe.diagram.parts import split
from dmframe.export.program import Member, Program, program_of
from dmframe.export.replay import Computed, computed_by_c, first_sample, kept, samples_as_c, samples_of, sizes_as_c
from dmframe.results.folder import provenance


def header(program: Program) -> str:
    """Header file of the controller."""
    name = program.name
    guard = f"{name.upper()}_H"
    tool = (
        "" if program.tool is None else _TOOL.format(name=name, n=program.tool.numel_in(0), m=program.tool.numel_out(0))
    )
    size = max(1, sum(member.size for member in program.states))
    _, constants = functions_of(program)
    return _HEADER.format(
        name=name,
        guard=guard,
        upper=name.upper(),
        about=about(program),
        period=repr(program.period),
        measured=_struct(f"{name}_measured", program.measured, "Measurements of the robot at a sample."),
        commanded=_struct(f"{name}_commanded", program.commanded, "Commands until the next sample."),
        path=_struct(f"{name}_path", program.path, "Desired path, as the law reads it."),
        parameters=_struct(f"{name}_parameters", program.parameters, "Gains and other numbers of the controller."),
        p=max(1, sum(member.size for member in program.parameters)),
        c=max(1, constants),
        z=size,
        places="\n".join(_places(program)),
        tool=tool,
    )


def source(program: Program) -> str:
    """Source file of the controller."""
    functions, _ = functions_of(program)
    sizes = {
        "Z": sum(member.size for member in program.states),
        "M": sum(member.size for member in program.measured),
        "U": sum(member.size for member in program.commanded),
        "P": max(1, sum(member.size for member in program.parameters)),
        "W": sum(member.size for member in program.path),
    }
    name, bodies, frame = program.name, [spelled(function) for function in functions], own_file("exported.c")
    lines = [
        f"/* {about(program)} */",
        f'#include "{name}.h"',
        "#ifndef __GNUC__",
        "#define __attribute__(list)",
        "#endif",
        helpers(*bodies, frame),
        *(f"#define DM_{key} {size}" for key, size in sizes.items()),
        f"#define DM_PERIOD {name.upper()}_PERIOD",
        f"#define DM_NAMED(word) {name}_##word",
        f"const {name}_parameters {name}_defaults = {{",
        *(
            f"    {{{', '.join(map(repr, member.value))}}}, /* {commented(member.label)} */"
            for member in program.parameters
        ),
        *([] if program.parameters else ["    {0},"]),
        "};",
        *bodies,
        frame,
    ]
    if program.tool is not None:
        lines.append(f"void {name}_tool(const double *q, double *x) {{ dm_tool(q, 0, 0, x); }}\n")
    return "\n".join(lines)


_HEADER: Final = """\
/* {about}

   Fill a {name}_measured, call {name}_reset once and then {name}_step at each sample, every {period} s; send the
   {name}_commanded. A call returns 1, or 0 if the sample or a result is not finite: then nothing has changed, and the
   robot should be stopped. Radians, metres, newtons, seconds; joints in the order of the robot. */
#ifndef {guard}
#define {guard}

#ifdef __cplusplus
extern "C" {{
#endif

#define {upper}_PERIOD {period} /* s */

{measured}

{commanded}

{path}

{parameters}

/* Values of the graph. */
extern const {name}_parameters {name}_defaults;

/* Indices of the states in {name}_controller.state. */
{places}

typedef struct {{
  double parameters[{p}];
  double constants[{c}];
  double state[{z}];
  unsigned long refused; /* samples that were not finite */
}} {name}_controller;

void {name}_init({name}_controller *self, const {name}_parameters *parameters);

/* Initialise the states from the measurements at time t. */
int {name}_reset({name}_controller *self, const {name}_measured *measured, double t);

/* Compute the commands from time t until the next sample. */
int {name}_step({name}_controller *self, const {name}_measured *measured, double t, {name}_commanded *commanded);

/* The same if the next sample is T s later: after a lost sample, or with time scaling. */
int {name}_step_for({name}_controller *self, const {name}_measured *measured, double t, double T,
  {name}_commanded *commanded);

/* The graph's path at time t. */
void {name}_path_at(const {name}_controller *self, double t, double T, {name}_path *path);

/* The same as {name}_step_for, with your path instead of the graph's. */
int {name}_step_on({name}_controller *self, const {name}_measured *measured, const {name}_path *path, double t,
  double T, {name}_commanded *commanded);
{tool}
#ifdef __cplusplus
}}
#endif
#endif
"""
_TOOL: Final = """
/* Tool position [m] with the lengths of the robot's model: q has {n} numbers, x has {m}. */
void {name}_tool(const double *q, double *x);
"""


def functions_of(program: Program, *, free: bool = True) -> tuple[list[Any], int]:
    """Functions of the C source, with constants that depend only on parameters hoisted; and the number of constants.

    With `free`, the path is an argument, and the tool's position is included; else they are those of an FMU.
    """
    z, measured, t, T, p = (ca.SX.sym(word, program.control.numel_in(k)) for k, word in enumerate(_ARGUMENTS))
    bodies: dict[str, tuple[list[Any], list[Any]]] = {"start": ([measured, t, T], [program.start(measured, t, T, p)])}
    if free:
        path = ca.SX.sym("path", program.follow.numel_in(5))
        bodies["follow"] = ([z, measured, t, T, path], list(program.follow(z, measured, t, T, p, path)))
        bodies["path"] = ([t, T], [program.own_path(t, T, p)])
    else:
        bodies["control"] = ([z, measured, t, T], list(program.control(z, measured, t, T, p)))
    if free and program.tool is not None:
        q = ca.SX.sym("q", program.tool.numel_in(0))
        bodies["tool"] = ([q], [program.tool(q)])
    made, constants = split(bodies, p)
    return [constants, *made], constants.numel_out(0)


_ARGUMENTS: Final = ("z", "measured", "t", "T", "p")
_HEAD: Final = re.compile(r"^static .*\((.*)\) \{$", re.MULTILINE)


def spelled(function: Any) -> str:
    """C of a function without compiler warnings."""
    return _HEAD.sub(_unused, written(function, ONE))


def _unused(head: re.Match[str]) -> str:
    """A function's head, with uses of its arguments, some of which may be unused."""
    names = [argument.split("*")[1] for argument in head.group(1).split(", ")]
    return "\n".join([head.group(), f"  {' '.join(f'(void){name};' for name in names)}"])


def about(program: Program) -> str:
    """Description of a file in one line."""
    title = f": {program.title}" if program.title else ""
    return commented(f"{program.name}{title}. Written by dmframe {version()} from model {program.model}.")


def commented(text: str) -> str:
    """A text in one line that neither ends nor begins a comment of C, C++, CMake or XML."""
    line = "".join(letter if letter.isprintable() else " " for letter in " ".join(text.split()))
    return line.replace("*/", "* /").replace("/*", "/ *").replace("--", "- - ").replace("\\", "/")


def c_text(text: str) -> str:
    """C string literal of a text in UTF-8, with other characters than letters and signs in octal."""
    plain = set(b" !#$%&'()*+,-./:;<=>@[]^_`{|}~") | set(range(48, 58)) | set(range(65, 91)) | set(range(97, 123))
    return '"' + "".join(chr(byte) if byte in plain else f"\\{byte:03o}" for byte in text.encode()) + '"'


def _struct(name: str, members: Sequence[Member], about: str) -> str:
    lines = [f"/* {about} */", "typedef struct {"]
    lines += [f"  double {item.word}[{item.size}]; /* {unit_of(item.unit)} */" for item in members]
    lines += [] if members else ["  double none[1];"]
    return "\n".join([*lines, f"}} {name};"])


def unit_of(unit: str) -> str:
    """A unit, or 1."""
    return unit or "1"


def _places(program: Program) -> Iterator[str]:
    for member, place in zip(program.states, slices(member.size for member in program.states), strict=True):
        word = f"{program.name}_{member.word}".upper()
        yield f"#define {word} {place.start} /* {member.label}, {member.size} numbers, {unit_of(member.unit)} */"


def own_file(name: str) -> str:
    """A file of this package."""
    return files("dmframe.export").joinpath(name).read_text(encoding="utf-8")


def c_files(graph: BaseGraph) -> dict[str, str]:
    """A graph's controller as C99, with an example and a test: files by name.

    ``NAME.c`` and ``NAME.h`` are the controller; ``replay.c`` compares the compiled code with the first samples of a
    simulation, each from equal states, bit by bit if the compiler keeps the order of operations; ``example.c`` shows
    the loop, ``CMakeLists.txt`` builds all.

    Raises `EngineError` for a graph without a sampled controller that can be separated from the plant.
    """
    return files_of(graph, program_of(graph))


def files_of(graph: BaseGraph, program: Program) -> dict[str, str]:
    """All files of an exported controller, by name."""
    wanted = {f"{program.name}.c": source(program), f"{program.name}.h": header(program)}
    samples = samples_of(graph, program)
    wanted |= {"replay.c": _called("replay.c", program), "samples.h": sizes_as_c(samples, exact=False)}
    computed = computed_by_c(graph.diagram, program, wanted, samples)
    shown = kept(samples if computed is None else computed.samples)
    return wanted | {
        "samples.h": samples_as_c(shown, exact=computed is not None),
        "example.c": _called("example.c", program, DM_STILL=first_sample(program, samples)),
        "CMakeLists.txt": _called("CMakeLists.txt", program),
        "README.md": _readme(program, len(shown.times), computed),
        **origin(graph, program.model),
    }


def origin(graph: BaseGraph, model: str) -> dict[str, str]:
    """Provenance files; `model` is the hash of the closed loop."""
    text = resolved_text(graph)
    made = provenance(graph, text, field_hash=model)
    return {"graph.yaml": text, "provenance.json": json.dumps(made, indent=2) + "\n"}


def _called(name: str, program: Program, **more: str) -> str:
    """A file of this package with the program's name in it."""
    return filled(own_file(name), {"DM_FILE": program.name, "DM_PERIOD": f"{program.name.upper()}_PERIOD", **more})


def filled(text: str, words: Mapping[str, str]) -> str:
    """A template with its words replaced, all at once: a replacement may contain such a word."""
    known = sorted(words, key=len, reverse=True)  # some are prefixes of others
    return re.sub("|".join(known), lambda found: words[found.group()], text)


def _readme(program: Program, samples: int, computed: Computed | None) -> str:
    names = ", ".join(program.unmeasured)
    start = f"\n{names}: not determined by measurements; they start as in the simulation.\n" if names else ""
    switched = () if computed is None else computed.switched
    return _README.format(
        name=program.name,
        period=plain(program.period, "s"),
        start=start,
        samples=samples,
        exactly="bit by bit" if computed else "to rounding, since no compiler worked at the export",
        switched="".join(f"\nRounding decides a switch at {words}.\n" for words in switched),
        version=version(),
    )


_README: Final = """\
# {name} as C

The controller of `graph.yaml`, sampled every {period}, without the robot and its servo: C99, without memory allocation,
with only arithmetic of the C library. `{name}.h` describes inputs and outputs, with units; `example.c` shows the loop.

```sh
cmake -B build && cmake --build build && ctest --test-dir build
```

or `cc -std=c99 -O2 -ffp-contract=off -fno-tree-vectorize {name}.c replay.c -lm -o replay && ./replay`. The test
compares the compiled code with {samples} samples of a simulation, {exactly}. Each sample starts from the state of the
simulation, so that a law that amplifies rounding is checked sample by sample.
{switched}{start}
Use the time of the robot's clock, not a count of loops: the path is a function of it. All measurements must be in the
frame of the robot's base; `{name}_tool` computes the tool position for a robot that does not measure it. Stop the robot
if a call returns 0; it has computed nothing.

Tested in simulation only. The code does not limit joints, forces or the workspace, and is not a safety function.
Written by dmframe {version}; see `provenance.json`.
"""
