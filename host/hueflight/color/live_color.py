# SPDX-License-Identifier: Apache-2.0
"""Colours of live pictures from all bands, by one matrix for each picture.

`hueflight.color.color_picture` weighs the noise of each pixel, and takes a second for a picture.
Here all pixels of a picture count as equally noisy; the estimate of least mean squared error is
then one matrix, which is computed once for each noise level.
"""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from hueflight.color.display import three_band_rgb
from hueflight.color.observer import encoded, linear_of
from hueflight.color.picture import LEAST_BANDS, VISIBLE_NM
from hueflight.color.recovery import LEAST_NOISE, SpectralModel
from hueflight.model.emission import Emission
from hueflight.model.instrument import Instrument

WHITE_PERCENT = 98  #: percentile of the pixels' brightness that is shown as white
STEPS = 2  #: matrices for each doubling of the noise
LEVELS = 4096  #: of linear light, in the table of sRGB values
_SRGB = np.round(255 * encoded(np.linspace(0, 1, LEVELS))).astype(np.uint8)


class LiveColor:
    """Turns the reflectances of an instrument's bands into sRGB values.

    Parameters
    ----------
    instrument : Instrument
        Instrument that has the bands.
    emission : Emission, optional
        Measured spectra of its LEDs; by default Gaussians of the widths that it states.
    """

    def __init__(self, instrument: Instrument, emission: Emission | None = None, /) -> None:
        low, high = VISIBLE_NM
        nm = instrument.wavelengths_nm
        self._has_color = ((low <= nm) & (nm <= high)).sum() >= LEAST_BANDS
        self._model = SpectralModel.of(instrument, emission)
        self._query = linear_of(self._model.to_xyz().T).T  # (rgb, node)
        self._matrices: dict[int, NDArray[np.float32]] = {}

    def render(self, image: xr.Dataset, /) -> NDArray[np.uint8] | None:
        """Return the colours of an image under daylight.

        Parameters
        ----------
        image : xarray.Dataset
            Reconstructed image.

        Returns
        -------
        array of uint8, shape (row, col, 3), or None
            Values of sRGB, 0 where the reflectance is unknown; None if too few bands are visible.
        """
        reflectance = image["reflectance"].values
        known = np.asarray(np.isfinite(reflectance).all(axis=-1))
        if not self._has_color or not known.any():
            return None
        noise = float(np.median(image["reflectance_std"].values[known].mean(axis=0)))
        linear = np.where(known[..., None], reflectance, 0) @ self._matrix(noise).T
        brightest = linear.max(axis=-1)[known]
        white = max(float(np.percentile(brightest, WHITE_PERCENT)), 1e-12)
        level = np.clip(linear * ((LEVELS - 1) / white) + 0.5, 0, LEVELS - 1)
        return _SRGB[level.astype(np.uint16)]

    def shown(self, image: xr.Dataset, /) -> NDArray[np.uint8]:
        """Return the colours of an image, or false colours if too few bands are visible.

        Parameters
        ----------
        image : xarray.Dataset
            Reconstructed image.

        Returns
        -------
        array of uint8, shape (row, col, 3)
            Values of sRGB, black where the reflectance is unknown.
        """
        if not self._has_color and np.isfinite(image["reflectance"].values).any(axis=(0, 1)).all():
            return np.rint(three_band_rgb(image) * 255).astype(np.uint8)
        rgb = self.render(image)
        return np.zeros((*image["depth"].shape, 3), np.uint8) if rgb is None else rgb

    def _matrix(self, noise: float) -> NDArray[np.float32]:
        """Matrix (rgb, band) for about this much noise."""
        finite = max(noise, LEAST_NOISE) if np.isfinite(noise) else 1.0
        step = round(STEPS * float(np.log2(finite)))
        if step not in self._matrices:
            found = self._model.linear(self._query, noise=2 ** (step / STEPS))
            self._matrices[step] = found.astype(np.float32)
        return self._matrices[step]
