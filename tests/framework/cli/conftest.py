from __future__ import annotations

import contextlib
import io
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from dmframe.cli import main


@dataclass(frozen=True)
class Said:
    status: int
    out: str
    err: str


Dmframe = Callable[..., Said]


@pytest.fixture
def dmframe(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Dmframe:
    """`dmframe words...` through its entry point, in an empty folder, in this process, so that it is fast."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")

    def call(*words: str) -> Said:
        monkeypatch.setattr(sys, "argv", ["dmframe", *words])
        out, err = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), pytest.raises(SystemExit) as stopped:
            main()
        reported = Said(int(stopped.value.code or 0), out.getvalue(), err.getvalue())
        assert "Traceback" not in reported.out + reported.err
        return reported

    return call
