# SPDX-License-Identifier: Apache-2.0
"""What commands print: progress, messages and tables for people, JSON for scripts."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from hueflight.progress import Progress, Silent


def progress(*, json_wanted: bool = False) -> Progress:
    """Choose how progress is shown.

    Parameters
    ----------
    json_wanted : bool, default False
        Whether the command's result is meant for a script.

    Returns
    -------
    Progress
        Bars for people at a terminal, nothing for scripts and logs.
    """
    if json_wanted or not sys.stderr.isatty():
        return Silent()
    from hueflight.cli.bars import Bars

    return Bars()


def print_error(message: str) -> None:
    """Print a message of failure on standard error.

    Parameters
    ----------
    message : str
        Plain text; square brackets stay as they are.
    """
    text = Text.assemble(("error:", "bold red"), " ", message)
    error_console().print(text, soft_wrap=True)


def print_notice(message: str, *, style: str = "") -> None:
    """Print a message on standard error that is no failure.

    Parameters
    ----------
    message : str
        Plain text; square brackets stay as they are.
    style : str, optional
        Style of the text, in the words of rich.
    """
    error_console().print(Text(message, style), soft_wrap=True)


def error_console() -> Console:
    """Terminal behind standard error.

    Returns
    -------
    Console
        A new console on the present standard error.
    """
    return Console(stderr=True)


def show(title: str, values: Mapping[str, Any], *, json_wanted: bool) -> None:
    """Print a command's result: a table for people or one JSON object for scripts.

    Parameters
    ----------
    title : str
        Title of the table; plain text.
    values : mapping of str to Any
        Names and values of the result.
    json_wanted : bool
        Whether to print JSON.
    """
    if json_wanted:
        print(json.dumps(values, default=str))
        return
    # texts, because paths may hold what rich would take for markup
    table = Table(
        title=Text(title), title_justify="left", title_style="bold", show_header=False, box=None
    )
    table.add_column(style="cyan")
    table.add_column()
    for key, value in values.items():
        table.add_row(Text(key.replace("_", " ")), Text(_readable(value)))
    Console().print(table)


def _readable(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return f"{value:,}"
    if isinstance(value, float):
        return f"{value:,.4g}"
    if value is None or value == {} or value == ():
        return "–"
    if isinstance(value, dict):
        return ", ".join(f"{key} {_readable(item)}" for key, item in value.items())
    if isinstance(value, list | tuple):
        return ", ".join(_readable(item) for item in value)
    return str(value)
