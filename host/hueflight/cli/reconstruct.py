# SPDX-License-Identifier: Apache-2.0
"""The command `hueflight reconstruct`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from hueflight.batch import BatchReport, reconstruct_file, reconstruct_many
from hueflight.cli.choices import METHOD_NAMES
from hueflight.cli.exit_codes import FAILED
from hueflight.cli.options import WHOLE, band_list, region_slices, require_threads
from hueflight.cli.output import print_notice, progress, show
from hueflight.errors import HueflightError, MissingPackageError
from hueflight.export import FORMATS
from hueflight.files import import_optional
from hueflight.importers.options import AXES, ReadOptions

IMAGE_FORMATS = ("zarr", "netcdf")  #: formats that hold a complete image
IMAGE_ENDINGS = tuple(ending for name in IMAGE_FORMATS for ending in FORMATS[name].endings)


def reconstruct(
    *captures: Annotated[
        Path,
        Parameter(
            help="Recordings (.mcap) or counts (.npz, .npy, .zarr, .h5, .mat, .csv, .json, .ptu, "
            ".sdt); at least one."
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
    range_correction: bool | None = None,
    pileup_correction: bool = True,
    background: Literal["flat", "sloped"] = "flat",
    check: Annotated[bool, Parameter(negative=())] = False,
    correct_drift: Annotated[bool, Parameter(negative=())] = False,
    depth_range: Annotated[tuple[float, float] | None, Parameter(negative_iterable=())] = None,
    frames: float | None = None,
    bands: str | None = None,
    region: str | None = None,
    mixed: bool | None = None,
    second_returns: bool | None = None,
    threads: Annotated[int, WHOLE] = 1,
    dataset: str | None = None,
    axes: str = AXES,
    channel: Annotated[int | None, WHOLE] = None,
    workers: Annotated[int | None, WHOLE] = None,
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
        Recordings (.mcap) or counts (.npz, .npy, .zarr, .h5, .mat, .csv, .json, .ptu,
        .sdt).
    calibration : Path
        Calibration of the instrument that made the captures, as `hueflight calibrate` writes it.
    out : Path
        NAME.zarr or NAME.nc (NetCDF) for the image of one capture, or the name of a folder that
        receives one image NAME.zarr for each capture.
    method : str, optional
        Reconstruction method.
    range_correction : bool, optional
        Multiply reflectance by the squared ratio of the distances of object and calibration
        target, so that it does not depend on the distance. By default wherever the distance of the
        calibration target is known; --no-range-correction gives the signal as it arrives.
    pileup_correction : bool, default True
        Correct for photons that an exposure missed because an earlier one had been detected.
    background : str, default flat
        How the background is distributed over the time bins: flat, or sloped to find a slope or a
        slow decay from all pixels and fit with it.
    check : bool, default False
        Check the whole picture for departures from its calibration (delays and widths of the LEDs,
        slope of the background, tails and multipath, lens flare, bin widths), print those that are
        found and state them in the image. Deviations are widened by what tails and flare leave.
    correct_drift : bool, default False
        Check the picture, then reconstruct it with delays and widths of the LEDs and the shape of
        the background as the picture shows them. The calibration on disk stays as it is.
    depth_range : tuple of float, optional
        Nearest and farthest depth to search, in metres: two numbers, such as 0.3 1.5. By default
        half the spacing of the pulses about the distance of the calibration target.
    frames : float, optional
        Number of exposures behind each capture. By default the sum of the counts of a pixel if the
        sensor reports its empty exposures; otherwise as many as the reference had, which the
        summary then says.
    bands : str, optional
        Names, numbers (from 0) or wavelengths of the bands to keep in the image, separated by
        commas, such as red,532nm. By default all bands.
    region : str, optional
        Rows and columns to reconstruct, from 0 and without the last ones, such as 10:20,30:40 or
        :,30:40. Other pixels have no result and are flagged as skipped. By default all pixels.
    mixed : bool, optional
        Find the pixels at edges that see two surfaces, flag them, and state both depths. By default
        wherever the method is joint and the instrument has a lens.
    second_returns : bool, optional
        Fit two surfaces to pixels whose counts show more than one, as behind glass, and state both
        depths. By default wherever the method is joint, except for what departures from the
        calibration explain that the whole picture shows.
    threads : int, default 1
        Number of threads that share the pixels of an image; with several captures, each process
        has as many.
    dataset : str, optional
        Name of the array in files of counts that hold several arrays, or number of the data block
        in .sdt files.
    axes : str, default "row,col,code"
        Names of the axes of the array in files of counts, in its order: row, col and code; frame
        in place of code for raw codes; a minus sign for an axis of length one.
    channel : int, optional
        Detection channel of .ptu and .sdt files, counted from 0. By default the only one with
        photons.
    workers : int, optional
        Number of processes that share the captures of a folder. By default one for each
        processor core.
    scheduler : str, optional
        Address of a Dask scheduler, such as tcp://head-node:8786, that reconstructs the captures
        of a folder instead of local processes.
    preview : bool, default True
        Write a picture NAME.png beside the image of one capture. Without the package that draws
        it, a message says so and only the image is written.
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
    require_threads(threads)
    options: dict[str, Any] = {"pileup_correction": pileup_correction}
    given = {
        "method": method,
        "range_correction": range_correction,
        "background": None if background == "flat" else background,
        "depth_range": depth_range,
        "frames": frames,
        "bands": band_list(bands),
        "region": region_slices(region),
        "mixed": mixed,
        "second_returns": second_returns,
        "threads": None if threads == 1 else threads,
    }
    options |= {name: value for name, value in given.items() if value is not None}
    reading = ReadOptions(dataset=dataset, axes=axes, channel=channel)
    shown = progress(json_wanted=json)
    departures = "correct" if correct_drift else "check" if check else "ignore"
    if not _names_one_image(out):
        if departures != "ignore":
            raise HueflightError(
                f"--out {out} is a folder: --check and --correct-drift take one capture and the "
                "name of its image, NAME.zarr or NAME.nc"
            )
        report = reconstruct_many(
            captures, out, calibration=calibration, workers=workers, scheduler=scheduler,
            options=options, reading=reading, overwrite=overwrite, progress=shown,
        )  # fmt: skip
        show(f"Batch {out}", _batch_summary(report, everything=json), json_wanted=json)
        return FAILED if report.failed else 0
    capture, *others = captures
    if others:
        raise HueflightError(
            f"--out {out} names one image, but there are {len(captures)} captures: name a folder"
        )
    result = reconstruct_file(
        capture, out, calibration=calibration, options=options, reading=reading,
        departures=departures, preview=preview and _can_draw(), overwrite=overwrite, progress=shown,
    )  # fmt: skip
    show(f"Image {out}", result.summary(), json_wanted=json)
    return 0


def _names_one_image(out: Path) -> bool:
    """Tell the name of an image from that of a folder of images; other formats are refused."""
    name = out.name.lower()
    for entry in FORMATS.values():
        if name.endswith(entry.endings) and not out.is_dir():
            if entry.name in IMAGE_FORMATS:
                return True
            raise HueflightError(
                f"--out {out}: images are written as NAME.zarr or NAME.nc; write one of these, "
                f"then convert it: hueflight export {out.stem}.zarr {out.name}"
            )
    return name.endswith(IMAGE_ENDINGS)


def _can_draw() -> bool:
    """Whether a preview can be drawn; a message says why not. The image is written either way."""
    try:
        import_optional("matplotlib", extra="report")
    except MissingPackageError as error:
        print_notice(f"no preview is drawn: {error}")
        return False
    return True


def _batch_summary(report: BatchReport, *, everything: bool) -> dict[str, Any]:
    """For people how many there are and which failed; scripts get all outcomes."""
    summary = report.to_dict()
    if not everything:
        del summary["outcomes"]
        for number, outcome in enumerate(report.failed, 1):
            summary[f"failure_{number}"] = f"{outcome.capture}: {outcome.error}"
    return summary
