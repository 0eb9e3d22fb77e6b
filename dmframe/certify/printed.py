"""The laws whose formulas name the terms of a claim, compared with the code at a few points.

`dmframe.certify.laws` compares them fully. That costs as much as a proof, and belongs to a block rather than to a
claim: a misprinted law does not change what is proved.
"""

from __future__ import annotations

from collections.abc import Mapping

from dmframe.certificate import Certificate
from dmframe.certify.form import NotApplicableError
from dmframe.diagram import Diagram
from dmframe.diagram.truths import Stated
from dmframe.diagram.view import view
from dmframe.errors import DmframeError
from dmframe.formula.law import PrintedLaw
from dmframe.formula.laws import read_blocks


def printed_laws(diagram: Diagram, stated: Mapping[str, Certificate], truths: Stated) -> dict[str, PrintedLaw]:
    """Each block's law as it prints.

    Raises `NotApplicableError` where the printed law or certificate has other terms or values than what runs and what
    is proved, at `dmframe.formula.points.NEAR` points.
    """
    try:
        blocks = read_blocks(diagram, near=True)
        for name, certificate in stated.items():
            blocks[name].hold(certificate, view(diagram, name, truths), diagram.loop, near=True)
        return {name: block.law() for name, block in blocks.items()}
    except DmframeError as error:
        raise NotApplicableError(error.text) from None
