# SPDX-License-Identifier: Apache-2.0
"""Non-negative linear unmixing: how much of each material of a library is in a spectrum."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from hueflight.analysis.library import SpectralLibrary
from hueflight.analysis.nonnegative import inverses, nonnegative_solutions
from hueflight.errors import HueflightError
from hueflight.model.instrument import Instrument

#: smallest ratio of singular values of the spectra, each scaled to length 1
DISTINCT = 1e-3
BLOCK = 2048  #: spectra at a time, whose matrices fit into the processor's cache


def unmix(
    spectra: xr.DataArray,
    deviations: xr.DataArray,
    library: SpectralLibrary,
    instrument: Instrument,
    /,
) -> xr.Dataset:
    """Estimate the abundance of each entry of a library, none of them negative.

    A spectrum is taken for the sum of the entries, each times its abundance. Abundances need not
    add up to 1, because shadow and distance change the brightness.

    Parameters
    ----------
    spectra : DataArray, dims (..., band)
        Reflectances, such as ``image["reflectance"]``. Unknown bands are left out.
    deviations : DataArray, dims (..., band)
        Their standard deviations, which count as independent.
    library : SpectralLibrary
        Spectra of the materials that may occur, at most as many as there are bands.
    instrument : Instrument
        Instrument that measured the spectra.

    Returns
    -------
    Dataset
        `abundance` (..., entry); `abundance_std` (..., entry), that of the fit without the bound
        at 0, which is too large rather than too small near it; `fit_chi_square` (...), per degree
        of freedom, which is NaN without any. Values are NaN where fewer bands than entries are
        known.

    Raises
    ------
    HueflightError
        If the numbers of bands differ, a band lies outside the library's wavelengths, or the bands
        can't tell the entries apart.

    Notes
    -----
    Weighted non-negative least squares (Lawson and Hanson, Solving Least Squares Problems, 1974),
    of all spectra at once by `hueflight.analysis.nonnegative.nonnegative_solutions`.
    """
    bands = len(instrument.bands)
    if spectra.sizes.get("band") != bands or deviations.sizes.get("band") != bands:
        raise HueflightError(
            f"the spectra have {dict(spectra.sizes)}, their deviations {dict(deviations.sizes)}, "
            f"instrument {instrument.name!r} has {bands} bands"
        )
    design = library.in_bands(instrument).transpose("band", "entry").values
    _require_distinct(design, library)
    outer = [dim for dim in spectra.dims if dim != "band"]
    values = spectra.transpose(*outer, "band").values.reshape(-1, bands)
    stds = deviations.transpose(*outer, "band").values.reshape(-1, bands)
    found = _solve(values, stds, design)
    shape, entries = tuple(spectra.sizes[dim] for dim in outer), len(library.names)
    cube = (*outer, "entry")
    return xr.Dataset(
        {
            "abundance": (cube, found[0].reshape(*shape, entries), {"units": "1"}),
            "abundance_std": (cube, found[1].reshape(*shape, entries), {"units": "1"}),
            "fit_chi_square": (outer, found[2].reshape(shape), {"units": "1"}),
        },
        coords={"entry": list(library.names), **_coordinates(spectra)},
    )


def _coordinates(spectra: xr.DataArray) -> dict[str, xr.DataArray]:
    return {str(k): v for k, v in spectra.coords.items() if "band" not in v.dims and k != "entry"}


def _require_distinct(design: NDArray[np.float64], library: SpectralLibrary) -> None:
    bands, entries = design.shape
    if entries > bands:
        raise HueflightError(
            f"{bands} bands can't tell {entries} materials apart: choose at most {bands} entries "
            "of the library"
        )
    lengths = np.linalg.norm(design, axis=0)
    if not (lengths > 0).all():
        dark = library.names[int(np.argmin(lengths))]
        raise HueflightError(f"entry {dark!r} reflects nothing in these bands: leave it out")
    scaled = design / lengths
    singular = np.linalg.svd(scaled, compute_uv=False)
    if singular[-1] < DISTINCT * singular[0]:
        cosines = np.abs(scaled.T @ scaled) - 2 * np.eye(entries)
        first, second = np.unravel_index(int(cosines.argmax()), cosines.shape)
        raise HueflightError(
            f"these bands can't tell the {entries} entries apart; the most similar are "
            f"{library.names[first]!r} and {library.names[second]!r}: leave one out"
        )


def _solve(
    values: NDArray[np.floating], stds: NDArray[np.floating], design: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Abundances, deviations (spectrum, entry) and chi-square (spectrum,), block by block."""
    known = np.isfinite(values) & np.isfinite(stds) & (stds > 0)
    enough = np.flatnonzero(_enough(known, design))
    abundance = np.full((len(values), design.shape[1]), np.nan)
    deviation, chi_square = abundance.copy(), np.full(len(values), np.nan)
    for start in range(0, len(enough), BLOCK):
        block = enough[start : start + BLOCK]
        abundance[block], deviation[block], chi_square[block] = _solve_block(
            values[block], stds[block], known[block], design
        )
    return abundance, deviation, chi_square


def _solve_block(
    values: NDArray[np.floating],
    stds: NDArray[np.floating],
    known: NDArray[np.bool_],
    design: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    entries = design.shape[1]
    weights = np.where(known, 1 / np.where(known, stds, 1).astype(np.float64) ** 2, 0.0).T
    spectra = np.where(known, values, 0).astype(np.float64).T
    # normal equations of each spectrum, from the products of each two entries in each band
    products = (design[:, :, None] * design[:, None, :]).reshape(len(design), -1)
    matrices = (products.T @ weights).reshape(entries, entries, -1)
    sides = design.T @ (weights * spectra)
    covariance = inverses(matrices)
    solved = nonnegative_solutions(matrices, sides, (covariance * sides).sum(axis=1))
    chi_square = (weights * (spectra - design @ solved) ** 2).sum(axis=0)
    freedom = known.sum(axis=1) - entries
    per_degree = np.where(freedom > 0, chi_square / np.maximum(freedom, 1), np.nan)
    own = np.arange(entries)
    return solved.T, np.sqrt(covariance[own, own]).T, per_degree


def _enough(known: NDArray[np.bool_], design: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether the known bands of each spectrum tell the entries apart."""
    packed = np.packbits(known, axis=1)
    _, first, place = np.unique(packed, axis=0, return_index=True, return_inverse=True)
    entries = design.shape[1]
    enough = [
        known[row].sum() >= entries and np.linalg.matrix_rank(design[known[row]]) == entries
        for row in first
    ]
    return np.array(enough, bool)[place.reshape(-1)]
