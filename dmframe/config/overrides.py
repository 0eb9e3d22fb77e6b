"""Values given on the command line that go before those of a graph file: ``--set task.gamma=2``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from dmframe.config.document import read_document
from dmframe.errors import DmframeError, Faults, UnknownNameError, ValueFault


def overridden(data: Mapping[str, Any], overrides: Sequence[str], known: Sequence[str]) -> dict[str, Any]:
    """The file's data with ``--set`` values put in, `known` being a graph's keys; its own data is not touched."""
    result: dict[str, Any] = _copy(data)
    for text in overrides:
        keys, blocks = target(text, result), result.get("blocks")
        names = list(blocks) if isinstance(blocks, dict) else []
        if len(keys) < 2 and keys != [text.partition("=")[0].strip()]:
            raise ValueFault(f"--set {text}: expected block.parameter=value or key=value")
        if keys[0] not in known:
            raise UnknownNameError(f"--set {text}", "block or key", keys[0], [*names, *known])
        if keys[0] == "blocks" and len(keys) > 2 and keys[1] not in names:
            raise UnknownNameError(f"--set {text}", "block", keys[1], names)
        if keys[0] == "blocks" and len(keys) < 3:
            raise ValueFault(f"--set {text}: expected a parameter of a block, {(*keys, 'block')[1]}.parameter=value")
        place = result
        for part in keys[:-1]:
            if place.get(part) is None:
                place[part] = {}
            elif part == "robot" and isinstance(place[part], str):
                place[part] = {"model": place[part]}
            if not isinstance(place[part], dict):
                raise ValueFault(f"--set {text}: {part} holds no keys")
            place = place[part]
        place[keys[-1]] = _override_value(text)
    return result


def _override_value(text: str) -> Any:
    value = text.partition("=")[2].strip()
    try:
        return read_document(f"value: {value}\n", "").data["value"]
    except DmframeError as error:
        reason = (error.faults if isinstance(error, Faults) else (error,))[0].text
        raise ValueFault(f"--set {text}: {reason}") from None


def target(text: str, data: Mapping[str, Any]) -> list[str]:
    """Where an override points to; empty where it is none. A block's name needs no ``blocks.`` before it."""
    key, equals, _ = text.partition("=")
    keys, blocks = key.strip().split("."), data.get("blocks")
    if not equals or not all(keys):
        return []
    return ["blocks", *keys] if isinstance(blocks, dict) and keys[0] in blocks else keys


def _copy(data: Any) -> Any:
    if isinstance(data, Mapping):
        return {key: _copy(value) for key, value in data.items()}
    return [_copy(value) for value in data] if isinstance(data, list) else data
