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
SAMPLED_PIXELS = 4096  #: of a picture at least, from which scales and noise are estimated
LEVELS = 4096  #: of linear light, in the table of sRGB values
_SRGB = np.round(255 * encoded(np.linspace(0, 1, LEVELS))).astype(np.uint8)


def sampling_step(count: int, /) -> int:
    """Return the step with which a few thousand of so many pixels are looked at.

    Parameters
    ----------
    count : int
        Number of pixels.

    Returns
    -------
    int
        The step, odd so that it meets all columns of a picture whose width is even; 1 for few
        pixels.
    """
    return count // SAMPLED_PIXELS | 1


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
        if not self._has_color:
            return None
        # without labels, which cost more than the arrays; one row for each pixel
        reflectance = image.variables["reflectance"].values
        bands = reflectance.reshape(-1, reflectance.shape[-1])
        # a pixel of which a band is unknown has an unknown sum
        known = np.flatnonzero(np.isfinite(bands.sum(axis=-1)))
        if not known.size:
            return None
        some = known[:: sampling_step(known.size)]
        deviations = image.variables["reflectance_std"].values.reshape(bands.shape)
        noise = float(np.median(deviations[some].mean(axis=0)))
        linear = bands @ self._matrix(noise).T
        brightest = linear[some].max(axis=-1)
        place = int(WHITE_PERCENT / 100 * (some.size - 1) + 0.5)
        white = max(float(np.partition(brightest, place)[place]), 1e-12)
        linear *= (LEVELS - 1) / white
        linear += 0.5
        np.fmax(linear, 0.0, out=linear)  # which takes 0 for NaN
        np.minimum(linear, LEVELS - 1, out=linear)
        return _SRGB.take(linear.astype(np.uint16)).reshape(*reflectance.shape[:-1], 3)

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
