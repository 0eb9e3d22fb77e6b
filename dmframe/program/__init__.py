'''A function's instructions, read once; and a table of rules for each thing that they can become.

CasADi keeps a function of scalars as instructions on registers that it uses again. `read` makes of them a `Program`, in
which each value has a place of its own. `run` computes the values by a table of rules, an entry for each operation that
the target knows. What an operation is, whoever computes it, stands in `OPERATIONS`.

To add a target, write one file with its table, and say four things to `run`: what an element of an argument is, what a
number is, which error refuses an operation, and, for text, how a value is kept under a name. WebAssembly's text, as far
as sums, products and roots go (`dmframe.codegen.wasm` writes all of it, in binary form):

.. code-block:: python

    from dmframe.errors import EngineError
    from dmframe.program import CONST, INPUT, by_code, read, run

    RULES = by_code(
        {
            "add": "(f64.add {} {})".format,
            "mul": "(f64.mul {} {})".format,
            "sq": "(f64.mul {0} {0})".format,
            "sqrt": "(f64.sqrt {})".format,
        }
    )


    def webassembly(f):
        """The lines of a function's body."""
        program, lines = read(f), []

        def keep(node, text):
            if node.code in (CONST, INPUT):
                return text
            lines.append(f"(local.set $v{node.line} {text})")
            return f"(local.get $v{node.line})"

        values = run(
            program,
            RULES,
            given=lambda argument, element: f"(f64.load offset={8 * element} (local.get $a{argument}))",
            constant="(f64.const {!r})".format,
            refuse=lambda code: EngineError(f"{program.name} holds CasADi's instruction {code}"),
            keep=keep,
        )
        for j, output in enumerate(program.stored(values)):
            for element, text in enumerate(output):
                lines.append(f"(f64.store offset={8 * element} (local.get $r{j}) {text})")
        return lines

Whether a number is the double that the machine holds or the decimal that somebody wrote (`dmframe.exact.literal`) is
the target's choice, in `constant`. A target that computes in numbers starts from `dmframe.exact.arithmetic`. One that
must be fast, as the evaluation in a prime field, or that treats values by what they are and not by their operation
alone, loops over `Program.nodes` itself.
'''

from __future__ import annotations

from dmframe.program.operations import (
    COMPARISONS,
    DIVISIONS,
    EDGES,
    JUMPS,
    KINKS,
    OPERATIONS,
    POWERS,
    Operation,
    by_code,
    sign_of,
)
from dmframe.program.program import CONST, INPUT, Node, Program, codes, instructions, read, run

__all__ = [
    "COMPARISONS",
    "CONST",
    "DIVISIONS",
    "EDGES",
    "INPUT",
    "JUMPS",
    "KINKS",
    "OPERATIONS",
    "POWERS",
    "Node",
    "Operation",
    "Program",
    "by_code",
    "codes",
    "instructions",
    "read",
    "run",
    "sign_of",
]
