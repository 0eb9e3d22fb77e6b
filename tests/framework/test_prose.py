from __future__ import annotations

from dmframe.block import AbstractBlock
from dmframe.block.prose import about
from dmframe_blocks.pid_inverse import PidInverse


def test_parameters_notes_and_sources_are_read_from_their_sections():
    law = about(PidInverse)
    assert law.parameters["Lambda_P"] == law.parameters["Lambda_I"] == "Adaptation gains of the ratios w_P and w_I."
    assert law.notes == "Not for: a PI velocity servo; see `pi_inverse`."
    assert law.source == "[WangTAC2020] eqs. (32)-(39), Theorem 4 and Remark 5."


def test_a_block_without_a_docstring_has_an_empty_law():
    class Bare(AbstractBlock):
        pass

    Bare.__doc__ = None
    law = about(Bare)
    assert (law.summary, law.parameters, law.notes) == ("", {}, "")
