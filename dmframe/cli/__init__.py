"""The command line."""

from __future__ import annotations

import gc
import os
import sys
import traceback
from typing import TYPE_CHECKING

from dmframe.cli.signals import stoppable
from dmframe.cli.streams import OutputGone, drop_output, listeners, prepare, tell
from dmframe.common.files import FULL

if TYPE_CHECKING:
    from dmframe.remembered.front import Call

FAULT = 2
STOPPED = 130
COMPLETING = "_DMFRAME_COMPLETE"
ALLOCATIONS = 500_000
"""Allocations between two garbage collections, of 0.1 s; with Python's 700, these take a tenth of a proof's time."""


def main() -> None:
    """Run `dmframe`; each fault is one line on standard error, never a traceback."""
    prepare()
    gc.set_threshold(ALLOCATIONS)
    status = FAULT
    try:
        with stoppable():
            status = _status()
            sys.stdout.flush()
    except KeyboardInterrupt:
        status = STOPPED
    except OutputGone as gone:
        drop_output()
        status = 0  # the reader closed the pipe, as `head` does
        if not isinstance(gone.why, BrokenPipeError):
            _say(f"cannot write the output: {(gone.why.strerror or str(gone)).lower()}")
            status = FAULT
    if status == STOPPED:
        _say("stopped")
    sys.exit(status)


def _status() -> int:
    """Run the command of the arguments and report its faults; returns the exit status."""
    from dmframe.remembered.front import call_of, found, page_of

    loaded = "dmframe.catalogue" in sys.modules  # earlier reads of this process were not recorded
    call = None if loaded or COMPLETING in os.environ else call_of(sys.argv[1:])
    if call is not None and (entry := found(call)) is None:
        _record(call)
    elif call is not None and entry is not None:
        if call.command == "run":
            from dmframe.remembered.conclusions import recall

            recall(entry)
        else:
            sys.stderr.write("".join(entry["aside"]))
            tell(page_of(entry, as_json=call.as_json))
            return int(entry["status"])
    return _commanded()


def _record(call: Call) -> None:
    """Record the inputs of the proof or the run, so that its verdict or its conclusions can be remembered."""
    from dmframe.remembered.recorder import begin

    recorder = begin(call)
    if recorder is not None and call.command == "verify":
        listeners.append(recorder.aside)


def _commanded() -> int:
    """Run the command with its library; returns the exit status."""
    import typer

    from dmframe.cli.app import app_for
    from dmframe.common.errors import DmframeError, visible

    # some versions of typer contain their own click; this is the exception class of both
    bases = typer.BadParameter.__mro__
    usage_error: type[Exception] = next(kind for kind in bases if kind.__name__ == "ClickException")
    try:
        status = app_for(sys.argv[1:])(standalone_mode=False)
    except DmframeError as error:
        for fault in error.faults:
            _say(visible(str(fault)))
        return FAULT
    except usage_error as error:
        error.show()  # type: ignore[attr-defined]  # class found above; typer does not export it
        return FAULT
    except typer.Abort:
        return STOPPED
    except (KeyboardInterrupt, OutputGone):
        raise
    except BaseException as error:  # a user block may raise anything, even SystemExit(0), the status of a proof
        if isinstance(error, SystemExit) and COMPLETING in os.environ:  # shell completion, no block runs
            raise
        _say(_unexpected(error))
        return FAULT
    return status if isinstance(status, int) else 0


def _say(text: str) -> None:
    print(f"dmframe: {text}", file=sys.stderr)  # noqa: T201 - typer may be what failed


_REQUIRED = {
    **{name: name for name in "numpy scipy casadi pydantic pydantic_core control typer rich xarray h5netcdf".split()},
    **{name: name for name in "h5py matplotlib jinja2 platformdirs polars click".split()},
    "pinocchio": "pin",
    "flint": "python-flint",
    "ruamel": "ruamel.yaml",
}
"""Distribution names by import name."""


def _unexpected(error: BaseException) -> str:
    """Message for an error outside `dmframe.common.errors`: an unreadable file, or a defect with its line."""
    if isinstance(error, OSError) and isinstance(
        error.filename, str | bytes
    ):  # `writing` reports errors of output files
        return f"{os.fsdecode(error.filename)}: cannot be read: {(error.strerror or str(error)).lower()}"
    if isinstance(error, OSError) and error.errno in FULL:
        why = (error.strerror or str(error)).lower()
        return f"a file cannot be written: {why}; free some space, also for temporary files"
    if isinstance(error, OSError) and error.errno is not None:  # such as a disk failure without a file name
        return f"the system failed: {(error.strerror or str(error)).lower()}; check disks and limits"
    package = _required(error)
    text, frames = " ".join(str(error).split()), traceback.extract_tb(error.__traceback__)
    if package and (isinstance(error, ImportError) or any(_is_import(frame, package) for frame in frames)):
        why = text if isinstance(error, ImportError) else f"{type(error).__name__}: {text}"
        return f"the package {package}, which dmframe needs, cannot be imported: {why}; pip install {package}"
    place = f"{os.path.basename(frames[-1].filename)}:{frames[-1].lineno}" if frames else "an unknown place"  # noqa: PTH119 - pathlib may be what failed
    whose = f"a broken installation of {package}, or a defect" if package else "a defect"
    return f"{place}: {type(error).__name__}: {text}; {whose} of dmframe or of a block, please report it"


def _required(error: BaseException) -> str:
    """Required package that could not be imported, or that raised the error."""
    name = (error.name or "").partition(".")[0] if isinstance(error, ImportError) else ""
    frames = traceback.extract_tb(error.__traceback__)
    owners = [_REQUIRED[owner] for frame in frames if (owner := _owner(frame)) in _REQUIRED]
    if name in _REQUIRED:
        return _REQUIRED[name]
    if isinstance(error, ImportError):  # for an indirect dependency, the package that dmframe imported
        return owners[0] if owners else ""
    return owners[-1] if frames and _owner(frames[-1]) in _REQUIRED else ""


def _owner(frame: traceback.FrameSummary) -> str:
    """Installed package of a line of code; empty for other code."""
    parts = frame.filename.replace(os.sep, "/").split("/")
    installed = [k for k, part in enumerate(parts[:-1]) if part in ("site-packages", "dist-packages")]
    return parts[installed[-1] + 1].partition(".")[0] if installed else ""


def _is_import(frame: traceback.FrameSummary, package: str) -> bool:
    return frame.name == "<module>" and _REQUIRED.get(_owner(frame)) == package
