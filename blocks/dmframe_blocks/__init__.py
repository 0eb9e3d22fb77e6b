"""The block library: one block per file, registered through the entry point ``dmframe.blocks``."""
