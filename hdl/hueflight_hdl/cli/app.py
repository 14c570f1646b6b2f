# SPDX-License-Identifier: Apache-2.0
"""The application object and the handling of errors."""

from __future__ import annotations

import os
import sys
import time
import warnings
from collections.abc import Sequence
from importlib import import_module
from importlib.metadata import version

from cyclopts import App
from rich.console import Console

from hueflight_protocol.errors import HueflightError

EXIT_FAILED = 1
"""The command was understood but failed."""
EXIT_SHORT = 2
"""A bitstream misses the required timing margin, or a formal property does not hold."""
EXIT_INTERRUPTED = 130
"""The user pressed Ctrl-C; the code that shells use."""

app = App(
    name="hueflight-hdl",
    help="Build, export, simulate and formally verify the gateware of the two boards.",
    version=version("hueflight"),
    help_format="markdown",
)
_COMMANDS = ("build", "prove", "registers", "simulate", "verilog")
errors = Console(stderr=True, soft_wrap=True, highlight=False, markup=False)


def main(words: Sequence[str] | None = None) -> None:
    """Run the command; expected failures become one message and an exit code.

    Parameters
    ----------
    words : sequence of str, optional
        Arguments after the program's name; by default those of this process.
    """
    try:
        for name in _COMMANDS:
            import_module(f".{name}", __package__)  # which registers it with `app`
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] not in ("amaranth", "amaranth_boards", "luna"):
            raise
        errors.print(
            f"error: the package {error.name} is not installed: pip install 'hueflight[bitstream]'"
        )
        raise SystemExit(EXIT_FAILED) from None
    try:
        app(sys.argv[1:] if words is None else words)
    except HueflightError as error:
        # Amaranth warns of each part that an interrupted elaboration has not used
        warnings.filterwarnings("ignore", message=".* created but never used")
        errors.print("error:", str(error))
        raise SystemExit(EXIT_FAILED) from None
    except KeyboardInterrupt:
        errors.print("interrupted")
        raise SystemExit(EXIT_INTERRUPTED) from None
    except BrokenPipeError:
        # the reader of our output has closed it; a second message at exit would only be noise
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise SystemExit(EXIT_FAILED) from None
    except OSError as error:
        where = f" {error.filename!r}" if error.filename else ""
        errors.print(f"error: {error.strerror or error}{where}")
        raise SystemExit(EXIT_FAILED) from None


class Progress:
    """Prints each step as it begins, with the seconds since the command started."""

    def __init__(self) -> None:
        self._began = time.monotonic()

    def __call__(self, what: str) -> None:
        """Print a step on the error stream, so that standard output carries results only."""
        errors.print(f"[{time.monotonic() - self._began:5.0f} s] {what}")
