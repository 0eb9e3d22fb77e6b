"""A graph's controller for other programs: as C, or with its robot as FMUs."""

from __future__ import annotations

from dmframe.export.c import export_c
from dmframe.export.fmu import export_fmus

__all__ = ["export_c", "export_fmus"]
