"""The application object, and what happens to errors."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Sequence
from importlib import import_module
from importlib.metadata import version

from cyclopts import App
from rich.console import Console

from hueflight_protocol.errors import HueflightError

EXIT_FAILED = 1
"""The command understood what was wanted and could not do it."""
EXIT_SHORT = 2
"""A bitstream was written whose clocks lack the margin asked for; or a proof found a fault."""
EXIT_INTERRUPTED = 130
"""Ctrl-C, as shells have it."""

app = App(
    name="hueflight-hdl",
    help="Gateware of the illuminator and the camera: bitstreams, Verilog, waveforms, proofs.",
    version=version("hueflight"),
    help_format="markdown",
)
_COMMANDS = ("build", "prove", "simulate", "verilog")
errors = Console(stderr=True, soft_wrap=True, highlight=False, markup=False)


def main(words: Sequence[str] | None = None) -> None:
    """Entry point: expected failures become one message and an exit code.

    `words` are what was typed after the program's name; by default the real ones.
    """
    try:
        for name in _COMMANDS:
            import_module(f".{name}", __package__)  # which registers it with `app`
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] not in ("amaranth", "amaranth_boards", "luna"):
            raise
        errors.print(f"error: {error.name} is not there: pip install 'hueflight[bitstream]'")
        raise SystemExit(EXIT_FAILED) from None
    try:
        app(sys.argv[1:] if words is None else words)
    except HueflightError as error:
        errors.print("error:", str(error))
        raise SystemExit(EXIT_FAILED) from None
    except KeyboardInterrupt:
        errors.print("interrupted")
        raise SystemExit(EXIT_INTERRUPTED) from None
    except BrokenPipeError:
        # whoever read our output has left; a second complaint at exit would be noise
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise SystemExit(EXIT_FAILED) from None
    except OSError as error:
        where = f" {error.filename!r}" if error.filename else ""
        errors.print(f"error: {error.strerror or error}{where}")
        raise SystemExit(EXIT_FAILED) from None


class Said:
    """Progress: one line for each thing that begins, with the seconds since the first."""

    def __init__(self) -> None:
        self._began = time.monotonic()

    def __call__(self, what: str) -> None:
        """Say it on the error stream, where results are not."""
        errors.print(f"[{time.monotonic() - self._began:5.0f} s] {what}")
