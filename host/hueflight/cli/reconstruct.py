"""The command `hueflight reconstruct`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from hueflight.batch import BatchReport, reconstruct_file, reconstruct_many
from hueflight.cli.choices import METHOD_NAMES
from hueflight.cli.exit_codes import FAILED
from hueflight.cli.output import progress, show
from hueflight.errors import HueflightError


def reconstruct(
    *captures: Annotated[
        Path,
        Parameter(
            help="Recordings (.mcap) or counts (.npz, .npy, .zarr, .h5, .ptu, .sdt); at least one."
        ),
    ],
    calibration: Annotated[Path, Parameter(name=["--calibration", "-c"])],
    out: Annotated[Path, Parameter(name=["--out", "-o"])],
    method: Annotated[
        str | None,
        Parameter(
            help=f"Reconstruction method: {METHOD_NAMES}. By default joint, the most accurate."
        ),
    ] = None,
    range_correction: bool = False,
    pileup_correction: bool = True,
    workers: int | None = None,
    scheduler: str | None = None,
    preview: bool = True,
    overwrite: bool = False,
    json: bool = False,
) -> int:
    """Reconstruct depth and reflectance in every band from one or many captures.

    One capture gives one image, many give a folder of images. Captures whose images are in the
    folder already are not reconstructed again. A capture that fails does not stop the others; the
    exit code is then 1.

    Parameters
    ----------
    *captures : Path
        Recordings (.mcap) or counts (.npz, .npy, .zarr, .h5, .ptu, .sdt).
    calibration : Path
        Calibration of the instrument that made the captures, as `hueflight calibrate` writes it.
    out : Path
        NAME.zarr for the image of one capture, or any other name for a folder that receives one
        image for each capture.
    method : str, optional
        Reconstruction method.
    range_correction : bool, default False
        Multiply reflectance by the squared ratio of the distances of object and calibration
        target.
    pileup_correction : bool, default True
        Correct for photons that an exposure missed because an earlier one had been detected.
    workers : int, optional
        Number of processes that share the captures of a folder. By default one for each
        processor core.
    scheduler : str, optional
        Address of a Dask scheduler, such as tcp://head-node:8786, that reconstructs the captures
        of a folder instead of local processes.
    preview : bool, default True
        Write a picture NAME.png beside the image of one capture.
    overwrite : bool, default False
        Replace an existing image and picture; in a folder, also images that were made from
        another capture of the same name.
    json : bool, default False
        Print one JSON object instead of a table.

    Returns
    -------
    int
        Exit code.
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
    if out.suffix.lower() != ".zarr":
        report = reconstruct_many(
            captures, out, calibration=calibration, workers=workers, scheduler=scheduler,
            options=options, overwrite=overwrite, progress=shown,
        )  # fmt: skip
        show(f"Batch {out}", _batch_summary(report, everything=json), json_wanted=json)
        return FAILED if report.failed else 0
    capture, *others = captures
    if others:
        raise HueflightError(
            f"--out {out} names one image, but there are {len(captures)} captures: name a folder"
        )
    result = reconstruct_file(
        capture, out, calibration=calibration, options=options, preview=preview,
        overwrite=overwrite, progress=shown,
    )  # fmt: skip
    show(f"Image {out}", result.summary(), json_wanted=json)
    return 0


def _batch_summary(report: BatchReport, *, everything: bool) -> dict[str, Any]:
    """For people how many there are and which failed; scripts get all outcomes."""
    summary = report.to_dict()
    if not everything:
        del summary["outcomes"]
        for number, outcome in enumerate(report.failed, 1):
            summary[f"failure_{number}"] = f"{outcome.capture}: {outcome.error}"
    return summary
