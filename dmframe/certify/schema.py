"""The published JSON Schema of verdicts."""

from __future__ import annotations

import json
from importlib.resources import files
from typing import Any


def verdict_schema() -> dict[str, Any]:
    """Schema of the output of ``verify --json``; a report's JSON contains such a verdict for each graph."""
    text = files("dmframe.certify").joinpath("verdict.schema.json").read_text(encoding="utf-8")
    schema: dict[str, Any] = json.loads(text)
    return schema
