'''Interpretation of CasADi functions: instructions in single-assignment form, and a table of rules for each target.

CasADi stores a scalar function as instructions on registers that are reused. `read` converts them to a `Program`, in
which each value has its own place. `run` computes the values by a table of rules, one for each operation that the
target supports. `OPERATIONS` has the properties of each operation, independent of the target.

To add a target, write a file with its table, and pass four functions to `run`: the value of an argument's element, the
value of a constant, the error for an unsupported operation, and, for text, the storage of a value under a name. This
example writes WebAssembly text for sums, products and roots (`dmframe.codegen.wasm` writes complete binary modules):

.. code-block:: python

    from dmframe.common.errors import EngineError
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

A target chooses in `constant` whether a number is the double or the decimal in the source (`dmframe.exact.literal`). A
target that computes with numbers starts from `dmframe.exact.arithmetic`. A target that must be fast, such as the
evaluation in a prime field, or whose rules depend on the values, loops over `Program.nodes` itself.
'''

from __future__ import annotations

from dmframe.program.operations import (
    BY_NAME,
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
from dmframe.program.program import (
    CONST,
    INPUT,
    TO_READ,
    Node,
    Pattern,
    Program,
    codes,
    instructions,
    read,
    run,
    shared,
)

__all__ = [
    "BY_NAME",
    "COMPARISONS",
    "CONST",
    "DIVISIONS",
    "EDGES",
    "INPUT",
    "JUMPS",
    "KINKS",
    "OPERATIONS",
    "POWERS",
    "TO_READ",
    "Node",
    "Operation",
    "Pattern",
    "Program",
    "by_code",
    "codes",
    "instructions",
    "read",
    "run",
    "shared",
    "sign_of",
]
