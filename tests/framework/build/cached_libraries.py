"""The libraries in a cache folder, which also contains a folder of robots."""

from pathlib import Path

from dmframe.config.cached_robot import FOLDER


def libraries(cache: Path) -> list[Path]:
    """All entries except the folder of robots, sorted."""
    return sorted(path for path in cache.iterdir() if path.name != FOLDER)
