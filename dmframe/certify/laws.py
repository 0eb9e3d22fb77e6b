"""Comparison of the printed laws and docstrings of a graph's blocks with their code.

Each block's printed equations are compared with those that run, its printed certificate with the proved one, and every
displayed equation of its docstring with its code: exactly if possible, otherwise at points of all magnitudes on both
sides of each switch. This takes as long as a proof, and concerns a block rather than a claim: a misprinted law does not
change the proof. For the names of a claim's terms a few points are sufficient.
"""

from __future__ import annotations

from collections.abc import Mapping

from dmframe.block.certificate import Certificate
from dmframe.certify.certificates import certificates_of
from dmframe.certify.form import NotApplicableError
from dmframe.common.errors import DmframeError
from dmframe.diagram import Diagram
from dmframe.diagram.truths import Stated
from dmframe.diagram.view import view
from dmframe.formula.docstring import check_docstrings
from dmframe.formula.law import PrintedLaw
from dmframe.formula.laws import read_blocks


def check_laws(diagram: Diagram) -> tuple[str, ...]:
    """Compare the printed laws and the docstrings of a diagram's blocks with their code.

    Returns
    -------
    tuple of str
        Equations of docstrings that cannot be read and are therefore not compared, each with file and line.

    Raises
    ------
    DmframeError
        One fault, or all of them, each with file and line.

    Notes
    -----
    The certificates are compared with the proved ones only for a continuous-time claim that every block states.
    """
    blocks = read_blocks(diagram)
    notices = check_docstrings(blocks)
    if diagram.loop.discrete_time:
        return tuple(notices)
    try:
        found = certificates_of(diagram)
    except NotApplicableError:
        return tuple(notices)
    for name, certificate in found.stated.items():
        blocks[name].compare_certificate(certificate, view(diagram, name, found.truths), diagram.loop)
    return tuple(notices)


def printed_laws(diagram: Diagram, stated: Mapping[str, Certificate], truths: Stated) -> dict[str, PrintedLaw]:
    """Each block's printed law.

    Raises `NotApplicableError` if a printed law or certificate has other terms or values than the one that runs or is
    proved, at `dmframe.formula.points.NEAR` points.
    """
    try:
        blocks = read_blocks(diagram, near=True)
        for name, certificate in stated.items():
            blocks[name].compare_certificate(certificate, view(diagram, name, truths), diagram.loop, near=True)
        return {name: block.law() for name, block in blocks.items()}
    except DmframeError as error:
        raise NotApplicableError(error.text) from None
