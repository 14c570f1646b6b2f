"""The application object, and what happens to errors."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from importlib.metadata import version

from cyclopts import App
from rich.console import Console

from hueflight.errors import HueflightError

EXIT_FAILED = 1  #: the command understood what was wanted and could not do it
EXIT_INTERRUPTED = 130  #: Ctrl-C, as shells have it

app = App(
    name="hueflight",
    help="Multispectral time-of-flight imaging: distance and colour in the same photons.",
    version=version("hueflight"),
    # one line of help per command; details with COMMAND --help
    help_format="markdown",
)
errors = Console(stderr=True)


def main(words: Sequence[str] | None = None) -> None:
    """Entry point: expected failures become one message and an exit code.

    `words` are what was typed after the program's name; by default the real ones.
    """
    # importing them registers their commands
    from hueflight.cli import (  # noqa: F401
        calibrate,
        capture,
        demo,
        export,
        info,
        reconstruct,
        recover,
        serve,
        simulate,
    )

    try:
        app(sys.argv[1:] if words is None else words)
    except HueflightError as error:
        errors.print(f"[bold red]error:[/] {_plain(str(error))}", highlight=False, soft_wrap=True)
        raise SystemExit(EXIT_FAILED) from None
    except KeyboardInterrupt:
        errors.print("interrupted", highlight=False)
        raise SystemExit(EXIT_INTERRUPTED) from None
    except BrokenPipeError:
        # whoever read our output has left; a second complaint at exit would be noise
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise SystemExit(EXIT_FAILED) from None
    except OSError as error:
        where = f" {error.filename!r}" if error.filename else ""
        errors.print(f"[bold red]error:[/] {error.strerror or error}{where}", highlight=False)
        raise SystemExit(EXIT_FAILED) from None


def _plain(text: str) -> str:
    """Keep square brackets of a message from being read as markup."""
    return text.replace("[", r"\[")
