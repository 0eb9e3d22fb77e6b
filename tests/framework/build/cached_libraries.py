"""The libraries in a cache folder, which also contains folders of robots and of verdicts."""

from pathlib import Path

from dmframe.config.cached_robot import FOLDER as ROBOTS
from dmframe.remembered.store import FOLDER as VERDICTS


def libraries(cache: Path) -> list[Path]:
    """All entries except the folders of robots and of verdicts, sorted."""
    return sorted(path for path in cache.iterdir() if path.name not in (ROBOTS, VERDICTS))
