"""Messages for texts that are not YAML: reason and place."""

from __future__ import annotations

import re
from typing import Any

from ruamel.yaml.events import ScalarEvent

_START = re.compile(r"found character '(.+)' that cannot start any token")
_CONTENT = re.compile(r"expected the node content, but found '(.+)'")
_NAME = re.compile(r"expected alphabetic or numeric character, but found '(.+)'")
_WHOLE = re.compile(r"[-+]?\d{1,20}", re.ASCII)
_DECIMALS = re.compile(r"\d{1,20}( .{1,20})?", re.ASCII)
_TAB = re.compile(r"^ *\t[ \t]*[^\s#]", re.MULTILINE)


def plain_words(fault: Any, text: str) -> tuple[str, int]:
    """The reason and its index in `text`, for an error of ruamel's scanner or parser.

    The parser reports the place where it stops, often lines below the error. An open bracket or quote is therefore
    reported where it opens, and a tab in the indentation before anything else.
    """
    problem, context = str(fault.problem or fault), str(fault.context or "")
    here = fault.problem_mark or fault.context_mark
    end = here.index if here else 0
    begin = fault.context_mark.index if fault.context_mark else end
    line_end = text.find("\n", end)
    tab = _TAB.search(text, 0, line_end if line_end >= 0 else len(text))
    if tab and "quoted" not in context:
        return "a tab indents this line; YAML indents with spaces", text.index("\t", tab.start())
    if text[end : end + 1] == "\t":
        return "a tab is not allowed here; write spaces", end
    if content := _CONTENT.search(problem):
        found = "the end of the text" if "end" in content.group(1) else content.group(1)
        return f"expected a value, found {found}; check the brackets, or put the value in quotes", end
    if "unknown escape character" in problem:
        return "in double quotes a backslash begins an escape; put the text in single quotes", end - 1
    if "flow sequence" in context:
        return "this list is not closed, or lacks a comma; check its [ ... , ... ]", begin
    if "flow mapping" in context:
        return "this mapping is not closed, or lacks a comma; check its { ... , ... }", begin
    if "found unexpected end of stream" in problem:
        return "this quote is never closed", begin
    if "could not find expected ':'" in problem:
        return "expected a colon and a space after this key", begin
    if problem.startswith(("mapping values", "sequence entries")):
        sign = "colon" if problem.startswith("mapping") else "dash"
        return f"a {sign} is not allowed here; check the indentation, or put the text in quotes", end
    if "expected <block end>" in problem:
        return "this does not match the text before it; check indentation, quotes and brackets", end
    if start := _START.search(problem):
        return f"a value cannot begin with {start.group(1)}; put it in quotes", end
    if name := _NAME.search(problem):
        found = "the end of the text" if name.group(1) == r"\x00" else name.group(1)
        return f"expected a name here, found {found}; put the text in quotes", end
    return f"not readable as YAML ({problem})", end


def decimal_comma(before: Any, after: Any) -> str:
    """The number that was meant by the events of a value and the next key, as in ``{k: 0,15 s}``; empty if none was."""
    if not (isinstance(before, ScalarEvent) and isinstance(after, ScalarEvent)):
        return ""
    adjacent = after.start_mark.index == before.end_mark.index + 1
    number = adjacent and _WHOLE.fullmatch(before.value) and _DECIMALS.fullmatch(after.value)
    return f"{before.value}.{after.value}" if number else ""
