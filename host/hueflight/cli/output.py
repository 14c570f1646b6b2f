"""What commands print: progress and tables for people, JSON for scripts."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn
from rich.progress import Progress as Bar
from rich.table import Table

from hueflight.progress import Progress, Silent


class Bars:
    """Progress bars on the terminal's error stream, one below the other."""

    def __init__(self) -> None:
        self._bar = Bar(
            TextColumn("{task.description:<14}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            console=Console(stderr=True),
        )
        self._open: list[Any] = []

    def start(self, task: str, total: float | None) -> None:
        """Show a bar for a task that begins."""
        if not self._open:
            self._bar.start()
        self._open.append(self._bar.add_task(task, total=total))

    def advance(self, steps: float = 1) -> None:
        """Move the bar of the innermost task."""
        self._bar.advance(self._open[-1], steps)

    def finish(self) -> None:
        """Leave the bar of the innermost task as it is."""
        self._bar.stop_task(self._open.pop())
        if not self._open:
            self._bar.stop()


def progress(*, json_wanted: bool = False) -> Progress:
    """Bars for people at a terminal; nothing for scripts and logs."""
    return Silent() if json_wanted or not sys.stderr.isatty() else Bars()


def show(title: str, values: Mapping[str, Any], *, json_wanted: bool) -> None:
    """Values as a table for people or as one JSON object for scripts."""
    if json_wanted:
        print(json.dumps(values, default=str))
        return
    table = Table(
        title=title, title_justify="left", title_style="bold", show_header=False, box=None
    )
    table.add_column(style="cyan")
    table.add_column()
    for key, value in values.items():
        table.add_row(key.replace("_", " "), _readable(value))
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
