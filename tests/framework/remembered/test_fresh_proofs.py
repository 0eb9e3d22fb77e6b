"""A cached verdict is printed while none of its inputs has changed; each kind of change leads to a new proof."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import dmframe_plants

BLOCK = """
import os
from pathlib import Path
from typing import ClassVar

import installed
import helper
from dmframe.block import AbstractBlock, Equations
from dmframe.block.port import Side, State


class Mine(AbstractBlock):
    side: ClassVar = Side.PLANT
    states: ClassVar = (State("x", "1"),)

    def equations(self, u, x, p):
        data = float(Path(__file__).with_name("data.txt").read_text())
        gain = data + helper.GAIN + installed.GAIN + float(os.environ.get("MY_GAIN", "0"))
        return Equations(rates={"x": -gain * x.x})
"""
GRAPH = "dmframe: 1\nrobot: {model: arm.urdf}\nduration: 1 s\nclock: continuous\nblocks:\n  mine: {type: my.py:Mine}\n"


class Place:
    """A folder with a graph, its block, and all files that the block reads."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.environment = {**os.environ, "DMFRAME_CACHE": str(folder / "cache")}
        self.environment["PYTHONPATH"] = os.pathsep.join(map(str, (folder / "lib", folder / "site-packages")))
        (folder / "lib").mkdir()
        (folder / "site-packages").mkdir()
        (folder / "site-packages" / "installed.py").write_text("GAIN = 1\n")
        (folder / "lib" / "helper.py").write_text("GAIN = 1\n")
        (folder / "data.txt").write_text("1")
        (folder / "my.py").write_text(BLOCK)
        (folder / "graph.yaml").write_text(GRAPH)
        urdf = Path(dmframe_plants.__path__[0]) / "arm2" / "arm2.urdf"
        (folder / "arm.urdf").write_text(urdf.read_text())

    def verify(self, *words: str) -> dict[str, Any]:
        call = [sys.executable, "-c", "from dmframe.cli import main; main()", "verify", "graph.yaml", "--json", *words]
        done = subprocess.run(call, cwd=self.folder, env=self.environment, capture_output=True, text=True, check=False)
        assert done.returncode == 1, done.stderr
        found: dict[str, Any] = json.loads(done.stdout)
        return found

    def run(self, *words: str) -> tuple[dict[str, Any], bool]:
        """The summary of a run, and whether its conclusions came from the cache: they are not written again."""
        kept = {path: path.stat().st_ino for path in self.folder.glob("cache/verdicts/*.verdict")}
        call = [sys.executable, "-c", "from dmframe.cli import main; main()", "run", "graph.yaml", "--json"]
        call += ["--no-plots", "--force", "--out", "results", *words]
        done = subprocess.run(call, cwd=self.folder, env=self.environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        found: dict[str, Any] = json.loads(done.stdout)
        now = {path: path.stat().st_ino for path in self.folder.glob("cache/verdicts/*.verdict")}
        return {key: value for key, value in found.items() if key not in ("wall_time", "real_time_factor")}, now == kept


STORING = (
    BLOCK.replace("Equations\nfrom", "Certificate, Equations, Square\nfrom")
    + """
    def certificate(self, u, x, p, truth):
        data = float(Path(__file__).with_name("data.txt").read_text())
        return Certificate(storage=(Square(x.x, data),), dissipation=(Square(x.x, 4 * data),))
"""
)


def test_what_a_run_concludes_is_recalled_until_an_input_changes(tmp_path: Path) -> None:
    place = Place(tmp_path)
    (tmp_path / "my.py").write_text(STORING)
    first, recalled = place.run()
    assert not recalled
    assert first["storage"]["reason"] is None
    assert place.run() == (first, True)
    assert place.run("--engine", "interpreted") == (first, True)
    assert place.run("--fresh") == (first, False)
    assert not place.run("--set", "duration=2 s")[1]
    changes = {
        "data": lambda: (tmp_path / "data.txt").write_text("-1"),  # its storage is negative: there is no V
        "block": lambda: (tmp_path / "my.py").write_text(STORING + "# more\n"),
        "helper": lambda: (tmp_path / "lib" / "helper.py").write_text("GAIN = 2\n"),
        "urdf": lambda: (tmp_path / "arm.urdf").write_text((tmp_path / "arm.urdf").read_text() + "\n"),
        "variable": lambda: place.environment.update(MY_GAIN="1"),
        "graph": lambda: (tmp_path / "graph.yaml").write_text(GRAPH + "# more\n"),
    }
    for name, change in changes.items():
        change()
        found, recalled = place.run()
        assert not recalled, name
        assert found["storage"]["reason"], name
    assert place.run() == (found, True)


def test_each_kind_of_change_is_proved_again(tmp_path: Path) -> None:
    place = Place(tmp_path)
    first = place.verify()
    assert not first["remembered"]
    again = place.verify()
    assert again == {**first, "remembered": True}
    assert not place.verify("--fresh")["remembered"]
    assert not place.verify("--seed", "1")["remembered"]
    assert not place.verify("--set", "duration=2 s")["remembered"]
    changes = {
        "graph": lambda: (tmp_path / "graph.yaml").write_text(GRAPH + "# more\n"),
        "block": lambda: (tmp_path / "my.py").write_text(BLOCK + "# more\n"),
        "helper": lambda: (tmp_path / "lib" / "helper.py").write_text("GAIN = 2\n"),
        "shadow": lambda: (tmp_path / "lib" / "installed.py").write_text("GAIN = 3\n"),
        "data": lambda: (tmp_path / "data.txt").write_text("2"),
        "urdf": lambda: (tmp_path / "arm.urdf").write_text((tmp_path / "arm.urdf").read_text() + "\n"),
        "library": lambda: (tmp_path / "lib" / "installed.py").unlink(),
        "version": lambda: (tmp_path / "site-packages" / "installed.py").write_text("GAIN = 55\n"),
        "variable": lambda: place.environment.update(MY_GAIN="1"),
        "seal": lambda: (tmp_path / "seal.json").write_text("{}"),
    }
    for name, change in changes.items():
        assert place.verify()["remembered"] or name == "graph", name
        change()
        assert not place.verify()["remembered"], name
    assert place.verify()["remembered"]
