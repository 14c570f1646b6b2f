# SPDX-License-Identifier: Apache-2.0
"""The command `hueflight check`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from hueflight.calibration import Calibration, check_calibration
from hueflight.cli.exit_codes import NO_LONGER_HOLDS
from hueflight.cli.options import WHOLE
from hueflight.cli.output import show
from hueflight.cli.units import require_meters
from hueflight.files import refuse_existing
from hueflight.importers.captures import read_capture
from hueflight.importers.options import AXES


def check(
    calibration: Path,
    reference: Path,
    *,
    distance: Annotated[float | None, Parameter(name=["--distance", "-d"])] = None,
    page: Path | None = None,
    frames: float | None = None,
    dataset: str | None = None,
    axes: str = AXES,
    channel: Annotated[int | None, WHOLE] = None,
    overwrite: bool = False,
    json: bool = False,
) -> int:
    """Check with a new reference capture whether a calibration still holds.

    Delay, brightness and pulse width of each band, delay and brightness of each pixel, and new hot
    and dead pixels are compared. The exit code is 4 if the calibration no longer holds.

    Parameters
    ----------
    calibration : Path
        Calibration (.zarr) that calibrate wrote.
    reference : Path
        Recording (.mcap) or counts of the target of the calibration with all LEDs on.
    distance : float, optional
        Distance of the target now in metres. By default that of the calibration.
    page : Path, optional
        Write a self-contained HTML page with pictures under this name.
    frames : float, optional
        Number of exposures behind the capture. By default it is known only for a sensor that
        reports its empty exposures, as the sum of the counts of a pixel.
    dataset : str, optional
        Name of the array in files of counts that hold several arrays, or number of the data block
        in .sdt files.
    axes : str, default "row,col,code"
        Names of the axes of the array in files of counts, in its order.
    channel : int, optional
        Detection channel of .ptu and .sdt files, counted from 0. By default the only one with
        photons.
    overwrite : bool, default False
        Replace an existing page of that name.
    json : bool, default False
        Print one JSON object instead of a table.

    Returns
    -------
    int
        Exit code.
    """
    if page is not None:
        refuse_existing(page, overwrite=overwrite)
    known = Calibration.load(calibration)
    require_meters(distance, known.instrument)
    capture = read_capture(reference, known.instrument, dataset=dataset, axes=axes, channel=channel)
    known.require(capture.instrument)
    found = check_calibration(known, capture.counts, distance=distance, frames=frames)
    if page is not None:
        from hueflight.report.check_page import write_check_page  # loads matplotlib

        write_check_page(found, known, page)
    facts = found.as_dict()
    if not json:
        facts = {"verdict": "holds" if found.holds else "no longer holds", **_readable(facts)}
    show(f"Check of {calibration}", facts, json_wanted=json)
    return 0 if found.holds else NO_LONGER_HOLDS


def _readable(facts: dict[str, object]) -> dict[str, object]:
    """The facts for a table: findings as lines, bands and their numbers on the page or in JSON."""
    left_out = ("holds", "delay_std_ns", "brightness_std", "width_std", "common_delay_std_ns")
    shown = {name: value for name, value in facts.items() if name not in left_out}
    findings = shown.pop("findings")
    lines = findings if isinstance(findings, list) else [findings]
    shown["findings"] = "\n".join(map(str, lines)) or "none"
    return shown
