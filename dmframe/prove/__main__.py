"""``python -m dmframe.prove FILE``: check the claim of a file that ``dmframe verify --claim FILE`` wrote.

The check needs neither a graph nor CasADi. It decides the identity, the seeded faults, and the signs of the weights of
squares at the file's numbers. Other conditions, and the consequences of V, are not in the file. The exit status is 0 if
the identity holds, every fault is refuted and no sign is wrong, 1 otherwise, and 2 if the file contains no valid claim.
"""

from __future__ import annotations

import secrets
import sys
from pathlib import Path

from dmframe.common.errors import DmframeError
from dmframe.exact import ZeroDivision
from dmframe.prove.export import digest, read_file
from dmframe.prove.faults import inject_faults
from dmframe.prove.identity import empty, identity
from dmframe.prove.signs import signs


def main(arguments: list[str]) -> int:
    """Check one file; return the exit status."""
    if len(arguments) != 1:
        sys.stderr.write("usage: python -m dmframe.prove FILE\n")
        return 2
    seed = secrets.randbits(64)  # unpredictable for the author of the file
    try:
        claim, numbers = read_file(Path(arguments[0]).read_text(encoding="utf-8"))
        test = identity(claim, trials=3, seed=seed)
        faults = inject_faults(claim, seed=seed) if test.zero else ()
        vanishing = empty(claim, seed) if test.zero else []
    except (DmframeError, OSError, UnicodeDecodeError, ZeroDivision, MemoryError) as error:
        sys.stderr.write(f"{arguments[0]}: {str(error) or type(error).__name__}\n")
        return 2
    missed = [fault.fault for fault in faults if not fault.refuted]
    given = [symbol.label for symbol in claim.symbols if symbol.values is not None]
    lines = [f"claim {digest(claim)}"]
    if given:
        lines.append(f"at given values of {', '.join(given)}, for all values of every other symbol")
    found = list(signs(claim, numbers)) if test.zero else []
    wrong = [sign.name for sign in found if sign.holds is False]
    holds = test.zero and bool(faults) and not missed and not vanishing and not wrong
    if not test.zero:
        lines.append(f"the identity does not hold: {test.witness.output if test.witness else ''}")
    else:
        lines.append(f"the identity holds; error below 2^{test.log2_error_bound:.0f}, seed {seed}")
        lines.append(
            f"{len(faults) - len(missed)} of {len(faults)} seeded faults refuted" + f"; missed: {missed}" * bool(missed)
        )
        right, undecided = (sum(sign.holds is state for sign in found) for state in (True, None))
        lines.append(
            f"{right} of {len(found)} signs hold at the file's numbers; {undecided} cannot be decided from numbers"
        )
        lines.append("not in the file: other conditions, and the consequences of V")
    if wrong:
        lines.append(f"of the wrong sign: {'; '.join(wrong)}")
    if vanishing:
        lines.append(f"identically zero: {'; '.join(vanishing)}")
    sys.stdout.write("\n".join(lines) + "\n")
    return 0 if holds else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
