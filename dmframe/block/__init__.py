"""What a block is made of: the class that its author writes, and its equations on symbols."""

from dmframe.block.adapting import AdaptingBlock
from dmframe.block.base import AbstractBlock, Equations, Signals
from dmframe.block.names import names_of, type_name

__all__ = ["AbstractBlock", "AdaptingBlock", "Equations", "Signals", "names_of", "type_name"]
