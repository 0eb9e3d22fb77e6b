"""The command line."""

from __future__ import annotations

import sys

FAULT = 2
STOPPED = 130


def main() -> None:
    """Run `dmframe`; a fault is one line a fault on standard error, never a traceback."""
    import typer

    from dmframe.cli.app import app
    from dmframe.errors import DmframeError, Faults

    # typer carries a click of its own in some versions and not in others; this is the exception that both have.
    bases = typer.BadParameter.__mro__
    usage_error: type[Exception] = next(kind for kind in bases if kind.__name__ == "ClickException")  # type: ignore[assignment]
    try:
        status = app(standalone_mode=False)
    except DmframeError as error:
        for fault in error.faults if isinstance(error, Faults) else (error,):
            typer.echo(f"dmframe: {fault}", err=True)
        sys.exit(FAULT)
    except usage_error as error:
        error.show()  # type: ignore[attr-defined]
        sys.exit(FAULT)
    except (typer.Abort, KeyboardInterrupt):
        typer.echo("dmframe: stopped", err=True)
        sys.exit(STOPPED)
    except BrokenPipeError:
        sys.stderr.close()  # the reader has gone; Python would complain once more at exit
        sys.exit(0)
    sys.exit(status if isinstance(status, int) else 0)
