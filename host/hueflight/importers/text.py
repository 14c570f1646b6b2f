# SPDX-License-Identifier: Apache-2.0
"""Histograms as text: tables (CSV), and the logs of time-of-flight modules (JSON)."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hueflight.errors import FileFormatError
from hueflight.importers.options import ReadOptions, require_instrument
from hueflight.model.instrument import Instrument
from hueflight.recognition import what_is

#: entries of a log that hold one histogram for each zone
HISTOGRAMS = ("hists", "histograms", "histogram", "cnh", "bins")
REFERENCE = "reference_hist"  #: entry with the pulse that the module itself emits
SUM = "sum"  #: data set that is the sum of all captures


def read_csv(
    path: Path, instrument: Instrument | None, options: ReadOptions, /
) -> tuple[NDArray[Any], Instrument]:
    """Read histograms from a table of text, with one line for each pixel, row by row.

    Columns are time bins, separated by commas, semicolons, tabs or spaces. Lines that begin with
    ``#`` and one line of titles are skipped. Where the titles begin with ``row`` and ``col``, these
    columns say which pixel a line belongs to. The histogram of a single pixel may also stand in one
    column, or as a column of times and one of counts.

    Parameters
    ----------
    path : pathlib.Path
        Path of the file.
    instrument : Instrument
        Instrument that made the counts.
    options : ReadOptions
        Nothing in them applies.

    Returns
    -------
    counts : numpy.ndarray, shape (row, col, code)
        The counts.
    instrument : Instrument
        The instrument.

    Raises
    ------
    FileFormatError
        If the file is no table of numbers, or has another number of pixels.
    InstrumentError
        If the instrument is missing.
    """
    options.refuse_all_but(path=path)
    given = require_instrument(instrument, path)
    titles, table = read_table(path)
    rows, cols = given.image_shape
    if titles[:2] == ["row", "col"]:
        counts = np.zeros((rows, cols, table.shape[1] - 2))
        where = table[:, :2].astype(int)
        if (where < 0).any() or (where >= [rows, cols]).any():
            raise FileFormatError(
                f"{str(path)!r}: pixels are numbered up to {where.max(axis=0).tolist()}, but the "
                f"instrument has {rows} rows and {cols} columns, counted from 0"
            )
        if len(np.unique(where, axis=0)) < len(where):
            raise FileFormatError(f"{str(path)!r} has more than one line for a pixel")
        counts[where[:, 0], where[:, 1]] = table[:, 2:]
        return _whole(counts), given
    if rows * cols == 1 and table.shape[0] > 1 and table.shape[1] <= 2:
        return _whole(table[:, -1].reshape(1, 1, -1)), given
    return _pixels(table, given, path), given


def read_json_log(
    path: Path, instrument: Instrument | None, options: ReadOptions, /
) -> tuple[NDArray[Any], Instrument]:
    """Read histograms from the JSON log of a time-of-flight module, such as TMF8820 or VL53L8.

    The file holds one capture, a list of captures, or one capture in each line. A capture is an
    object whose entry ``hists`` (or ``histograms``, ``cnh``, ``bins``) has one list of counts for
    each zone, row by row, and, where the module records its own pulse, ``reference_hist``.

    Parameters
    ----------
    path : pathlib.Path
        Path of the file.
    instrument : Instrument
        Instrument that made the counts.
    options : ReadOptions
        `dataset`: the number of a capture from 0, or ``sum`` for all together; with ``:reference``
        after it, the module's own pulse, the same for every zone.

    Returns
    -------
    counts : numpy.ndarray, shape (row, col, code)
        The counts.
    instrument : Instrument
        The instrument.

    Raises
    ------
    FileFormatError
        If the file is no such log, has no such capture, or has another number of zones.
    InstrumentError
        If the instrument is missing.
    """
    options.refuse_all_but("dataset", path=path)
    given = require_instrument(instrument, path)
    captures = read_captures(path)
    wanted, _, part = (options.dataset or "").partition(":")
    if not wanted and len(captures) > 1:
        raise FileFormatError(
            f"{str(path)!r} holds {len(captures)} captures: say which with dataset (--dataset), "
            f"from 0 to {len(captures) - 1}, or {SUM!r} for all together"
        )
    known = wanted in ("", SUM) or (wanted.isdecimal() and int(wanted) < len(captures))
    if not known or part not in ("", "reference"):
        raise FileFormatError(
            f"{str(path)!r}: dataset = {options.dataset!r}: give a number from 0 to "
            f"{len(captures) - 1}, or {SUM!r}; with ':reference' after it for the module's pulse"
        )
    chosen = captures if wanted in ("", SUM) else [captures[int(wanted)]]
    lists = [_histograms(capture, part, path) for capture in chosen]
    try:
        total = np.sum([np.array(zones, np.float64) for zones in lists], axis=0)
    except (TypeError, ValueError):
        raise FileFormatError(f"{str(path)!r}: its histograms are not lists of numbers") from None
    if part:
        total = np.tile(total.reshape(1, -1), (int(np.prod(given.image_shape)), 1))
    return _pixels(np.atleast_2d(total), given, path), given


def read_table(path: Path, /) -> tuple[list[str], NDArray[np.float64]]:
    """Read a table of numbers.

    Parameters
    ----------
    path : pathlib.Path
        Path of the file.

    Returns
    -------
    titles : list of str
        Titles in lower case; none if the first line holds numbers.
    table : numpy.ndarray, shape (line, column)
        The numbers.

    Raises
    ------
    FileFormatError
        If the file is no table of numbers.
    """
    try:
        text = path.read_text("utf-8-sig")
    except UnicodeDecodeError as error:
        raise FileFormatError(f"{str(path)!r} is {what_is(path)}, not text: {error}") from None
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    if not lines:
        raise FileFormatError(f"{str(path)!r} has no lines with numbers")
    mark = next((mark for mark in ";\t," if mark in lines[0]), None)
    cells = [line.split() for line in lines]
    if mark is not None:
        cells = list(csv.reader(lines, delimiter=mark))
    titles: list[str] = []
    try:
        [float(cell) for cell in cells[0]]
    except ValueError:
        titles = [cell.strip().lower() for cell in cells.pop(0)]
    widths = {len(line) for line in cells}
    if len(widths) != 1:
        raise FileFormatError(
            f"{str(path)!r}: lines have from {min(widths, default=0)} to "
            f"{max(widths, default=0)} columns; each needs one column for each time bin"
        )
    try:
        return titles, np.array(cells, dtype=np.float64)
    except ValueError:
        first = next(cell for line in cells for cell in line if not _is_number(cell))
        raise FileFormatError(
            f"{str(path)!r} holds more than numbers: {first!r} stands among them"
        ) from None


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def read_captures(path: Path, /) -> list[dict[str, Any]]:
    """Read the captures of a log.

    Parameters
    ----------
    path : pathlib.Path
        Path of the file.

    Returns
    -------
    list of dict
        Entries of each capture.

    Raises
    ------
    FileFormatError
        If the file is not JSON, or there is no capture in it.
    """
    try:
        text = path.read_text("utf-8-sig")
        try:
            found = json.loads(text)
        except json.JSONDecodeError:
            found = [json.loads(line) for line in text.splitlines() if line.strip()]
    except ValueError as error:
        raise FileFormatError(f"{str(path)!r} is not JSON: {error}") from None
    captures = found if isinstance(found, list) else [found]
    if not captures or not all(isinstance(capture, dict) for capture in captures):
        raise FileFormatError(
            f"{str(path)!r} is no log of captures, which are objects with {HISTOGRAMS[0]!r}"
        )
    return captures


def _histograms(capture: dict[str, Any], part: str, path: Path) -> Any:
    names = (REFERENCE,) if part else HISTOGRAMS
    for name in names:
        if name in capture:
            return capture[name]
    raise FileFormatError(
        f"{str(path)!r}: a capture has no {' or '.join(names)}; it has {', '.join(capture)}"
    )


def _pixels(table: NDArray[np.float64], instrument: Instrument, path: Path) -> NDArray[Any]:
    """Counts (row, col, code) of lines that stand for pixels, row by row."""
    rows, cols = instrument.image_shape
    if table.ndim != 2 or table.shape[0] != rows * cols:
        raise FileFormatError(
            f"{str(path)!r} has histograms of shape {table.shape}; the instrument's {rows} rows "
            f"and {cols} columns need {rows * cols} of them, one for each pixel"
        )
    return _whole(table.reshape(rows, cols, -1))


def _whole(counts: NDArray[np.float64]) -> NDArray[Any]:
    """Counts as whole numbers where they are."""
    limit = np.iinfo(np.uint32).max
    whole = (counts >= 0).all() and (counts <= limit).all() and (counts == np.rint(counts)).all()
    return counts.astype(np.uint32) if whole else counts
