# SPDX-License-Identifier: Apache-2.0
"""Logs: readable lines at a terminal, and one JSON object per line for programs."""

from __future__ import annotations

import contextlib
import logging
import sys
from collections.abc import MutableMapping
from typing import Any, TextIO

import structlog

MAX_TEXT = 2000  #: characters of one value; what clients and devices say may be long
MAX_TRACEBACK = 8000


def configure(*, as_json: bool | None = None) -> None:
    """Set up structured logs on standard error.

    Parameters
    ----------
    as_json : bool, optional
        Write JSON; by default if standard error is not a terminal.
    """
    if as_json is None:
        as_json = not sys.stderr.isatty()
    renderer = structlog.processors.JSONRenderer() if as_json else structlog.dev.ConsoleRenderer()
    structlog.configure(
        processors=[
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="iso", utc=True),
            structlog.processors.StackInfoRenderer(),
            structlog.processors.format_exc_info,
            shorten,
            renderer,
        ],
        logger_factory=structlog.PrintLoggerFactory(_Stream(sys.stderr)),  # pyright: ignore[reportArgumentType]
        cache_logger_on_first_use=False,
    )
    # the web server logs through the standard library; only its warnings matter here
    logging.basicConfig(level=logging.WARNING, stream=sys.stderr, format="%(name)s: %(message)s")


def shorten(_: object, __: str, event: MutableMapping[str, Any]) -> MutableMapping[str, Any]:
    """Bound the length of the texts of a log entry, as a processor of structlog.

    Parameters
    ----------
    event : dict
        The entry.

    Returns
    -------
    dict
        The entry, with long texts cut.
    """
    for name, value in event.items():
        limit = MAX_TRACEBACK if name in ("traceback", "exception") else MAX_TEXT
        if isinstance(value, str) and len(value) > limit:
            event[name] = f"{value[: limit // 2]} … {value[-limit // 2 :]}"
    return event


class _Stream:
    """Standard error, which may be a closed pipe or a full disk: a log must stop nothing."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        with contextlib.suppress(OSError, ValueError):
            return self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        with contextlib.suppress(OSError, ValueError):
            self._stream.flush()

    def isatty(self) -> bool:
        return self._stream.isatty()
