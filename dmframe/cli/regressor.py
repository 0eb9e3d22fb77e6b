"""``dmframe regressor``: regressors of a robot as text, code and LaTeX, tested against Pinocchio."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import final

from dmframe.cli.streams import tell
from dmframe.common.errors import OutputError
from dmframe.common.files import check_place, write_text
from dmframe.robot.chain import SerialChain

NOT_PROVED = 1


@final
@dataclass(frozen=True)
class RegressorOptions:
    """Options of the command."""

    base: bool = False
    kinematic: bool = False
    symbolic: bool = False
    prove: bool = False
    c: Path | None = None
    python: Path | None = None
    latex: Path | None = None


def regressor_of(chain: SerialChain, friction: Sequence[str], options: RegressorOptions) -> int:
    """Print and write the requested parts; returns the exit status."""
    _check_places([path for path in (options.c, options.python, options.latex) if path is not None])
    parts, proved = page(chain, friction, options)
    tell("\n\n".join(parts))
    return 0 if proved else NOT_PROVED


def _check_places(paths: Sequence[Path]) -> None:
    taken = dict[str, Path]()
    for path in paths:
        check_place(path)
        first = taken.setdefault(os.path.realpath(path), path)
        if first is not path and (path.is_file() or not path.exists()):  # devices excepted
            raise OutputError(f"{path}: two files have this name; rename one")


def page(chain: SerialChain, friction: Sequence[str], options: RegressorOptions) -> tuple[list[str], bool]:
    """Write the files; returns the parts of the text, and whether all requested proofs hold."""
    from dmframe.regressor.base_parameters import base_parameters
    from dmframe.regressor.export import export_c, self_test
    from dmframe.regressor.python_source import write_python
    from dmframe.regressor.typeset import largest_difference, latex, plain_text, write_out

    parts, proved = [_parameters(chain, friction, options)], True
    if options.symbolic or options.latex:
        keep = base_parameters(chain, friction, symbolic=False).independent if options.base else None
        written = write_out(chain, friction, keep)
        if options.symbolic:
            parts.append(plain_text(written.Y_k if options.kinematic else written.Y_d))
    test = self_test(chain)
    parts.append(f"largest relative difference from Pinocchio: Y_d {test.Y_d:.1e}, Y_k {test.Y_k:.1e}")
    if options.prove:
        from dmframe.regressor.proofs import proof_page, prove

        proofs = prove(chain)
        parts.append(proof_page(chain, proofs))
        proved = all(proof.holds for proof in proofs)
    if options.c is not None:
        export_c(chain, options.c, friction, options.base, options.kinematic)
        parts.append(f"wrote {options.c}")
    if options.python is not None:
        difference = write_python(chain, options.python, friction, options.base, options.kinematic)
        parts.append(f"wrote {options.python}; largest relative difference from Pinocchio {difference:.1e}")
    if options.latex is not None:
        write_text(options.latex, latex(written))
        difference = largest_difference(written)
        parts.append(f"wrote {options.latex}; largest relative difference from Pinocchio {difference:.1e}")
    return parts, proved


def _parameters(chain: SerialChain, friction: Sequence[str], options: RegressorOptions) -> str:
    from dmframe.regressor.base_parameters import base_parameters
    from dmframe.regressor.export import kinematic_names, kinematic_values
    from dmframe.regressor.listing import listing
    from dmframe.robot.parameters import DynamicParameters

    if options.kinematic:
        pairs = zip(kinematic_names(chain), kinematic_values(chain), strict=True)
        lengths = ", ".join(f"{name} = {value:.10g}" if value else name for name, value in pairs)
        return f"{chain.name}: {chain.k} kinematic parameters [m], zero if no value is given: {lengths}"
    if options.base:
        return listing(chain, base_parameters(chain, friction)).rstrip()
    names = DynamicParameters(chain, friction).names
    return f"{chain.name}: {len(names)} parameters: {', '.join(names)}"
