# SPDX-License-Identifier: Apache-2.0
"""Images from Zarr stores and NetCDF files, which are checked to be complete."""

from __future__ import annotations

from pathlib import Path

import xarray as xr

from hueflight.arguments import PATH, takes
from hueflight.errors import FileFormatError, ImageError, InputNotFoundError, MissingPackageError
from hueflight.files import import_optional, verify_checksums
from hueflight.files.bands import has_band_labels
from hueflight.files.image_schema import CAPTURE_NAME, SERIES_DIM, require_image
from hueflight.recognition import IMAGE, what_is, why_unreadable

ENDINGS = (".zarr", ".nc", ".nc4")


def is_image(path: Path, /) -> bool:
    """Tell whether a file is an image, and no counts or calibration, without reading its arrays.

    Parameters
    ----------
    path : pathlib.Path
        Path of the file.

    Returns
    -------
    bool
        True for NetCDF files, and for Zarr stores with a depth.
    """
    ending = path.suffix.lower()
    return ending in ENDINGS and (ending != ".zarr" or (path / "depth").is_dir())


@takes(path=PATH)
def read_image(path: str | Path, /) -> xr.Dataset:
    """Read an image or series that `hueflight.export` wrote as Zarr or NetCDF.

    Parameters
    ----------
    path : str or pathlib.Path
        Path of the store or file.

    Returns
    -------
    xarray.Dataset
        The image or series, in memory.

    Raises
    ------
    FileFormatError
        If there is no such file, it is damaged or incomplete, or it holds no image.
    """
    path = Path(path)
    if not path.exists():
        raise InputNotFoundError(f"no image {str(path)!r}: there is no such file")
    store = path.suffix.lower() == ".zarr"
    seems = what_is(path)
    if not path.name.lower().endswith(ENDINGS) or (store and seems != IMAGE):
        raise FileFormatError(
            f"{str(path)!r} is {seems}, not an image: give NAME.zarr or NAME.nc, as hueflight "
            "reconstruct writes them"
        )
    try:
        if store:
            verify_checksums(path)
            with xr.open_zarr(path, chunks=None) as opened:
                image = opened.load()
        else:
            import_optional("h5netcdf", extra="import")
            with xr.open_dataset(path, engine="h5netcdf") as opened:
                image = opened.load()
        require_image(image)
    except (FileFormatError, MissingPackageError):
        raise
    except ImageError as error:
        raise FileFormatError(f"{str(path)!r}: {error}") from None
    except Exception as error:  # the libraries raise many kinds of errors for damaged files
        raise FileFormatError(why_unreadable(path, error)) from error
    if has_band_labels(image):
        # images of version 0.1.0 and NetCDF files have the names, but not as labels for `sel`
        image = image.assign_coords(band=image["band_name"].values)
    if CAPTURE_NAME in image.coords:
        names = image[CAPTURE_NAME].values
        image = image.drop_vars(CAPTURE_NAME).assign_coords({SERIES_DIM: names})
    return image
