"""JSON Schema of graph files, with which editors complete block types and parameters."""

from __future__ import annotations

from typing import Any

from dmframe.block import AbstractBlock
from dmframe.block.parameter import Spec, spec_of
from dmframe.block.prose import about
from dmframe.catalogue import block_types
from dmframe.config.grammar import GraphFile
from dmframe.config.sections import NAME
from dmframe.formula.unmarked import unmarked
from dmframe.robot.library import robots

DRAFT = "https://json-schema.org/draft/2020-12/schema"
NUMBER = {"type": ["number", "string"]}
PRIOR = {
    "type": "object",
    "properties": {"inverse_of": {"type": "string"}, "scale": NUMBER, "others": NUMBER},
    "required": ["inverse_of"],
    "additionalProperties": False,
}
"""Schema of `dmframe.block.gain.Prior`."""


def json_schema() -> dict[str, Any]:
    """The grammar of graph files with all registered blocks."""
    schema = GraphFile.model_json_schema()
    kinds = block_types()
    schema["$defs"] |= {f"block_{name}": _block(kind) for name, kind in kinds.items()}
    chosen = [
        {
            "if": {"properties": {"type": {"const": name}}, "required": ["type"]},
            "then": {"$ref": f"#/$defs/block_{name}"},
        }
        for name in kinds
    ]
    types = [{"enum": list(kinds)}, {"pattern": r"\.py:[A-Za-z_]\w*$"}]
    schema["properties"]["blocks"] = {
        "type": "object",
        "description": "blocks by name",
        "minProperties": 1,
        "propertyNames": {"pattern": f"^{NAME.pattern}$"},
        "additionalProperties": {
            "type": "object",
            "required": ["type"],
            "properties": {"type": {"type": "string", "anyOf": types}},
            "allOf": chosen,
        },
    }
    models = {"anyOf": [{"enum": list(robots())}, {"type": "string", "pattern": r"\.urdf$"}]}
    robot = schema["properties"]["robot"]
    robot["anyOf"] = [models, *robot["anyOf"]]
    schema["$defs"]["RobotSection"]["properties"]["model"] |= models
    return {"$schema": DRAFT, **schema, "title": "dmframe graph"}


def _block(kind: type[AbstractBlock]) -> dict[str, Any]:
    plain = kind.model_json_schema()
    page = about(kind)
    properties: dict[str, Any] = {"type": {"description": unmarked(page.summary)}}
    for name, field in kind.model_fields.items():
        spec = spec_of(field)
        properties[name] = plain["properties"][name] if spec is None else _number(spec)
        prose = unmarked(page.parameters.get(name, ""))
        text = "; ".join(part for part in (properties[name].get("description", ""), prose) if part)
        properties[name] = {**properties[name], **({"description": text} if text else {})}
    required = [name for name, field in kind.model_fields.items() if field.is_required()]
    schema = {
        "type": "object",
        "properties": properties,
        "required": ["type", *required],
        "additionalProperties": False,
    }
    return schema | ({"$defs": plain["$defs"]} if "$defs" in plain else {})


def _number(spec: Spec) -> dict[str, Any]:
    unit = f"[{spec.unit}]" if spec.unit else "a plain number"
    description = f"{unit}, shape ({spec.shape})" if spec.shape else unit
    if spec.sign:
        description += f", {spec.sign}"
    row = {"type": "array", "items": NUMBER, "minItems": 1}
    either = {"anyOf": [NUMBER, row]}
    shapes: dict[str, dict[str, Any]] = {
        "diagonal": either if spec.shape else dict(NUMBER),
        "vector": row,
        "table": {"type": "array", "items": row, "minItems": 1},
        "gain": {"anyOf": [NUMBER, row, {"type": "array", "items": row, "minItems": 1}, PRIOR]},
        "ball": {"type": "array", "items": either, "minItems": 2, "maxItems": 2},
        "box": {"type": "array", "items": either, "minItems": 2, "maxItems": 2},
    }
    return {"description": description, **shapes[spec.form]}
