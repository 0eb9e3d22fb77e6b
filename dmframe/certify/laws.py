"""Whether the printed laws and the docstrings of a graph's blocks say what the code computes.

Each block's printed equations are compared with those that run, its printed certificate with the one that is proved,
and every displayed equation of its docstring with its code: exactly where that is possible, else at points of all sizes
on both sides of each switch.
"""

from __future__ import annotations

from dmframe.certify.certificates import certificates_of
from dmframe.certify.form import NotApplicableError
from dmframe.diagram import Diagram
from dmframe.diagram.view import view
from dmframe.formula.docstring import check_docstrings
from dmframe.formula.laws import read_blocks


def check_laws(diagram: Diagram) -> tuple[str, ...]:
    """Compare the printed laws and the docstrings of a diagram's blocks with their code.

    Returns
    -------
    tuple of str
        Equations of docstrings that cannot be read, and so are not compared, each with file and line.

    Raises
    ------
    DmframeError
        One fault, or all of them, each with file and line.

    Notes
    -----
    The certificates are compared with what is proved only for a claim in continuous time that every block states.
    """
    blocks = read_blocks(diagram)
    notices = check_docstrings(blocks)
    if diagram.loop.clocked:
        return tuple(notices)
    try:
        found = certificates_of(diagram)
    except NotApplicableError:
        return tuple(notices)
    for name, certificate in found.stated.items():
        blocks[name].hold(certificate, view(diagram, name, found.truths), diagram.loop)
    return tuple(notices)
