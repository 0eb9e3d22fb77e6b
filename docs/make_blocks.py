"""Write a page for each block of the catalogue, and an index of them by family.

    python docs/make_blocks.py FOLDER

Their content is computed from the code: printed laws, ports, parameters, conditions, and simulations with changed
parameters. The meaning of a signal in words is that of `notation.yaml`.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Any, Final

from dmframe.block import AbstractBlock, AdaptingBlock
from dmframe.block.condition import Assumption, Inequality
from dmframe.block.parameter import PAIRS, Spec, specs
from dmframe.block.port import Access, Input, Output, Side, Signal
from dmframe.block.prose import about
from dmframe.catalogue import block_modules, block_types, graphs
from dmframe.certify.certificates import certificates_of
from dmframe.certify.form import NotApplicableError
from dmframe.certify.wording import relation
from dmframe.common.names import latex_name
from dmframe.common.text import text_of
from dmframe.diagram.view import view
from dmframe.formula import Formula, Line, PrintedLaw, printed
from dmframe.formula.alone import in_yaml, options_of, simplest
from dmframe.formula.tree import Sum
from dmframe.formula.where import sizes_show, where
from dmframe.graph.progress import counting
from dmframe.report.references import reference

sys.path.insert(0, str(Path(__file__).parent))
from block_examples import Example, diagram_of, example, loaded, trials
from make_notation import meanings

FAMILIES: Final = {
    "paths": ("Paths", "Functions of time: desired positions of the tool or the joints."),
    "references": (
        "References",
        "Compute the reference velocity or acceleration from the path and the errors.",
    ),
    "models": ("Models, observers and filters", "Signals that other blocks of the controller need."),
    "adaptation": ("Adaptation", "Blocks with estimates; V contains the errors of the estimates."),
    "commands": ("Commands", "Compute the servo's command from a reference and a torque."),
    "between": (
        "Between controller and robot",
        "Non-idealities of the signal path: each replaces the signal that it reads, so a graph needs no wires.",
    ),
    "plant": ("Robot and servo", "The plant: closed; controllers read its measured signals only."),
}
"""Titles and descriptions, in the order of the signal flow."""
REFERENCES: Final = frozenset({"dq_r", "dq_ref", "ddq_ref"})
"""Outputs of a reference generator."""
LONG: Final = 120
"""Letters of LaTeX beyond which a sum is broken into lines."""
WEIGHTS: Final = (
    "In addition the weight of each term of V must be positive, and that of each dissipated term non-negative; "
    "`dmframe verify` checks them at a graph's numbers."
)
READERS: Final = {
    Access.COMMANDED: "controller, and plant as a command",
    Access.MEASURED: "all: it is measured",
    Access.HIDDEN: "plant and proofs",
    Access.INTERNAL: "controller",
}


def write(folder: Path, names: Sequence[str] | None = None) -> list[Path]:
    """Write the pages of all blocks, or of some, into a folder, which is made; returns their paths, the index first."""
    folder.mkdir(parents=True, exist_ok=True)
    kinds = {name: kind for name, kind in block_types().items() if names is None or name in names}
    found = [folder / "index.md"]
    found[0].write_text(index(kinds), encoding="utf-8")
    with counting("pages of blocks", len(kinds), "pages") as count:
        for number, (name, kind) in enumerate(kinds.items()):
            count(number, name)
            found.append(folder / f"{name}.md")
            found[-1].write_text(page(name, kind), encoding="utf-8")
        count(len(kinds), "")
    return found


def family(kind: type[AbstractBlock]) -> str:
    """A key of `FAMILIES`, from the side and the outputs of a block."""
    if kind.side is not Side.CONTROLLER:
        if any(port.instead_of for port in kind.outputs):
            return "between"
        held = any(port.steps for port in kind.outputs)
        return "paths" if kind.side is Side.SOURCE and not held else "plant"
    if any(port.access is Access.COMMANDED for port in kind.outputs):
        return "commands"
    if issubclass(kind, AdaptingBlock) and kind.estimates:
        return "adaptation"
    return "references" if REFERENCES & {port.name for port in kind.outputs} else "models"


def index(kinds: dict[str, type[AbstractBlock]]) -> str:
    """All blocks by family, with their summaries."""
    parts = ["# Blocks", "All blocks, grouped by their outputs. `dmframe blocks` prints the same in a terminal."]
    for key, (title, text) in FAMILIES.items():
        mine = [name for name, kind in kinds.items() if family(kind) == key]
        parts.append(f"## {title}\n\n{text}")
        parts.append(
            _table(("block", "does"), [(f"[`{n}`]({n}.md)", _markdown(about(kinds[n]).summary)) for n in mine])
        )
    names = "\n".join(name for key in FAMILIES for name, kind in kinds.items() if family(kind) == key)
    parts.append(f"```{{toctree}}\n:hidden:\n\n{names}\n```")
    return "\n\n".join(parts) + "\n"


def page(name: str, kind: type[AbstractBlock]) -> str:
    """One block."""
    doc, shown = about(kind), example(name)
    parts = [f"# `{name}`", _markdown(doc.summary), f"{FAMILIES[family(kind)][0]}; {_side(kind)}."]
    parts += ["## Law", *_law(kind, shown)]
    parts += ["## Signals", *_signals(kind)]
    parts += ["## Parameters", _parameters(kind)]
    conditions = [] if kind.side is Side.SOURCE else list(_conditions(shown))
    parts += ["## Conditions", "\n".join(conditions), WEIGHTS] * bool(conditions)
    parts += ["## Notes", _markdown(doc.notes)] * bool(doc.notes)
    parts += ["## Source", *_source(doc.source)] * bool(doc.source)
    parts += ["## In a graph", *_used(name, shown)]
    parts += list(_what_if(kind, shown)) if shown is not None else []
    return "\n\n".join(parts) + "\n"


def _side(kind: type[AbstractBlock]) -> str:
    return {
        Side.SOURCE: "a source, which reads the time only",
        Side.CONTROLLER: "a part of the controller, which reads measured signals only",
        Side.PLANT: "a part of the plant, which is closed",
    }[kind.side]


def _law(kind: type[AbstractBlock], shown: Example | None) -> Iterator[str]:
    """The equations from the code, those of each option, and the meaning of their signs."""
    found = simplest(kind)
    options = dict[str, Sequence[Line]]()
    if found is not None:
        label, law = found
        options = dict(options_of(kind))
        lead = f"With `{label}`" if label else ""
    elif shown is not None:
        law, lead = printed(diagram_of(shown.graph), shown.block), f"In the graph `{shown.graph}`"
    else:
        yield "The law depends on numbers of the block; the report of a graph prints it."
        return
    lines = [*law.lines, *(line for some in options.values() for line in some)]
    if sizes_show(lines):
        lead += ("; the" if lead else "The") + " sizes that show are those of an example"
    if lead:
        yield f"{lead}:"
    yield _aligned(law.lines) or "Each output is a state or a parameter."
    yield from _energy(law)
    for option, changed in options.items():
        yield f"### With `{option}`\n\n{_aligned(changed)}"
    if signs := where(lines):
        yield "Symbols:\n\n" + _table(("symbol", "meaning"), [(f"`{sign}`", text) for sign, text in signs])


def _energy(law: PrintedLaw) -> Iterator[str]:
    """Table of storage, dissipation, residual, cross term and supply rate."""
    rows = [("storage, half of", term.whole.latex) for term in law.storage]
    rows += [("dissipation", term.whole.latex) for term in law.dissipation]
    rows += [("residual", term.whole.latex) for term in law.residual]
    rows += [("cross term", law.consumption.whole.latex)] if law.consumption is not None else []
    rows += [("supply rate", law.supply.latex)] if law.supply is not None and law.supply.text != "0" else []
    if rows:
        yield "Certificate, term by term:\n\n" + _table(
            ("", "term"), [(role, f"${formula}$") for role, formula in rows]
        )
    if law.estimates:
        estimates = ", ".join(f"${line.right.latex}$ by ${latex_name(line.name)}$" for line in law.estimates)
        yield f"It estimates {estimates}."


def _aligned(lines: Sequence[Line]) -> str:
    """Equations under one another; a long sum goes on below itself, a summand a line."""
    rows = dict.fromkeys(map(_row, lines))
    return "$$\n\\begin{aligned}\n" + " \\\\\n".join(rows) + "\n\\end{aligned}\n$$" if rows else ""


def _row(line: Line) -> str:
    whole = f"{line.left.latex} &= {line.right.latex}"
    node = line.right.node
    if not isinstance(node, Sum) or len(whole) < LONG:
        return whole
    first, *more = (Formula(term).latex for term in node.terms)
    below = (f"&\\quad {'' if term.startswith('-') else '+ '}{term}" for term in more)
    return " \\\\\n".join([f"{line.left.latex} &= {first}", *below])


def _signals(kind: type[AbstractBlock]) -> Iterator[str]:
    for title, ports in (("Inputs", kind.inputs), ("Outputs", kind.outputs)):
        heads = ("symbol", "name", "shape", "unit", "meaning", "readers" if title == "Outputs" else "")
        rows = [_port(port, kind) for port in ports]
        yield f"{title}:\n\n{_table(heads, rows)}" if rows else f"No {title.lower()}."
    if kind.states:
        rows = [
            (f"${latex_name(s.name)}$", f"`{s.name}`", s.shape or "1", s.unit or "-", _meaning(s.name), _kept(s))
            for s in kind.states
        ]
        yield f"States:\n\n{_table(('symbol', 'name', 'shape', 'unit', 'meaning', ''), rows)}"
    if kind.truth:
        rows = [_port(port, kind) for port in kind.truth]
        heads = ("symbol", "name", "shape", "unit", "meaning", "")
        yield f"True values, which only its certificate reads:\n\n{_table(heads, rows)}"


def _port(port: Signal, kind: type[AbstractBlock]) -> tuple[str, ...]:
    remarks = list[str]()
    if isinstance(port, Output):
        hidden = kind.side is Side.PLANT and port.access is Access.INTERNAL
        remarks.append(READERS[Access.HIDDEN if hidden else port.access])
    remarks += [f"derivative of `{port.derivative_of}`"] * bool(port.derivative_of) + ["optional"] * port.optional
    if isinstance(port, Input) and port.drawn:
        remarks.append(f"drawn at each sample: {port.drawn}")
    unit = {"*": "any"}.get(port.unit, port.unit or "-")
    return (
        f"${latex_name(port.name)}$",
        f"`{port.name}`",
        port.shape or "1",
        unit,
        _meaning(port.name),
        "; ".join(remarks),
    )


def _kept(state: Any) -> str:
    sets = [f"`{name}`" for name in (state.box, state.ball) if name]
    kinds = ["sampled"] * state.sampled + ["optional"] * state.optional
    return ", ".join([*kinds, *[f"projected onto {' or '.join(sets)}"] * bool(sets)])


@cache
def _words() -> dict[str, str]:
    return {name: meaning.means for name, meaning in meanings().items()}


def _meaning(name: str) -> str:
    return _words().get(name, "")


def _parameters(kind: type[AbstractBlock]) -> str:
    described, known = about(kind).parameters, specs(kind)
    rows = []
    for name, field in kind.model_fields.items():
        spec = known.get(name)
        shape, unit = (spec.shape or "1", " ".join([spec.unit or "-", spec.sign]).strip()) if spec else ("", "option")
        default = "needed" if field.is_required() else _default(field.default, spec)
        rows.append(
            (
                f"${latex_name(name)}$" if spec else "",
                f"`{name}`",
                shape,
                unit,
                default,
                _markdown(described.get(name, "")),
            )
        )
    return _table(("symbol", "name", "shape", "unit, sign", "default", "does"), rows) if rows else "None."


def _default(value: Any, spec: Spec | None) -> str:
    if value is None:
        return "no bound" if spec is not None and spec.form in PAIRS else "none"
    return f"`{in_yaml(value)}`"


def _conditions(shown: Example | None) -> Iterator[str]:
    """Conditions of the block's proof, in its graph."""
    if shown is None:
        return
    diagram = diagram_of(shown.graph)
    try:
        stated = certificates_of(diagram).truths
    except NotApplicableError:
        return
    seen = view(diagram, shown.block, stated)
    items = list(diagram.blocks[shown.block].conditions(seen.p, seen.truth))
    for item in items:
        if isinstance(item, Assumption):
            lead = f"Assumed: {text_of(item.text).marked}"
        else:
            own = relation(diagram, stated, shown.block, item) if isinstance(item, Inequality) else None
            lead = (own or text_of(item.name)).marked
        yield f"- {lead}" + f" ({text_of(item.source).marked})" * bool(item.source)
    if not items:
        yield "None of its own."


def _source(text: str) -> Iterator[str]:
    yield _markdown(text)
    yield from (f"- \\[{key}\\] {reference(key)}" for key in dict.fromkeys(re.findall(r"\[(\w+)\]", text)))


def _used(name: str, shown: Example | None) -> Iterator[str]:
    if shown is None:
        yield f"No packaged graph contains a `{name}`."
        return
    yield f"The smallest packaged graph with it is `{shown.graph}`: {loaded(shown.graph).title}."
    yield f"```yaml\n{graphs()[shown.graph].read_text(encoding='utf-8').rstrip()}\n```"
    if diagram_of(shown.graph).loop.noises:
        yield "The graph has random inputs, and therefore no live page."
    else:
        yield f"```{{live}} {shown.graph}\n```"
    if shown.others:
        yield f"Other graphs with it: {', '.join(f'`{other}`' for other in shown.others)}."


def _what_if(kind: type[AbstractBlock], shown: Example) -> Iterator[str]:
    found = trials(kind, shown)
    if found is not None:
        name = found.label.partition(".")[2]
        yield f"## What happens if `{name}` changes"
        yield f"`{name}` at multiples of its value in `{shown.graph}`, each run for {found.until:g} s:"
        heads = ("", f"`{found.label}`", "RMS error, first eighth", "last eighth", "")
        yield _table(heads, found.rows)


def _markdown(text: str) -> str:
    """Marked text for a page: ``[Key]`` is not a link, and the name of a block is one."""
    known = block_modules()
    text = re.sub(r"\[(\w+)\](?!\()", r"\\[\1\\]", text)
    return re.sub(r"`(\w+)`", lambda name: f"[`{name[1]}`]({name[1]}.md)" if name[1] in known else name[0], text)


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Markdown table without columns that have neither a head nor a cell."""
    heads, *rows = zip(*(column for column in zip(heads, *rows, strict=True) if any(column)), strict=True)
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join("| " + " | ".join(_cell(cell) for cell in line) + " |" for line in lines)


def _cell(text: str) -> str:
    """A bar would end the cell; within a formula a vertical line is written as LaTeX has it."""
    parts = re.split(r"(\$[^$]+\$)", text)
    done = (part.replace("|", r"\vert ") if place % 2 else part.replace("|", r"\|") for place, part in enumerate(parts))
    return "".join(done)


if __name__ == "__main__":
    for path in write(Path(sys.argv[1])):
        sys.stdout.write(f"{path}\n")
