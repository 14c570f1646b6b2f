# SPDX-License-Identifier: Apache-2.0
"""The command `hueflight calibrate`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter

from hueflight.calibration import calibrate as calibrate_captures
from hueflight.cli.choices import PRESETS
from hueflight.cli.options import WHOLE
from hueflight.cli.output import progress, show
from hueflight.cli.units import require_meters, require_share
from hueflight.errors import CalibrationError, HueflightError
from hueflight.files import refuse_existing
from hueflight.importers.captures import Capture, read_capture
from hueflight.importers.options import AXES
from hueflight.model.instrument import Instrument
from hueflight.progress import task


def calibrate(
    reference: Path,
    *,
    distance: Annotated[float, Parameter(name=["--distance", "-d"])],
    out: Annotated[Path, Parameter(name=["--out", "-o"])],
    instrument: Annotated[
        str | None,
        Parameter(
            help=f"Instrument of the captures: a preset ({PRESETS}) or the path of a TOML file. "
            "Needed only where the reference capture does not name its instrument."
        ),
    ] = None,
    bands: Path | None = None,
    dark: Path | None = None,
    flat: Path | None = None,
    reflectance: Annotated[tuple[float, ...] | None, Parameter(negative_iterable=())] = None,
    frames: float | None = None,
    dataset: str | None = None,
    axes: str = AXES,
    channel: Annotated[int | None, WHOLE] = None,
    ignore_notes: Annotated[bool, Parameter(negative=())] = False,
    overwrite: bool = False,
    json: bool = False,
) -> None:
    """Make a calibration from captures of a flat target.

    Parameters
    ----------
    reference : Path
        Capture of the target with all LEDs on: a recording (.mcap) or counts (.npz, .npy, .zarr,
        .h5, .mat, .csv, .json, .ptu, .sdt).
    distance : float
        Distance of the target from the camera, in metres.
    out : Path
        Calibration to write: a folder NAME.zarr.
    instrument : str, optional
        Instrument of the captures: a preset or the path of a TOML file. Needed only where the
        reference capture does not name its instrument.
    bands : Path, optional
        Capture of the same target with one LED on at a time. Without it, the waveforms of the LEDs
        are separated in the reference, which is less accurate where they overlap.
    dark : Path, optional
        Capture with the LEDs off. Without it, hot pixels are found in the reference only.
    flat : Path, optional
        Capture under steady light, from which the width of each code is measured. Without it,
        all codes are taken to have the nominal width.
    reflectance : tuple of float, optional
        Known reflectance of the target: one number, or one for each band, with the option
        repeated before each (1 = white). Without it, the target counts as 1 in every band.
    frames : float, optional
        Number of exposures behind the reference. By default it is known only for a sensor that
        reports its empty exposures, as the sum of the counts of a pixel.
    dataset : str, optional
        Name of the array in files of counts that hold several arrays, or number of the data block
        in .sdt files. It applies to every capture of this command.
    axes : str, default "row,col,code"
        Names of the axes of the array in files of counts, in its order: row, col and code; frame
        in place of code for raw codes; step in a capture of one LED at a time; a minus sign for
        an axis of length one. The names apply to every capture of this command.
    channel : int, optional
        Detection channel of .ptu and .sdt files, counted from 0. By default the only one with
        photons.
    ignore_notes : bool, default False
        Calibrate although a recording states another kind of capture, or another distance, than the
        options of this command do.
    overwrite : bool, default False
        Replace an existing calibration of that name.
    json : bool, default False
        Print one JSON object instead of a table.
    """
    if out.suffix.lower() != ".zarr":
        raise HueflightError(f"--out {out}: a calibration is written as NAME.zarr")
    require_share(reflectance)
    refuse_existing(out, overwrite=overwrite)
    options: dict[str, Any] = {"dataset": dataset, "axes": axes, "channel": channel}
    extra = {"bands": bands, "dark": dark, "flat": flat}
    given = {name: path for name, path in extra.items() if path is not None}
    shown = progress(json_wanted=json)
    with task(shown, "reading", 1 + len(given)):
        chosen = None if instrument is None else Instrument.load(instrument)
        main = read_capture(reference, chosen, **options)
        require_meters(distance, main.instrument)
        if not ignore_notes:
            _require_agreement(reference, main, "reference", distance)
        shown.advance()
        others = {}
        for name, path in given.items():
            by_step = name == "bands"
            capture = read_capture(path, main.instrument, by_step=by_step, **options)
            if not ignore_notes:
                _require_agreement(path, capture, name, distance if by_step else None)
            others[name] = capture.counts
            shown.advance()
    known = None if reflectance is None else np.array(reflectance)
    if known is not None and known.size == 1:
        known = known[0]
    with task(shown, "calibrating", 1):
        calibration = calibrate_captures(
            main.counts, main.instrument, distance=distance, reflectance=known, frames=frames,
            **others,
        )  # fmt: skip
        calibration.save(out, overwrite=overwrite)
        shown.advance()
    unknown = {"exposures": "unknown: pile-up is not corrected; state --frames"}
    show(
        f"Calibration {out}",
        {
            "instrument": main.instrument.name,
            "distance_m": distance,
            "pixels": int(calibration.usable.size),
            "hot_pixels": int(calibration.hot.sum()),
            "dead_pixels": int(calibration.dead.sum()),
            "windows": len(calibration.windows),
            "measured_bin_widths": flat is not None,
            "one_led_templates": bands is not None,
            **(unknown if calibration.frames is None else {}),
        },
        json_wanted=json,
    )


def _require_agreement(path: Path, capture: Capture, kind: str, distance: float | None) -> None:
    """Refuse a recording that says of itself what contradicts the options."""
    if found := capture.contradictions(kind=kind, distance=distance):
        raise CalibrationError(
            f"{path} is no {kind} capture as the options have it: {' and '.join(found)}. Name the "
            "right recording and its distance, or give --ignore-notes if the recording's notes "
            "are wrong"
        )
