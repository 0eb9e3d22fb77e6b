"""A graph's controller for other programs: as C."""

from __future__ import annotations

from dmframe.export.c import export_c

__all__ = ["export_c"]
