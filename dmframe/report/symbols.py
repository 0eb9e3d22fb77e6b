"""Symbols of LaTeX as MathML elements, each with a kind that determines the space next to it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Final, Literal, NamedTuple

from dmframe.common.names import LETTERS
from dmframe.report.tags import Html, plain, tag

Kind = Literal["ordinary", "function", "limits", "sign", "relation", "opening", "closing", "space"]


class Item(NamedTuple):
    """An element of a formula, and its kind."""

    markup: Html
    kind: Kind = "ordinary"


_OPERATORS: Final[Mapping[Kind, str]] = {
    "ordinary": r", , ; ; . . ! ! * ∗ \cdot ⋅ \times × \otimes ⊗ \star ⋆ \circ ∘ \mid ∣ \land ∧ \lor ∨ \lnot ¬ \int ∫ "
    r"\oint ∮ \forall ∀ \exists ∃",
    "relation": r"= = < < > > : : \le ≤ \leq ≤ \ge ≥ \geq ≥ \ne ≠ \neq ≠ \ll ≪ \gg ≫ \approx ≈ \sim ∼ \equiv ≡ "
    r"\propto ∝ \perp ⊥ \in ∈ \subset ⊂ \to → \rightarrow → \leftarrow ← \mapsto ↦ \Rightarrow ⇒ \iff ⟺",
    "sign": r"+ + - − \pm ± \mp ∓",
    "limits": r"\sum ∑ \prod ∏",
    "opening": r"( ( [ [ \{ { \langle ⟨ \lfloor ⌊ \lceil ⌈",
    "closing": r") ) ] ] \} } \rangle ⟩ \rfloor ⌋ \rceil ⌉",
}
"""LaTeX and sign of each operator."""

_LETTERS: Final[dict[str, str]] = LETTERS | {"epsilon": "ϵ", "varepsilon": "ε", "phi": "ϕ", "varphi": "φ"}
_CONSTANTS: Final = {"partial": "∂", "nabla": "∇", "infty": "∞", "ell": "ℓ", "dots": "…", "ldots": "…", "top": "T"}


SPACES: Final = {r"\!": -3, r"\,": 3, r"\:": 4, r"\;": 5, r"\ ": 6, "~": 6, r"\quad": 18, r"\qquad": 36}
"""Spaces, in 18ths of an em."""


def _symbols() -> Iterator[tuple[str, Item]]:
    for kind, row in _OPERATORS.items():
        latex, signs = row.split()[::2], row.split()[1::2]
        stretchy = "false" if kind in ("opening", "closing") else ""
        for name, sign in zip(latex, signs, strict=True):
            yield name, Item(tag("mo", plain(sign), stretchy=stretchy), kind)
    yield "/", Item(tag("mo", plain("/"), lspace="0.05em", rspace="0.05em"))
    for name, letter in (_LETTERS | _CONSTANTS).items():
        upright = name[0].isupper() or name == "top"
        yield f"\\{name}", Item(tag("mi", plain(letter), mathvariant="normal" if upright else ""))
    for mark in "#$%&_":
        yield f"\\{mark}", Item(tag("mtext", plain(mark)))
    for name in "sin cos tan sinh cosh tanh arcsin arccos arctan exp log ln det lim min max sup inf".split():
        yield f"\\{name}", Item(tag("mi", plain(name)), "function")
    for name, width in SPACES.items():
        yield name, Item(tag("mspace", width=f"{width / 18:.3g}em"), "space")


SYMBOLS: Final[Mapping[str, Item]] = dict(_symbols())
"""Elements by their LaTeX."""

ACCENTS: Final[Mapping[str, str]] = {r"\dot": "˙", r"\ddot": "¨", r"\hat": "ˆ", r"\tilde": "˜", r"\bar": "¯"}
BARS: Final[Mapping[str, str]] = {
    **dict.fromkeys(("|", r"\vert", r"\lvert", r"\rvert"), "|"),
    **dict.fromkeys((r"\|", r"\Vert", r"\lVert", r"\rVert"), "‖"),
}
FENCES: Final[Mapping[str, tuple[str, str]]] = {
    "matrix": ("", ""),
    "pmatrix": ("(", ")"),
    "bmatrix": ("[", "]"),
    "cases": ("{", ""),
}
"""Brackets of environments."""
ALPHABETS: Final[Mapping[str, str]] = {r"\mathbb": "DOUBLE-STRUCK CAPITAL", r"\mathcal": "SCRIPT CAPITAL"}
"""Names of capitals in Unicode."""
SCRIPTS: Final[Mapping[str, tuple[str, str]]] = {
    "_": ("msub", "munder"),
    "^": ("msup", "mover"),
    "_^": ("msubsup", "munderover"),
}
"""Elements of subscripts and superscripts, at the side and above."""
