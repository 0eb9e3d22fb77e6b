"""The table, its baseline, and which rows are compared; without timing."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from tests.benchmarks import baseline, closed_loop
from tests.benchmarks.__main__ import PARTS, main
from tests.benchmarks.loop import Array
from tests.benchmarks.peer import Peer
from tests.benchmarks.table import Report, Row, Section
from tests.benchmarks.worker import Failed, measure

MACHINE = {"machine": "a quiet one"}


class Ours(Peer):
    title: ClassVar[str] = "dmframe, compiled"

    def build(self) -> None:
        pass

    def run(self, seconds: float) -> Array:
        return np.zeros((3, 2))


class Theirs(Ours):
    title: ClassVar[str] = "theirs"
    note: ClassVar[str] = "unfair to them"


class Absent(Ours):
    title: ClassVar[str] = "absent"
    package: ClassVar[str] = "a-package-that-does-not-exist"
    module: ClassVar[str] = "a_package_that_does_not_exist"


KNOWN: dict[str, type[Peer]] = {"ours_compiled": Ours, "theirs": Theirs, "absent": Absent}


def section(theirs: Array | Failed) -> Section:
    def run(key: str, *_: object) -> dict[str, Any]:
        if key == "theirs" and isinstance(theirs, Failed):
            raise theirs
        return {
            "q": np.zeros((3, 2)) if key != "theirs" else theirs,
            "wall": 0.5 if key != "theirs" else 5.0,
            "ready": 1,
        }

    return closed_loop.section("a", "ur10_fast", 10, 1e-3, 1, peers=KNOWN, run=run, look=KNOWN.__getitem__)


def by_name(found: Section) -> dict[str, Row]:
    return {row.name: row for row in found.rows}


def report(*rows: Row) -> Report:
    return Report("python -m tests.benchmarks", MACHINE, (Section("a", "a title", "ours to theirs", rows),))


def test_a_peer_that_agrees_counts_with_its_ratio() -> None:
    row = by_name(section(np.full((3, 2), 1e-6)))["theirs"]
    assert (row.status, row.value, row.ratio) == ("ok", 2.0, 10.0)
    assert row.agreement == "1.0e-06 rad"
    assert "unfair to them" in row.note


@pytest.mark.parametrize(
    ("found", "why"),
    [
        (np.full((3, 2), 1e-3), "1.0e-03 rad"),
        (np.full((3, 2), np.nan), "not finite everywhere"),
        (np.zeros((2, 2)), "2 samples for 3"),
    ],
)
def test_a_peer_that_disagrees_does_not_count_and_the_table_reports_it(found: Array, why: str) -> None:
    whole = section(found)
    row = by_name(whole)["theirs"]
    assert (row.status, row.ratio) == ("disagrees", None)
    text = Report("", MACHINE, (whole,)).as_text()
    assert f"does not agree: {why}" in text
    assert "does not count" in text


def test_a_missing_peer_is_reported_with_how_to_install_it() -> None:
    row = by_name(section(np.zeros((3, 2))))["absent"]
    assert row.status == "missing"
    assert row.agreement == "a-package-that-does-not-exist is not installed; pip install --group peers"
    assert row.cells()[2] == "missing"


def test_a_peer_that_fails_is_reported_with_its_last_words() -> None:
    row = by_name(section(Failed("ValueError: no such block")))["theirs"]
    assert (row.status, row.agreement, row.cells()[2]) == ("failed", "ValueError: no such block", "failed")


def test_a_measurement_that_fails_or_takes_too_long_is_reported() -> None:
    with pytest.raises(Failed, match="has no attribute 'nothing_like_it'"):
        measure("table:nothing_like_it", 60)
    with pytest.raises(Failed, match=r"no result within 0\.01 s"):
        measure("table:Report", 0.01)


def test_a_table_survives_json_and_shows_every_row_as_text_and_as_markdown() -> None:
    rows = (
        Row("a", "ours", 2000.0, "x real time"),
        Row("a", "theirs | mine", 20.0, "x real time", 100.0, version="1.2"),
    )
    made = report(*rows)
    assert Report.from_json(made.as_json()) == made
    assert "| theirs \\| mine | 1.2 | 20 x real time | 100 |" in made.as_markdown()
    lines = made.as_text().splitlines()
    assert [line.split()[0] for line in lines if "x real time" in line] == ["ours", "theirs"]


def test_a_ratio_that_falls_behind_its_baseline_is_a_regression() -> None:
    good = report(Row("a", "theirs", 1.0, "s", 30.0), Row("a", "others", 1.0, "s", 5.0))
    ratios = {row.key: row.ratio for row in good.rows if row.ratio is not None}
    assert baseline.regressions(good, ratios) == []
    seeded = report(Row("a", "theirs", 1.0, "s", 19.0), Row("a", "others", 1.0, "s", 4.0))
    (found,) = baseline.regressions(seeded, ratios)
    assert str(found) == "a/theirs: expected a ratio of about 30, found 19"


def test_a_row_that_no_longer_counts_is_a_regression_and_one_that_is_missing_is_not() -> None:
    ratios = {"a/theirs": 30.0, "a/absent": 3.0, "b/not run": 2.0}
    rows = (Row("a", "theirs", status="failed", agreement="it crashed"), Row("a", "absent", status="missing"))
    (found,) = baseline.regressions(report(*rows), ratios)
    assert str(found) == "a/theirs: expected a ratio of about 30, found none: it crashed"


def test_check_ends_with_status_1_at_a_seeded_regression(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    kept, table = tmp_path / "baseline.json", tmp_path / "table.json"
    baseline.write(report(Row("a", "theirs", 1.0, "s", 30.0)), kept)
    table.write_text(report(Row("a", "theirs", 1.0, "s", 29.0)).as_json(), encoding="utf-8")
    arguments = ["--from-json", str(table), "--baseline", str(kept), "--check"]
    assert main(arguments) == 0
    table.write_text(report(Row("a", "theirs", 1.0, "s", 10.0)).as_json(), encoding="utf-8")
    assert main(arguments) == 1
    assert "regression: a/theirs: expected a ratio of about 30, found 10" in capsys.readouterr().err


def test_the_baseline_that_is_kept_holds_ratios_only() -> None:
    data = json.loads(baseline.FILE.read_text(encoding="utf-8"))
    assert set(data) == {"command", "tolerance", "ratios"}
    assert data["tolerance"] == baseline.TOLERANCE
    assert all(ratio > 0 for ratio in data["ratios"].values())


def test_an_unknown_part_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["z"])
    assert f"expected parts of {' '.join(PARTS)}, found z" in capsys.readouterr().err


def test_the_table_is_written_into_a_page_below_its_heading(tmp_path: Path) -> None:
    page, table = tmp_path / "page.md", tmp_path / "table.json"
    page.write_text("# Speed\n\nWords.\n\n## The table\n\nold\n", encoding="utf-8")
    table.write_text(report(Row("a", "theirs", 1.0, "s", 30.0)).as_json(), encoding="utf-8")
    assert main(["--from-json", str(table), "--page", str(page)]) == 0
    text = page.read_text(encoding="utf-8")
    assert text.startswith("# Speed\n\nWords.\n\n## The table\n\n- made by: `python -m tests.benchmarks`\n")
    assert "| theirs |  | 1 s | 30 |" in text
    assert "old" not in text


def test_the_published_page_holds_every_part() -> None:
    page = (Path(__file__).parents[2] / "docs" / "explanation" / "speed.md").read_text(encoding="utf-8")
    assert [part for part in "abcdef" if f"### ({part}) " not in page] == []
