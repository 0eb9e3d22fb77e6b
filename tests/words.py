"""Private words that standard terms have replaced: ``python tests/words.py [PATH...]`` lists where one is left.

A word counts wherever it is, in names too: `_told` and `fault_context` are hits. Exit status 1 where there is a hit.
"""

import re
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).parents[1]

WORDS: Final[dict[str, str]] = {
    "told|tell|tells|telling": "report, warning, message, configured value, sample: one name for each meaning",
    "nobody|whoever": "name the subject",
    "pays|payer|payers|payment|payments": "dominates, small-gain condition",
    "beside": "next to, together with",
    "held to": "checked against",
    "hands? out|handed out": "outputs, provides",
    "dear|dearer|dearest": "slow, expensive",
    "asks|asked|asking": "requires, requested, user",
    "hears|heard": "receives",
    "spends": "takes",
    "stands? in": "replaces",
    "stands? beside": "is next to",
    "unrun": "untrusted",
    "negative controls?": "fault injection",
    "lanes?": "SIMD batch",
    "is said|are said|says nothing|nothing is said": "name what is reported, and where",
    "it errs": "the error is",
    "anew": "again",
    "somebody|anybody|someone": "name the subject",
    "what becomes of|of its own accord|for want of|so far as|may well": "state the result, the cause, the condition",
    "speaks?": "states",
    "beneath|upon": "below, on",
}
"""Pattern of the private word, and what to write."""

PROSE: Final[dict[str, str]] = {
    "says?|saying|said": "states, lists, prints, reports; name the subject",
    "knows": "is configured for, contains, is known to",
    "learns|learnt": "estimates, adapts, identified",
    "wants|wanted": "desired, required",
    "stands": "is, is placed",
    "hands": "outputs, sends",
    "whatever": "for any",
    "in place of": "instead of",
    "nothing (?:is|was|of)": "no ...; name the object",
    "what is left": "the remaining ...",
    "makers?(?!_)": "manufacturer",
}
"""Patterns that are kept out of the prose of Markdown only; code has other uses of these words."""

PACKAGE: Final[dict[str, str]] = {
    "led onto|led on|(?:is|are) led": "approaches, follows",
    "rests where|floats? finds?": "is at, in floating point",
    "blew up|blows up|wild": "diverged, non-finite",
    "gives? way": "is replaced",
    "stands? (?:behind|below)": "follows, is below",
    "lets? go|goes on": "releases, continues",
    "wants?": "requires",
    "drifting": "ramp mode",
    "clocked": "discrete-time",
    "steered": "scaled, controlled",
    "shelf": "registry, catalogue",
    "risky": "domain condition",
    "(?:laws?|files?) says?|what became of": "name what is given, and where",
    "honest|honestly": "correct, true",
    "feels?": "is affected by, affects",
    "obeys?": "satisfies",
    "plainest|outgrows?": "simplest; grows faster than",
    "numbers? says? so|has an inside": "the number is set; has an interior",
}
"""Patterns that are kept out of the code of the package only; tests and pages have other uses of these words."""

EXCEPT: Final = (
    "tests/words.py",
    "tests/docs/test_words.py",
    "docs/explanation/glossary.md",
)
"""Files that contain the words as examples or as former names."""

CODE: Final = re.compile(r"^```.*?^```$|(?<!`)`[^`\n]+`(?!`)", re.MULTILINE | re.DOTALL)
"""A fence or a span of code in Markdown."""

TARGET: Final = re.compile(r"\]\([^)\s]*")
"""The target of a link: a file's name is not prose."""

KEYWORD: Final = re.compile(
    r"""\btell(?=\s*[:=(,)]|$)|`tell`|"(?:payer|pays|spends|asked|told)"|\btold(?=: str = "")|"""
    r"""\.(?:told|asked|beside)\b|[`]asked[`]|^ +asked$|\basked(?=[:=,])|\bbeside(?=[:=]|$)|\bpays(?==| is now)"""
)
"""Keywords of public functions, a method of Optuna, keys of JSON output, attributes (named where they are defined)."""


def pattern(words: Iterable[str]) -> re.Pattern[str]:
    """One expression for all of these words, in names too."""
    whole = (rf"(?<![A-Za-z])(?:{word.replace(' ', r'[ _]')})(?![a-z])" for word in words)
    return re.compile("|".join(whole), re.IGNORECASE)


PATTERN: Final = pattern(WORDS)
MARKDOWN: Final = pattern([*WORDS, *PROSE])
SOURCE: Final = pattern([*WORDS, *PACKAGE])


def files(paths: list[Path]) -> Iterator[Path]:
    """Python, Markdown, C, JavaScript, YAML and templates below these paths."""
    for path in paths:
        for file in sorted(path.rglob("*")) if path.is_dir() else [path]:
            if file.suffix in {".py", ".md", ".js", ".c", ".h", ".yaml", ".html", ".css", ".txt", ".toml"}:
                yield file


def hits(paths: list[Path]) -> Iterator[str]:
    """``file:line: word: the line``."""
    for file in files(paths):
        name = str(file.relative_to(ROOT))
        if name.startswith(EXCEPT):
            continue
        text, markdown = file.read_text(), file.suffix == ".md"
        wrong = MARKDOWN if markdown else SOURCE if name.startswith("dmframe/") else PATTERN
        for number, line in enumerate((prose(text) if markdown else text).splitlines(), 1):
            if not wrong.search(line):  # most lines
                continue
            for match in wrong.finditer(KEYWORD.sub("", TARGET.sub("](", line))):
                yield f"{name}:{number}: {match[0]}: {line.strip()[:100]}"


def prose(text: str) -> str:
    """Markdown without its code: names and output of the program belong to their own rooms."""
    return CODE.sub(lambda match: "\n" * match[0].count("\n"), text)


def rooms() -> list[Path]:
    """Folders and pages that are checked."""
    tops = [ROOT / name for name in ("blocks", "docs", "plants", "tests")] + sorted(ROOT.glob("*.md"))
    tops += sorted(path for path in (ROOT / "dmframe").iterdir() if path.name != "__pycache__")
    return tops


if __name__ == "__main__":
    found = list(hits([Path(item).resolve() for item in sys.argv[1:]] or rooms()))
    print(*found, sep="\n")  # noqa: T201
    sys.exit(bool(found))
