"""hueflight reconstruct"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter

from hueflight.calibration import Calibration
from hueflight.captures import read_capture
from hueflight.cli.app import app
from hueflight.cli.output import progress, show
from hueflight.export.stores import write_zarr
from hueflight.progress import task
from hueflight.reconstruction.quality import Quality
from hueflight.reconstruction.reconstruct import reconstruct as reconstruct_counts


@app.command
def reconstruct(
    capture: Path,
    *,
    calibration: Annotated[Path, Parameter(name=["--calibration", "-c"])],
    out: Annotated[Path, Parameter(name=["--out", "-o"])],
    method: str = "paper",
    range_correction: bool = False,
    pileup_correction: bool = True,
    preview: bool = True,
    overwrite: bool = False,
    json: bool = False,
) -> None:
    """Depth and reflectance in every band from one capture.

    Parameters
    ----------
    capture
        A recording (.mcap) or counts (.npz, .npy, .zarr, .h5, .ptu, .sdt).
    calibration
        What `hueflight calibrate` wrote, of the same instrument.
    out
        The image to write, a folder NAME.zarr.
    method
        How to reconstruct.
    range_correction
        Multiply reflectance by the squared ratio of distances.
    pileup_correction
        Undo the loss of later photons of an exposure.
    preview
        Write a picture NAME.png beside the image.
    overwrite
        Replace an image of that name.
    json
        Print the result as JSON.
    """
    shown = progress(json_wanted=json)
    with task(shown, "reading", 2):
        known = Calibration.load(calibration)
        shown.advance()
        taken = read_capture(capture, known.instrument)
        shown.advance()
    with task(shown, "reconstructing", 1):
        image = reconstruct_counts(
            taken.counts,
            known,
            method=method,
            range_correction=range_correction,
            pileup_correction=pileup_correction,
        )
        shown.advance()
    write_zarr(image, out, overwrite=overwrite)
    result = _summary(image)
    if preview:
        result["preview"] = str(_write_preview(image, known, out.with_suffix(".png")))
    show(f"Image {out}", result, json_wanted=json)


def _summary(image: Any) -> dict[str, Any]:
    depth, quality = image["depth"].values, image["quality"].values
    known = np.isfinite(depth)
    summary: dict[str, Any] = {
        "method": image.attrs["method"],
        "pixels": int(depth.size),
        "pixels_with_depth": int(known.sum()),
    }
    if known.any():
        summary["depth_m_5_50_95_percent"] = [
            float(value) for value in np.percentile(depth[known], [5, 50, 95])
        ]
        summary["median_depth_std_m"] = float(np.nanmedian(image["depth_std"].values))
    for flag in Quality:
        if count := int(((quality & int(flag)) != 0).sum()):
            summary[f"{(flag.name or '').lower()}_pixels"] = count
    return summary


def _write_preview(image: Any, calibration: Calibration, path: Path) -> Path:
    """Depth and the three-band picture side by side."""
    from hueflight.report.preview import draw_preview

    draw_preview(image, calibration.instrument).savefig(path)
    return path
