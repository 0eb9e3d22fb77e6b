"""The libraries in a cache folder, which has a folder of robots too."""

from pathlib import Path

from dmframe.config.cached_robot import FOLDER


def libraries(cache: Path) -> list[Path]:
    """All entries but the folder of robots, sorted."""
    return sorted(path for path in cache.iterdir() if path.name != FOLDER)
