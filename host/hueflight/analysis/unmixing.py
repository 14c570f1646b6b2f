# SPDX-License-Identifier: Apache-2.0
"""Non-negative linear unmixing: how much of each material of a library is in a spectrum."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.optimize import nnls

from hueflight.analysis.library import SpectralLibrary
from hueflight.errors import HueflightError
from hueflight.model.instrument import Instrument

#: smallest ratio of singular values of the spectra, each scaled to length 1
DISTINCT = 1e-3


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
    Weighted non-negative least squares (Lawson and Hanson, Solving Least Squares Problems, 1974).
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
    values = spectra.transpose(*outer, "band").values.reshape(-1, bands).astype(np.float64)
    stds = deviations.transpose(*outer, "band").values.reshape(-1, bands).astype(np.float64)
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
    values: NDArray[np.float64], stds: NDArray[np.float64], design: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Abundances, deviations (spectrum, entry) and chi-square (spectrum,)."""
    entries = design.shape[1]
    known = np.isfinite(values) & np.isfinite(stds) & (stds > 0)
    weights = np.where(known, 1 / np.where(known, stds, 1.0), 0.0)
    scaled = np.where(known, values, 0.0) * weights
    matrices = weights[:, :, None] * design
    enough = np.linalg.matrix_rank(matrices) == entries
    abundance = np.full((len(values), entries), np.nan)
    deviation, chi_square = abundance.copy(), np.full(len(values), np.nan)
    if not enough.any():
        return abundance, deviation, chi_square
    matrices, scaled = matrices[enough], scaled[enough]
    covariance = np.linalg.inv(np.einsum("pbk,pbl->pkl", matrices, matrices))
    solved = np.einsum("pkl,pbl,pb->pk", covariance, matrices, scaled, optimize=True)
    for row in np.flatnonzero((solved < 0).any(axis=1)):  # elsewhere this is the solution already
        solved[row], _ = nnls(matrices[row], scaled[row])
    residual = scaled - np.einsum("pbk,pk->pb", matrices, solved)
    freedom = known[enough].sum(axis=1) - entries
    abundance[enough] = solved
    deviation[enough] = np.sqrt(np.einsum("pkk->pk", covariance))
    chi_square[enough] = np.where(
        freedom > 0, (residual**2).sum(axis=1) / np.maximum(freedom, 1), np.nan
    )
    return abundance, deviation, chi_square
