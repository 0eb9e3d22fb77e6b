"""The command line."""

from __future__ import annotations

import os
import sys
import traceback

from dmframe.cli.signals import stoppable
from dmframe.cli.streams import OutputGone, drop_output, prepare
from dmframe.files import FULL

FAULT = 2
STOPPED = 130
COMPLETING = "_DMFRAME_COMPLETE"


def main() -> None:
    """Run `dmframe`; a fault is one line a fault on standard error, never a traceback."""
    prepare()
    status = FAULT
    try:
        with stoppable():
            status = _told()
            sys.stdout.flush()
    except KeyboardInterrupt:
        status = STOPPED
    except OutputGone as gone:
        drop_output()
        status = 0  # the reader has gone, as `head` does when it has seen enough
        if not isinstance(gone.why, BrokenPipeError):
            _say(f"cannot write the output: {(gone.why.strerror or str(gone)).lower()}")
            status = FAULT
    if status == STOPPED:
        _say("stopped")
    sys.exit(status)


def _told() -> int:
    """Run the command that the arguments name; returns the exit status, all faults told."""
    import typer

    from dmframe.cli.app import app
    from dmframe.errors import DmframeError, visible

    # typer carries a click of its own in some versions and not in others; this is the exception that both have.
    bases = typer.BadParameter.__mro__
    usage_error: type[Exception] = next(kind for kind in bases if kind.__name__ == "ClickException")
    try:
        status = app(standalone_mode=False)
    except DmframeError as error:
        for fault in error.faults:
            _say(visible(str(fault)))
        return FAULT
    except usage_error as error:
        error.show()  # type: ignore[attr-defined]  # its class was found above; typer keeps it to itself
        return FAULT
    except typer.Abort:
        return STOPPED
    except (KeyboardInterrupt, OutputGone):
        raise
    except BaseException as error:  # a user's block may raise anything, SystemExit(0) too, the status of what is proved
        if isinstance(error, SystemExit) and COMPLETING in os.environ:  # a shell asks for words, and no block runs
            raise
        _say(_unexpected(error))
        return FAULT
    return status if isinstance(status, int) else 0


def _say(text: str) -> None:
    print(f"dmframe: {text}", file=sys.stderr)  # noqa: T201 - typer may be what failed


_REQUIRED = {
    **{name: name for name in "numpy scipy casadi pydantic pydantic_core control typer rich xarray h5netcdf".split()},
    **{name: name for name in "h5py matplotlib jinja2 latex2mathml platformdirs polars click".split()},
    "pinocchio": "pin",
    "ruamel": "ruamel.yaml",
    "example_robot_data": "example-robot-data",
}
"""Packages by the names under which they are imported."""


def _unexpected(error: BaseException) -> str:
    """What no class of `dmframe.errors` tells: a file that cannot be read, or a defect, with its line."""
    if isinstance(error, OSError) and isinstance(error.filename, str | bytes):  # what is written is told by `writing`
        return f"{os.fsdecode(error.filename)}: cannot be read: {(error.strerror or str(error)).lower()}"
    if isinstance(error, OSError) and error.errno in FULL:
        why = (error.strerror or str(error)).lower()
        return f"a file cannot be written: {why}; free some space, also where temporary files are kept"
    if isinstance(error, ImportError) and (name := (error.name or "").partition(".")[0]) in _REQUIRED:
        package, why = _REQUIRED[name], " ".join(str(error).split())
        return f"the package {package}, which dmframe needs, cannot be imported: {why}; pip install {package}"
    frames = traceback.extract_tb(error.__traceback__)
    place = f"{os.path.basename(frames[-1].filename)}:{frames[-1].lineno}" if frames else "an unknown place"  # noqa: PTH119 - pathlib may be what failed
    text = " ".join(str(error).split())
    return f"{place}: {type(error).__name__}: {text}; a defect of dmframe or of a block, please report it"
