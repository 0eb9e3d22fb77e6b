"""Versions of dmframe and of other installed packages."""

from __future__ import annotations


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
