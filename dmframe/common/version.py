"""Versions of dmframe and of other installed packages."""

from __future__ import annotations

from pathlib import Path


def version() -> str:
    """Installed version, looked up at the call, since that takes a while."""
    from importlib.metadata import version as installed

    return installed("dmframe")


def version_of(package: str) -> str | None:
    """Installed version of a distribution; None if it is not installed.

    It reads the head of the metadata; `importlib.metadata.version` parses the whole description too.
    """
    from importlib.metadata import PackageNotFoundError, distribution

    try:
        found = distribution(package)
    except PackageNotFoundError:
        return None
    head, _, _ = (found.read_text("METADATA") or "").partition("\n\n")
    versions = (line.removeprefix("Version: ") for line in head.splitlines() if line.startswith("Version: "))
    return next(versions, None) or found.version


def installing(extra: str) -> str:
    """Command that installs the packages of an extra: from the folder of the sources, if dmframe runs there."""
    folder = Path(__file__).parents[2]
    return (
        f'pip install -e "{folder}[{extra}]"'
        if (folder / "pyproject.toml").exists()
        else f'pip install "dmframe[{extra}]"'
    )
