"""The libraries in a cache folder, which also contains folders of robots and of verdicts."""

from pathlib import Path


def libraries(cache: Path) -> list[Path]:
    """All entries except folders, sorted."""
    return sorted(path for path in cache.iterdir() if not path.is_dir())
