# SPDX-License-Identifier: Apache-2.0
"""What files of other programs are and hold: PTU, SDT, MATLAB, CSV and JSON logs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from hueflight.errors import FileFormatError
from hueflight.files import import_optional
from hueflight.files.inspection import READ, FileDescription, array_text, checked
from hueflight.importers.matlab import matlab_arrays, read_variable
from hueflight.importers.tcspc import RECORD_BYTES
from hueflight.importers.text import HISTOGRAMS, REFERENCE, read_captures, read_table


def describe_mat(path: Path, check: bool) -> FileDescription:
    """Describe a MATLAB file.

    Parameters
    ----------
    path : pathlib.Path
        Path of the file.
    check : bool
        Whether to read every variable.

    Returns
    -------
    FileDescription
        Names, sizes and types of its numeric variables.
    """
    arrays = matlab_arrays(path)

    def read() -> str:
        for name in arrays:
            read_variable(path, name)
        return READ

    facts = {"arrays": {name: array_text(*of) for name, of in arrays.items()}}
    return checked("MATLAB file", facts, check, read)


def describe_csv(path: Path, check: bool) -> FileDescription:
    """Describe a table of numbers; reading it is checking it.

    Parameters
    ----------
    path : pathlib.Path
        Path of the file.
    check : bool
        Not used: a table has no description that could be read alone.

    Returns
    -------
    FileDescription
        Lines, columns, titles and the sum of all numbers.
    """
    del check
    titles, table = read_table(path)
    facts = {
        "lines": table.shape[0],
        "columns": table.shape[1],
        "titles": titles[:8] or None,
        "sum_of_numbers": float(table.sum()),
    }
    return FileDescription(kind="table of numbers", facts=facts, whole=True, evidence=READ)


def describe_json(path: Path, check: bool) -> FileDescription:
    """Describe the log of a time-of-flight module; reading it is checking it.

    Parameters
    ----------
    path : pathlib.Path
        Path of the file.
    check : bool
        Not used: a log has no description that could be read alone.

    Returns
    -------
    FileDescription
        Captures, zones and bins.

    Raises
    ------
    FileFormatError
        If it is no such log.
    """
    del check
    captures = read_captures(path)
    name = next((name for name in HISTOGRAMS if name in captures[0]), None)
    if name is None:
        raise FileFormatError(
            f"{str(path)!r} is JSON but no log of captures: none of the entries "
            f"{', '.join(HISTOGRAMS)} is in it"
        )
    facts: dict[str, Any] = {"captures": len(captures)}
    shapes = {_shape(capture.get(name)) for capture in captures}
    facts["zones_and_bins"] = " or ".join(" × ".join(map(str, shape)) for shape in sorted(shapes))
    facts["entry"] = name
    facts["reference"] = REFERENCE in captures[0]
    whole = len(shapes) == 1 and () not in shapes
    evidence = READ if whole else f"not every capture has the same lists of numbers in {name!r}"
    return FileDescription(
        kind="log of a time-of-flight module", facts=facts, whole=whole, evidence=evidence
    )


def _shape(lists: object) -> tuple[int, ...]:
    """Shape of lists of numbers; none if they are no such lists."""
    try:
        return np.array(lists, dtype=np.float64).shape
    except (TypeError, ValueError):
        return ()


def describe_ptu(path: Path, check: bool) -> FileDescription:
    """Describe a PicoQuant PTU file.

    Parameters
    ----------
    path : pathlib.Path
        Path of the file.
    check : bool
        Whether to read all of it.

    Returns
    -------
    FileDescription
        Its content.
    """
    ptufile = import_optional("ptufile", extra="import")
    with ptufile.PtuFile(path) as ptu:
        present = max(0, (path.stat().st_size - ptu.record_offset) // RECORD_BYTES)
        announced = int(ptu.number_records)
        facts: dict[str, Any] = {
            "record_type": ptu.record_type.name,
            "mode": "T3" if ptu.is_t3 else "T2 (times of events; points are read, images are not)",
            "image": bool(ptu.is_image),
            "records": announced,
            "bin_width_ns": float(ptu.tcspc_resolution) * 1e9,
            "period_ns": float(ptu.global_resolution) * 1e9,
            "recorded": None if ptu.datetime is None else str(ptu.datetime),
        }

        def read() -> str:
            if present < announced:
                raise FileFormatError(
                    f"it was cut short: it holds {present} of {announced} records"
                )
            facts.update(
                channels_with_photons=[int(number) for number in ptu.active_channels],
                photons=int(ptu.number_photons),
                shape=dict(zip(ptu.dims, map(int, ptu.shape), strict=True)),
            )
            return READ

        # missing records show without reading the others
        return checked("PicoQuant PTU file", facts, check or present < announced, read)


def describe_sdt(path: Path, check: bool) -> FileDescription:
    """Describe a Becker & Hickl SDT file.

    Parameters
    ----------
    path : pathlib.Path
        Path of the file.
    check : bool
        Whether to read all of it.

    Returns
    -------
    FileDescription
        Its content.
    """
    del check  # the library has no way to read less than everything
    sdtfile = import_optional("sdtfile", extra="import")
    with path.open("rb") as file:
        sdt = sdtfile.SdtFile(file)
        blocks, times = list(sdt.data), list(sdt.times)
    widths = [float(time[1] - time[0]) * 1e9 for time in times if len(time) > 1]
    facts = {
        "blocks": {
            str(number): array_text(block.shape, block.dtype) for number, block in enumerate(blocks)
        },
        "bin_width_ns": widths[0] if widths else None,
    }
    return FileDescription(kind="Becker & Hickl SDT file", facts=facts, whole=True, evidence=READ)
