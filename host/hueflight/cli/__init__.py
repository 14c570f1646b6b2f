# SPDX-License-Identifier: Apache-2.0
"""The command `hueflight`: one module a subcommand, errors as sentences, never tracebacks."""

from __future__ import annotations

from collections.abc import Sequence

from hueflight.numerical_threads import use_one_thread


def main(words: Sequence[str] | None = None) -> None:
    """Run a command in a process of its own; see `hueflight.cli.app.main`.

    Parameters
    ----------
    words : sequence of str, optional
        What follows the program's name; by default the arguments of this process.

    Raises
    ------
    SystemExit
        Always, with one of the exit codes that the help lists.
    """
    use_one_thread()
    from hueflight.cli import app  # loads NumPy

    app.main(words)


__all__ = ["main"]
