# SPDX-License-Identifier: Apache-2.0
"""Spectra of regions as CSV, for spreadsheets and statistics software."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import xarray as xr

from hueflight.analysis.regions import Region, region_spectra
from hueflight.export.description import band_widths_nm, plain_attributes
from hueflight.files import staged
from hueflight.files.bands import band_names
from hueflight.files.image_schema import SERIES_DIM, require_image

WHOLE = "whole image"
COLUMNS = (
    "region", "band", "wavelength_nm", "fwhm_nm", "reflectance", "reflectance_std",
    "reflectance_scatter", "pixels", "depth_m", "depth_std_m", "depth_scatter_m",
)  # fmt: skip


def write_csv(
    image: xr.Dataset,
    path: str | Path,
    /,
    *,
    regions: Mapping[str, Region] | None = None,
    overwrite: bool = False,
) -> None:
    """Write the mean spectra of regions as CSV, with one line per region and band.

    Lines that begin with ``#`` hold the metadata of the image; names that contain this character
    are quoted. Unknown numbers are empty. A series has `capture` as its first column.

    Parameters
    ----------
    image : xarray.Dataset
        Image or series.
    path : str or pathlib.Path
        Name of the file.
    regions : Mapping of str to Region, optional
        Masks or slices by name, as for `hueflight.analysis.region_spectra`; by default the whole
        image.
    overwrite : bool
        Whether an existing file of this name may be replaced.

    Raises
    ------
    ImageError
        If it is not an image.
    ExportError
        If the format can't hold the image.
    OutputError
        If the file exists already or can't be written.
    """
    require_image(image)
    chosen = regions or {WHOLE: np.ones((image.sizes["row"], image.sizes["col"]), dtype=bool)}
    spectra = region_spectra(image, chosen)
    series = SERIES_DIM in image.dims
    text = io.StringIO(newline="")
    for key, value in plain_attributes(image).items():
        text.write(f"# {key}: {' '.join(value.split())}\r\n")
    rows = [([SERIES_DIM] if series else []) + list(COLUMNS)]
    if series:
        for name in image[SERIES_DIM].values:
            one = spectra.sel({SERIES_DIM: name})
            rows += [[str(name), *line] for line in _lines(image, one)]
    else:
        rows += _lines(image, spectra)
    text.writelines(",".join(map(_field, row)) + "\r\n" for row in rows)
    with staged(path, overwrite=overwrite) as partial:
        partial.write_text(text.getvalue(), encoding="utf-8", newline="")


def _lines(image: xr.Dataset, spectra: xr.Dataset) -> list[list[str]]:
    names, wavelengths = band_names(image), image["wavelength"].values
    widths = band_widths_nm(image)
    lines = []
    for region in spectra["region"].values:
        one = spectra.sel(region=region)
        for band, name in enumerate(names):
            here = one.isel(band=band)
            lines.append([
                str(region),
                name,
                f"{wavelengths[band]:g}",
                "" if widths is None or np.isnan(widths[band]) else f"{widths[band]:g}",
                *(_number(here[key]) for key in ("reflectance", "reflectance_std",
                                                 "reflectance_scatter")),
                str(int(here["pixels"])),
                *(_number(here[key]) for key in ("depth", "depth_std", "depth_scatter")),
            ])  # fmt: skip
    return lines


def _number(value: xr.DataArray) -> str:
    number = float(value)
    return repr(number) if np.isfinite(number) else ""


def _field(text: str) -> str:
    """Return a field of a line, quoted as in RFC 4180 where necessary, and where it has a #."""
    if any(character in text for character in ',"\r\n#'):
        return '"' + text.replace('"', '""') + '"'
    return text
