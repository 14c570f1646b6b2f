# SPDX-License-Identifier: Apache-2.0
"""The command `hueflight view`."""

from __future__ import annotations

import webbrowser
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from hueflight.calibration import Calibration
from hueflight.cli.choices import PRESETS
from hueflight.cli.options import WHOLE, band_list, region_slices, require_threads
from hueflight.cli.output import print_notice, show
from hueflight.daemon.viewer import viewer_page
from hueflight.errors import HueflightError
from hueflight.files import refuse_existing, staged
from hueflight.files.image_schema import instrument_of
from hueflight.importers import read_image
from hueflight.importers.captures import read_capture
from hueflight.importers.images import is_image
from hueflight.importers.options import AXES
from hueflight.model.instrument import Instrument
from hueflight.reconstruction import reconstruct


def view(
    file: Path,
    *,
    calibration: Annotated[Path | None, Parameter(name=["--calibration", "-c"])] = None,
    capture: Path | None = None,
    instrument: Annotated[
        str | None,
        Parameter(
            help=f"Instrument of the capture: a preset ({PRESETS}) or the path of a TOML file. "
            "Needed only where neither the file nor a calibration names it."
        ),
    ] = None,
    frames: float | None = None,
    depth_range: Annotated[tuple[float, float] | None, Parameter(negative_iterable=())] = None,
    bands: str | None = None,
    region: str | None = None,
    threads: Annotated[int, WHOLE] = 1,
    out: Annotated[Path | None, Parameter(name=["--out", "-o"])] = None,
    open_page: Annotated[bool, Parameter(name=["--open"], negative=["--no-open"])] = True,
    dataset: str | None = None,
    axes: str = AXES,
    channel: Annotated[int | None, WHOLE] = None,
    overwrite: bool = False,
    json: bool = False,
) -> None:
    """Show an image, a recording or counts in the browser, as one HTML file.

    The page has depth, color, bands, uncertainty, quality, points, and the histogram of a pixel
    with the fit drawn through it. It can be sent to others.

    Parameters
    ----------
    file : Path
        Image (.zarr, .nc), recording (.mcap) or counts (.npz, .npy, .zarr, .h5, .mat, .ptu, .sdt).
    calibration : Path, optional
        Calibration of the capture. With it, the image of a recording or of counts is reconstructed
        and shown; without it, only histograms are.
    capture : Path, optional
        Recording or counts of which the image FILE was made, for the histograms of its pixels.
    instrument : str, optional
        Instrument of the capture.
    frames : float, optional
        Number of exposures behind the capture, for its image. By default the sum of the counts of a
        pixel if the sensor reports its empty exposures; otherwise as many as the reference had.
    depth_range : tuple of float, optional
        Nearest and farthest depth to search for the image, in metres: two numbers, such as 0.3 1.5.
    bands : str, optional
        Names or numbers (from 0) of the bands to keep in the image, separated by commas.
    region : str, optional
        Rows and columns to reconstruct, from 0 and without the last ones, such as 10:20,30:40.
    threads : int, default 1
        Number of threads that share the pixels of the image.
    out : Path, optional
        Page to write, NAME.html. By default the name of the file with this extension.
    open_page : bool, default True
        Open the page in the browser; --no-open only writes it.
    dataset : str, optional
        Name of the array in files of counts that hold several arrays.
    axes : str, default "row,col,code"
        Names of the axes of the array in files of counts, in its order.
    channel : int, optional
        Detection channel of .ptu and .sdt files, counted from 0.
    overwrite : bool, default False
        Replace an existing page.
    json : bool, default False
        Print one JSON object instead of a table.
    """
    page = file.with_suffix(".html") if out is None else out
    if page.suffix.lower() not in (".html", ".htm"):
        raise HueflightError(f"--out {page}: a page is written as NAME.html")
    refuse_existing(page, overwrite=overwrite)
    require_threads(threads)
    options: dict[str, Any] = {
        "frames": frames, "depth_range": depth_range, "bands": band_list(bands),
        "region": region_slices(region), "threads": None if threads == 1 else threads,
    }  # fmt: skip
    options = {name: value for name, value in options.items() if value is not None}
    known = None if calibration is None else Calibration.load(calibration)
    described = None if instrument is None else Instrument.load(instrument)
    if described is None and known is not None:
        described = known.instrument
    image = read_image(file) if is_image(file) else None
    if options and (image is not None or known is None):
        name = "--" + next(iter(options)).replace("_", "-")
        raise HueflightError(
            f"{name}: {file} is not reconstructed here; give a capture and --calibration, or leave "
            f"{name} out"
        )
    if image is not None:
        described = instrument_of(image, described)
    source = file if image is None else capture
    counts = None
    if source is not None:
        taken = read_capture(source, described, dataset=dataset, axes=axes, channel=channel)
        counts, described = taken.counts, taken.instrument
    if image is not None and counts is not None and known is None:
        print_notice("no fit is drawn through the histograms: give --calibration")
    elif image is None and known is not None and counts is not None:
        known.require(described or known.instrument)
        image = reconstruct(counts, known, **options)
    assert described is not None  # of the image or of the capture
    text = viewer_page(
        title=file.name, instrument=described, image=image, histogram=counts, calibration=known
    )
    with staged(page, overwrite=overwrite) as partial:
        partial.write_text(text, encoding="utf-8")
    if open_page and not webbrowser.open(page.resolve().as_uri()):
        print_notice(f"there is no browser to open {page}: open it by hand, or use --no-open")
    show(f"Page {page}", {"bytes": page.stat().st_size}, json_wanted=json)
