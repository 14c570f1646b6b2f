"""Logs: readable lines at a terminal, and one JSON object per line for programs."""

from __future__ import annotations

import logging
import sys

import structlog


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
            renderer,
        ],
        logger_factory=structlog.PrintLoggerFactory(sys.stderr),
        cache_logger_on_first_use=False,
    )
    # the web server logs through the standard library; only its warnings matter here
    logging.basicConfig(level=logging.WARNING, stream=sys.stderr, format="%(name)s: %(message)s")
