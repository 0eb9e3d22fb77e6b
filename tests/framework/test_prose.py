from __future__ import annotations

from dmframe.block import AbstractBlock
from dmframe.block.prose import about
from dmframe.catalogue import block_types
from dmframe.formula.unmarked import unmarked
from dmframe_blocks.pid_inverse import PidInverse


def test_parameters_notes_and_sources_are_read_from_their_sections():
    law = about(PidInverse)
    assert law.parameters["Lambda_P"] == law.parameters["Lambda_I"] == "Adaptation gains of the ratios $w_P$ and $w_I$."
    assert law.notes == "Not for: a PI velocity servo; see `pi_inverse`; a P-PI cascade; see `p_pi_inverse`."
    assert law.source == "[WangTAC2020] eqs. (32)-(39), Theorem 4 and Remark 5."


def test_a_block_without_a_docstring_has_an_empty_law():
    class Bare(AbstractBlock):
        pass

    Bare.__doc__ = None
    law = about(Bare)
    assert (law.summary, law.parameters, law.notes) == ("", {}, "")


def test_formulas_of_descriptions_are_unicode_in_a_terminal_also_those_of_the_options_of_adaptation():
    kinds = block_types()
    texts = {(name, key): text for name in kinds for key, text in about(kinds[name]).parameters.items()}
    assert [place for place, text in texts.items() if set(unmarked(text)) & set("\\${}")] == []
    assert "position error of √2 lever" in unmarked(texts["tool_orientation", "lever"])
    assert "hᵀ Γ h well below ν" in unmarked(texts["sampled_inverse", "nu"])
    assert "while σ is below this width" in unmarked(texts["dynamic_compensator", "dead_zone"])
