"""hueflight calibrate"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter

from hueflight.calibration import calibrate as calibrate_captures
from hueflight.cli.app import app
from hueflight.cli.output import progress, show
from hueflight.importers.captures import read_capture
from hueflight.model.instrument import Instrument
from hueflight.progress import task


@app.command
def calibrate(
    reference: Path,
    *,
    distance: Annotated[float, Parameter(name=["--distance", "-d"])],
    out: Annotated[Path, Parameter(name=["--out", "-o"])],
    instrument: str | None = None,
    bands: Path | None = None,
    dark: Path | None = None,
    flat: Path | None = None,
    reflectance: tuple[float, ...] | None = None,
    overwrite: bool = False,
    json: bool = False,
) -> None:
    """Make a calibration from captures of a flat target.

    Parameters
    ----------
    reference
        Capture of the target with all LEDs on: a recording (.mcap) or counts
        (.npz, .npy, .zarr, .h5, .ptu, .sdt).
    distance
        Distance of the target from the camera, metres.
    out
        The calibration to write, a folder NAME.zarr.
    instrument
        Preset or TOML file; needed where the capture does not carry its own.
    bands
        Capture of the same target, one LED at a time.
    dark
        Capture with the LEDs off.
    flat
        Capture under steady light, to measure the width of each code.
    reflectance
        Known reflectance of the target, one number or one for each band; default 1.
    overwrite
        Replace a calibration of that name.
    json
        Print the result as JSON.
    """
    extra = {"bands": bands, "dark": dark, "flat": flat}
    given = {name: path for name, path in extra.items() if path is not None}
    shown = progress(json_wanted=json)
    with task(shown, "reading", 1 + len(given)):
        chosen = None if instrument is None else Instrument.load(instrument)
        main = read_capture(reference, chosen)
        shown.advance()
        others = {}
        for name, path in given.items():
            capture = read_capture(path, main.instrument, by_step=name == "bands")
            others[name] = capture.counts
            shown.advance()
    known = None if reflectance is None else np.array(reflectance)
    if known is not None and known.size == 1:
        known = known[0]
    with task(shown, "calibrating", 1):
        calibration = calibrate_captures(
            main.counts, main.instrument, distance=distance, reflectance=known, **others
        )
        calibration.save(out, overwrite=overwrite)
        shown.advance()
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
        },
        json_wanted=json,
    )
