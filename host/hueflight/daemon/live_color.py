"""Colours of live pictures from all bands, by one matrix a picture.

`color_picture` weighs each pixel's noise, and takes a second for a picture; here all pixels of a
picture count as equally noisy, and the estimate of least error is a matrix, made once.
"""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from hueflight.color.observer import encoded, linear_of
from hueflight.color.picture import LEAST_BANDS, VISIBLE_NM
from hueflight.color.recovery import LEAST_NOISE, SpectralModel
from hueflight.model.emission import Emission
from hueflight.model.instrument import Instrument

WHITE_PERCENT = 98  #: of the pixels fit the screen
STEPS = 2  #: matrices for each doubling of the noise
LEVELS = 4096  #: of light, to look its code for the screen up
_CODES = np.round(255 * encoded(np.linspace(0, 1, LEVELS))).astype(np.uint8)


class Palette:
    """Turns the reflectances of an instrument's bands into codes for the screen.

    Parameters
    ----------
    instrument : whose bands they are.
    emission : measured spectra of its LEDs; by default of the widths that it states.
    """

    def __init__(self, instrument: Instrument, emission: Emission | None = None, /) -> None:
        low, high = VISIBLE_NM
        seen_nm = instrument.wavelengths_nm
        self._tells_colours = ((low <= seen_nm) & (seen_nm <= high)).sum() >= LEAST_BANDS
        self._model = SpectralModel.of(instrument, emission)
        self._query = linear_of(self._model.to_xyz().T).T  # (rgb, node)
        self._matrices: dict[int, NDArray[np.float32]] = {}

    def colours(self, image: xr.Dataset, /) -> NDArray[np.uint8] | None:
        """Codes (row, col, 3) of sRGB, 0 where unknown; None if too few bands are visible."""
        reflectance = image["reflectance"].values
        known = np.asarray(np.isfinite(reflectance).all(axis=-1))
        if not self._tells_colours or not known.any():
            return None
        noise = float(np.median(image["reflectance_std"].values[known].mean(axis=0)))
        linear = np.where(known[..., None], reflectance, 0) @ self._matrix(noise).T
        brightest = linear.max(axis=-1)[known]
        white = max(float(np.percentile(brightest, WHITE_PERCENT)), 1e-12)
        level = np.clip(linear * ((LEVELS - 1) / white) + 0.5, 0, LEVELS - 1)
        return _CODES[level.astype(np.uint16)]

    def _matrix(self, noise: float) -> NDArray[np.float32]:
        """(rgb, band) for about so much noise."""
        finite = max(noise, LEAST_NOISE) if np.isfinite(noise) else 1.0
        step = round(STEPS * float(np.log2(finite)))
        if step not in self._matrices:
            found = self._model.linear(self._query, noise=2 ** (step / STEPS))
            self._matrices[step] = found.astype(np.float32)
        return self._matrices[step]
