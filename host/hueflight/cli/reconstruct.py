"""hueflight reconstruct"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import xarray as xr
from cyclopts import Parameter

from hueflight.batch import BatchReport, reconstruct_many
from hueflight.calibration import Calibration
from hueflight.cli.app import EXIT_FAILED, app
from hueflight.cli.output import progress, show
from hueflight.errors import HueflightError
from hueflight.export import describe, write_zarr
from hueflight.importers.captures import read_capture
from hueflight.progress import Progress, task
from hueflight.reconstruction.quality import Quality
from hueflight.reconstruction.reconstruct import reconstruct as reconstruct_counts


@app.command
def reconstruct(
    *captures: Path,
    calibration: Annotated[Path, Parameter(name=["--calibration", "-c"])],
    out: Annotated[Path, Parameter(name=["--out", "-o"])],
    method: str | None = None,
    range_correction: bool = False,
    pileup_correction: bool = True,
    workers: int | None = None,
    scheduler: str | None = None,
    preview: bool = True,
    overwrite: bool = False,
    json: bool = False,
) -> int:
    """Depth and reflectance in every band: one capture into an image, or many into a folder.

    Captures of a batch that are done are not done again; one that fails does not stop the
    others, and the exit code is then 1.

    Parameters
    ----------
    captures
        Recordings (.mcap) or counts (.npz, .npy, .zarr, .h5, .ptu, .sdt).
    calibration
        What `hueflight calibrate` wrote, of the same instrument.
    out
        NAME.zarr for the image of one capture, else a folder for one store per capture.
    method
        How to reconstruct; by default the most accurate.
    range_correction
        Multiply reflectance by the squared ratio of distances.
    pileup_correction
        Undo the loss of later photons of an exposure.
    workers
        Processes for a batch; by default one for each core.
    scheduler
        Address of a Dask scheduler that does the batch.
    preview
        Write a picture NAME.png beside the image of one capture.
    overwrite
        Replace an image of that name.
    json
        Print the result as JSON.
    """
    if not captures:
        raise HueflightError("no captures: name at least one recording or file of counts")
    options: dict[str, Any] = {
        "range_correction": range_correction,
        "pileup_correction": pileup_correction,
    }
    if method is not None:
        options["method"] = method
    shown = progress(json_wanted=json)
    if out.suffix != ".zarr":
        report = reconstruct_many(
            captures, out, calibration=calibration, workers=workers, scheduler=scheduler,
            options=options, progress=shown,
        )  # fmt: skip
        show(f"Batch {out}", _batch_summary(report, everything=json), json_wanted=json)
        return EXIT_FAILED if report.failed else 0
    capture, *others = captures
    if others:
        raise HueflightError(
            f"--out {out} names one image, but there are {len(captures)} captures: name a folder"
        )
    image, known, lost = _one(capture, calibration, options, shown)
    write_zarr(image, out, overwrite=overwrite)
    result = _summary(image) | {f"lost_{name}": count for name, count in lost.items()}
    if preview:
        result["preview"] = str(_write_preview(image, known, out.with_suffix(".png")))
    show(f"Image {out}", result, json_wanted=json)
    return 0


def _one(
    path: Path, calibration: Path, options: dict[str, Any], shown: Progress
) -> tuple[xr.Dataset, Calibration, Mapping[str, int]]:
    with task(shown, "reading", 2):
        known = Calibration.load(calibration)
        shown.advance()
        taken = read_capture(path, known.instrument)
        shown.advance()
    with task(shown, "reconstructing", 1):
        image = reconstruct_counts(taken.counts, known, **options)
        shown.advance()
    return describe_capture(image, known, path, taken.losses), known, taken.losses


def describe_capture(
    image: xr.Dataset, known: Calibration, path: Path, lost: Mapping[str, int]
) -> xr.Dataset:
    """The image with its origin; what the capture had lost goes with it."""
    said = ", ".join(f"{name} {count}" for name, count in lost.items())
    return describe(image, known, capture=path.name, capture_losses=said or "none")


def _batch_summary(report: BatchReport, *, everything: bool) -> dict[str, Any]:
    """For people only how many, and what failed; scripts get all outcomes."""
    summary = report.to_dict()
    if not everything:
        del summary["outcomes"]
        for number, outcome in enumerate(report.failed, 1):
            summary[f"failure_{number}"] = f"{outcome.capture}: {outcome.error}"
    return summary


def _summary(image: xr.Dataset) -> dict[str, Any]:
    depth, quality = image["depth"].values, image["quality"].values
    known = np.isfinite(depth)
    summary: dict[str, Any] = {
        "method": image.attrs["method"],
        "pixels": int(depth.size),
        "pixels_with_depth": int(known.sum()),
    }
    if known.any():
        for percent in (5, 50, 95):
            summary[f"depth_{percent}_percent_m"] = float(np.percentile(depth[known], percent))
        summary["median_depth_std_m"] = float(np.nanmedian(image["depth_std"].values))
    for flag in Quality:
        if count := int(((quality & int(flag)) != 0).sum()):
            summary[f"{(flag.name or '').lower()}_pixels"] = count
    return summary


def _write_preview(image: xr.Dataset, calibration: Calibration, path: Path) -> Path:
    """Depth and the three-band picture side by side."""
    try:
        from hueflight.report.preview import draw_preview
    except ImportError as error:
        raise HueflightError(
            f"the image is written, but its picture needs {error.name}: "
            "pip install 'hueflight[report]', or say --no-preview"
        ) from None
    draw_preview(image, calibration.instrument).savefig(path)
    return path
