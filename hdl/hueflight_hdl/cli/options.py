# SPDX-License-Identifier: Apache-2.0
"""Options that several subcommands share."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ..boards.settings import parse_settings, read_design_file
from ..boards.target import Options


def read_options(
    *,
    pins: Path | None = None,
    lanes: int | None = None,
    words: Sequence[str] | None = None,
    design_file: Path | None = None,
) -> Options:
    """Return the choices of the user.

    Parameters
    ----------
    pins : Path, optional
        See `Options`.
    lanes : int, optional
        See `Options`.
    words : sequence of str, optional
        Settings as ``NAME=VALUE``; they have precedence over those of the file.
    design_file : Path, optional
        TOML file of settings.

    Returns
    -------
    Options
        The choices; names and values of settings are checked where the design is known.

    Raises
    ------
    TargetError
        If the file or a word cannot be read.
    """
    settings = {} if design_file is None else read_design_file(design_file)
    return Options(pins=pins, lanes=lanes, settings={**settings, **parse_settings(words or ())})
