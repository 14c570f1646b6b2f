# SPDX-License-Identifier: Apache-2.0
"""The command line's entry point: commands by name, loaded when called; errors as messages."""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Sequence

from cyclopts import App, CycloptsError

from hueflight.cli.exit_codes import FAILED, INTERRUPTED
from hueflight.errors import HueflightError
from hueflight.memory import LIMIT_NAME

#: summary of each command; function NAME of module ``hueflight.cli.NAME`` runs it
COMMANDS = {
    "board": "Test a board, choose its clock, or measure the skew of LEDs.",
    "calibrate": "Make a calibration from captures of a flat target.",
    "capture": "Record a capture from the camera.",
    "check": "Check with a new reference capture whether a calibration still holds.",
    "demo": "Redraw the published figures from a simulated instrument, as a page with pictures.",
    "export": "Write an image in a format that other tools open, or pictures into a recording.",
    "info": "Show what a file is, what it holds and whether it is whole.",
    "instrument": "Make the description of an instrument, compare it with a capture, or show it.",
    "reconstruct": "Reconstruct depth and reflectance in every band from one or many captures.",
    "recover": "Save what is left of a damaged or unfinished recording.",
    "serve": "Run the capture daemon: live page, HTTP interface and recordings.",
    "simulate": "Record a simulated capture.",
    "view": "Show an image, a recording or counts in the browser, as one HTML file.",
}

HELP = """Multispectral time-of-flight imaging: depth and colour from the same photons.

`hueflight COMMAND --help` describes a command and its options.
"""

EXIT_CODES = """**Exit codes**

- 0: The command did what was asked.
- 1: The command failed or its arguments were wrong; a message on standard error says why.
- 3: Some data is lost: recover saved what is left, or info found a file damaged or incomplete.
- 4: check found that a calibration no longer holds.
- 130: The command was interrupted with Ctrl-C.
"""


def main(words: Sequence[str] | None = None) -> None:
    """Run a command; expected failures become one message and an exit code.

    Parameters
    ----------
    words : sequence of str, optional
        What follows the program's name; by default the arguments of this process.

    Raises
    ------
    SystemExit
        Always, with one of the exit codes that the help lists.
    """
    typed = sys.argv[1:] if words is None else list(words)
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _show_warning
            application(typed)(typed, exit_on_error=False, print_error=False)
    except CycloptsError as error:
        from hueflight.cli.usage import explain

        _fail(explain(error))
    except HueflightError as error:
        _fail(str(error))
    except MemoryError:
        _fail(f"memory is exhausted: end other programs, or work on less at a time ({LIMIT_NAME})")
    except KeyboardInterrupt:
        _say("interrupted")
        raise SystemExit(INTERRUPTED) from None
    except BrokenPipeError:
        # whoever read our output has left; a second complaint at exit would be noise
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise SystemExit(FAILED) from None
    except OSError as error:
        where = f" {error.filename!r}" if error.filename else ""
        _fail(f"{error.strerror or error}{where}")


def application(words: Sequence[str] = ()) -> App:
    """Application with all commands, none of them loaded yet.

    Parameters
    ----------
    words : sequence of str, optional
        What will be parsed. The help of a command named here is its own docstring; of the
        others only the summary is known without loading them.

    Returns
    -------
    App
        The application, ready to be called with `words`.
    """
    app = App(
        name="hueflight",
        help=HELP,
        help_epilogue=EXIT_CODES,
        help_format="markdown",
        version=_version,
        version_format="plaintext",
    )
    app.register_install_completion_command(
        help="Install completion of commands and options for the shell in use (bash, zsh or fish)."
    )
    for name, summary in COMMANDS.items():
        app.command(
            f"hueflight.cli.{name}:{name}", name=name, help=None if name in words else summary
        )
    return app


def _version() -> str:
    from hueflight.cli.version import describe_version

    return describe_version()


def _fail(message: str) -> None:
    from hueflight.cli.output import print_error

    print_error(message)
    raise SystemExit(FAILED) from None


def _say(message: str) -> None:
    from hueflight.cli.output import print_notice

    print_notice(message)


def _show_warning(message: Warning | str, *_: object) -> None:
    _say(f"warning: {message}")
