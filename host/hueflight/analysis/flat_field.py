# SPDX-License-Identifier: Apache-2.0
"""Uneven illumination: the pattern of each band's light, and images without it.

A calibration evens out how bright each pixel saw the target in all bands together. What it leaves
is what differs from band to band, because each LED stands elsewhere and has a beam of its own, and
whatever the target did not show. An image of an even board tells that pattern. It is smooth, so
that a polynomial over the image describes it and has far less noise than single pixels.
"""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.polynomial import legendre
from numpy.typing import NDArray

from hueflight.analysis.regions import reliable
from hueflight.errors import HueflightError
from hueflight.files.image_schema import SERIES_DIM, require_image

PIXELS_PER_TERM = 8  #: fewer pixels do not determine a polynomial well
OUTLIER = 4.0  #: pixels farther from the polynomial than so many deviations are left out once


def illumination_pattern(board: xr.Dataset, /, *, order: int = 4) -> xr.DataArray:
    """Measure the pattern of each band's light over the image, from an image of an even board.

    Parameters
    ----------
    board : Dataset
        Image of a flat, matte board of one color that fills the picture.
    order : int
        Highest power of row and column together in the polynomial; 0 for no pattern.

    Returns
    -------
    DataArray, dims (row, col, band)
        Illumination relative to its mean over the image, which is 1 in every band.

    Raises
    ------
    HueflightError
        If too few pixels have a reflectance, or the polynomial is not positive everywhere: then the
        board does not fill the picture.
    """
    require_image(board)
    if SERIES_DIM in board.dims:
        raise HueflightError("this is a series: select one image of the board")
    shape = (board.sizes["row"], board.sizes["col"])
    terms = _terms(shape, order)
    planes = board.transpose("band", "row", "col")
    trusted = reliable(board).transpose("row", "col").values.ravel()
    values = planes["reflectance"].values.reshape(planes.sizes["band"], -1).astype(np.float64)
    pattern = np.empty((values.shape[0], *shape))
    for band, plane in enumerate(values):
        fitted = terms @ _fit(terms, plane, trusted & np.isfinite(plane), band)
        if fitted.min() <= 0:
            raise HueflightError(
                f"the light of band {band} falls to nothing within the image: the board does not "
                "fill the picture, or order is too high"
            )
        pattern[band] = (fitted / fitted.mean()).reshape(shape)
    return xr.DataArray(
        np.moveaxis(pattern, 0, -1).astype(np.float32),
        dims=("row", "col", "band"),
        coords={"wavelength": board["wavelength"]},
        attrs={"units": "1", "long_name": "illumination relative to its mean", "order": order},
    )


def flatten(image: xr.Dataset, pattern: xr.DataArray, /) -> xr.Dataset:
    """Divide the reflectances of an image by the pattern of the light.

    Parameters
    ----------
    image : Dataset
        Image with the same calibration as that of the board.
    pattern : DataArray, dims (row, col, band)
        Pattern, as `illumination_pattern` gives.

    Returns
    -------
    Dataset
        A copy. The attribute `flat_field` of `reflectance` states that it was done.

    Raises
    ------
    HueflightError
        If the pattern belongs to another image size or other bands, or the image was flattened
        before.
    """
    require_image(image)
    if image["reflectance"].attrs.get("flat_field", "none") != "none":
        raise HueflightError("the reflectances of this image are flattened already")
    for dim in ("row", "col", "band"):
        if image.sizes[dim] != pattern.sizes.get(dim):
            raise HueflightError(
                f"the pattern has sizes {dict(pattern.sizes)}, the image {dict(image.sizes)}: "
                "measure it with the same instrument"
            )
    if not np.array_equal(image["wavelength"].values, pattern["wavelength"].values):
        raise HueflightError(
            f"the pattern has bands of {pattern['wavelength'].values.tolist()} nm, the image "
            f"{image['wavelength'].values.tolist()} nm: measure it with the same bands"
        )
    flat = image.copy()
    plain = pattern.drop_vars("wavelength")
    for name in ("reflectance", "reflectance_std"):
        if name in image:
            attributes = {**image[name].attrs, "flat_field": "illumination pattern of each band"}
            even = (image[name] / plain).transpose(*image[name].dims)
            flat[name] = even.astype(image[name].dtype).assign_attrs(attributes)
    if "white_photons" in image.coords:  # of all bands together
        mean = (plain * image["white_share"]).sum("band") / image["white_share"].sum("band")
        white = image["white_photons"]
        scaled = (white * mean).transpose(*white.dims).drop_vars("white_photons", errors="ignore")
        flat = flat.assign_coords(white_photons=(white.dims, scaled.values, white.attrs))
    return flat


def _terms(shape: tuple[int, int], order: int) -> NDArray[np.float64]:
    """Products (pixel, term) of Legendre polynomials of row and column up to an order."""
    if not (isinstance(order, int) and 0 <= order <= 8):
        raise HueflightError(f"order = {order!r}: give a whole number from 0 to 8")
    rows, cols = (legendre.legvander(np.linspace(-1, 1, size), order) for size in shape)
    pairs = [(i, j) for i in range(order + 1) for j in range(order + 1 - i)]
    return np.stack(
        [np.outer(rows[:, i], cols[:, j]).ravel() for i, j in pairs], axis=-1, dtype=np.float64
    )


def _fit(
    terms: NDArray[np.float64], values: NDArray[np.float64], known: NDArray[np.bool_], band: int
) -> NDArray[np.float64]:
    """Coefficients by least squares, once more without what lies far from them."""
    coefficients = np.zeros(terms.shape[1])
    for _ in range(2):
        needed = PIXELS_PER_TERM * terms.shape[1]
        if known.sum() < needed:
            raise HueflightError(
                f"only {known.sum()} pixels of the board have a reliable reflectance in band "
                f"{band}; {needed} are needed for this order: choose a lower one, or capture longer"
            )
        coefficients = np.linalg.lstsq(terms[known], values[known], rcond=None)[0].astype(
            np.float64
        )
        apart = np.abs(values - terms @ coefficients)
        known = known & (apart <= OUTLIER * 1.4826 * np.median(apart[known]))
    return coefficients
