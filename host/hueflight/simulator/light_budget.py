# SPDX-License-Identifier: Apache-2.0
"""Light budget: photons that a pixel detects from a white plane, by band."""

from __future__ import annotations

from math import pi

import numpy as np
from numpy.typing import NDArray

from hueflight.errors import InstrumentError
from hueflight.model.instrument import Instrument
from hueflight.model.pileup import periods_per_exposure
from hueflight.model.spectra import mean_detection
from hueflight.simulator.settings import SimulationSettings


def white_photons(instrument: Instrument, settings: SimulationSettings) -> NDArray[np.float64]:
    """LED photons per period that a pixel on the axis detects from a white plane at 1 m.

    Parameters
    ----------
    instrument : Instrument
        Instrument whose power, spectra and detector divide the light among the bands.
    settings : SimulationSettings
        Settings whose `white_detections` fixes the sum over all bands.

    Returns
    -------
    ndarray of float, shape (band,)
        Detectable photons per period of each LED at full strength.
    """
    shares = _power_w(instrument) * mean_detection(instrument)
    per_exposure = settings.white_detections * shares / shares.sum()
    return per_exposure / periods_per_exposure(instrument)


def radiometric_detections(instrument: Instrument, *, fill_factor: float = 0.13) -> float:
    """Compute `SimulationSettings.white_detections` from the instrument's power and optics.

    A Lambertian LED of power P on the axis produces the irradiance P/(π z²) on a plane at the
    distance z. A Lambertian white surface reflects it with the radiance P/(π² z²), and a pixel of
    area A behind a lens of f-number N receives π A/(4 N²) times that radiance. For preset `paper`
    the result is about 12 per exposure: the default 0.35 corresponds to the same set-up with its
    iris closed from f/1.4 to f/8.

    Parameters
    ----------
    instrument : Instrument
        Instrument with a lens, a pixel pitch and an exposure time.
    fill_factor : float
        Light-sensitive fraction of a pixel's area (0.13: Henderson et al., JSSC 2019).

    Returns
    -------
    float
        LED photons that a pixel on the axis detects per exposure from a white plane at 1 m.

    Raises
    ------
    InstrumentError
        If the instrument has no lens, no pixel pitch or no exposure time.
    """
    sensor, lens = instrument.sensor, instrument.lens
    width_um, height_um = sensor.pixel_width_um, sensor.pixel_height_um
    if lens is None or width_um is None or height_um is None or sensor.exposure_ms is None:
        raise InstrumentError(
            f"instrument {instrument.name!r}: a radiometric estimate needs a lens, the pixel "
            "pitch and the exposure time; add those that its description leaves out"
        )
    detected_per_s = float(_power_w(instrument) @ mean_detection(instrument))
    area_m2 = width_um * height_um * 1e-12 * fill_factor
    collected = area_m2 * pi / (4 * lens.f_number**2)
    return detected_per_s * sensor.exposure_ms * 1e-3 * collected / pi**2


def _power_w(instrument: Instrument) -> NDArray[np.float64]:
    """Optical power of each band, W, shape (band,)."""
    return 1e-3 * np.array([band.power_mw for band in instrument.bands])
