"""The command line."""

from __future__ import annotations

import os
import sys
import traceback

FAULT = 2
STOPPED = 130


def main() -> None:
    """Run `dmframe`; a fault is one line a fault on standard error, never a traceback."""
    try:
        status = _told()
        sys.stdout.flush()
    except KeyboardInterrupt:
        status = STOPPED
    except BrokenPipeError:
        _drop_output()  # the reader has gone, as `head` does when it has seen enough
        status = 0
    except OSError as error:
        _drop_output()
        _say(f"cannot write the output: {(error.strerror or str(error)).lower()}")
        status = FAULT
    if status == STOPPED:
        _say("stopped")
    sys.exit(status)


def _told() -> int:
    """Run the command that the arguments name; returns the exit status, all faults told."""
    import typer

    from dmframe.cli.app import app
    from dmframe.errors import DmframeError, Faults

    # typer carries a click of its own in some versions and not in others; this is the exception that both have.
    bases = typer.BadParameter.__mro__
    usage_error: type[Exception] = next(kind for kind in bases if kind.__name__ == "ClickException")
    try:
        status = app(standalone_mode=False)
    except DmframeError as error:
        for fault in error.faults if isinstance(error, Faults) else (error,):
            _say(str(fault))
        return FAULT
    except usage_error as error:
        error.show()  # type: ignore[attr-defined]  # its class was found above; typer keeps it to itself
        return FAULT
    except typer.Abort:
        return STOPPED
    except SystemExit as error:
        if isinstance(error.__context__, OSError):
            raise error.__context__ from None  # typer's own end of a broken pipe
        raise
    except OSError:
        raise
    except Exception as error:  # a defect: one line with its place, and no traceback
        _say(_unexpected(error))
        return FAULT
    return status if isinstance(status, int) else 0


def _say(text: str) -> None:
    print(f"dmframe: {text}", file=sys.stderr)  # noqa: T201 - typer may be what failed


def _unexpected(error: Exception) -> str:
    """What no class of `dmframe.errors` tells: a defect, with the line where it came up."""
    frames = traceback.extract_tb(error.__traceback__)
    place = f"{os.path.basename(frames[-1].filename)}:{frames[-1].lineno}" if frames else "an unknown place"  # noqa: PTH119 - pathlib may be what failed
    text = " ".join(str(error).split())
    return f"{place}: {type(error).__name__}: {text}; a defect of dmframe or of a block, please report it"


def _drop_output() -> None:
    """Let nothing more be written: Python would complain once more when it flushes at its exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
