"""The block library: one file, one block, found by the catalogue through the entry point ``dmframe.blocks``."""
