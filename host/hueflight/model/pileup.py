"""First photons only: what a sensor that keeps one photon per exposure loses, and undoing it.

An exposure spans many periods. Whether a photon is kept depends on how many came before it:
over the whole exposure bright pixels seem darker than they are, and within a period late
pulses seem fainter than early ones (Coates, J. Phys. E 1, 878, 1968).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hueflight.model.instrument import Instrument

NEGLIGIBLE = 1e-3  #: photons per period below which the loss within it is not undone


def lost_photons_factor(
    hits: NDArray[np.float64], frames: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Photons that arrived per photon that was kept, where an exposure keeps only its first.

    The mean number that arrived in an exposure is −ln(1 − hits/frames). Where every exposure
    holds a photon it can't be known: NaN.
    """
    occupancy = np.divide(hits, frames, out=np.zeros_like(hits), where=frames > 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        factor = -np.log1p(-occupancy) / occupancy
    factor[occupancy == 0] = 1.0
    factor[~np.isfinite(factor)] = np.nan
    return factor


def photons_per_period(
    hits: NDArray[np.float64], frames: NDArray[np.float64] | None, instrument: Instrument
) -> NDArray[np.float64] | None:
    """Photons that reach a pixel in one period; None where it can't be known.

    Pixels with a photon in every exposure are taken to have had half an exposure without.
    """
    period_ns, exposure_ms = instrument.timing.period_ns, instrument.sensor.exposure_ms
    if frames is None or period_ns is None or exposure_ms is None:
        return None
    periods = exposure_ms * 1e6 / period_ns
    occupancy = np.minimum(hits, frames - 0.5) / frames
    return -np.log1p(-np.maximum(occupancy, 0)) / periods


def coates_correction(
    light: NDArray[np.floating], per_period: NDArray[np.floating] | None
) -> NDArray[np.floating]:
    """Counts (…, bin) as if early photons of a period had not kept later ones from being seen.

    Sums stay what they are. Where no pixel meets more than `NEGLIGIBLE` photons per period
    nothing is done.

    Parameters
    ----------
    light : (…, bin) counts in time order.
    per_period : (…) photons per period, as `photons_per_period` gives, or None.
    """
    if per_period is None or float(np.max(per_period, initial=0.0)) < NEGLIGIBLE:
        return light
    earlier = np.cumsum(light, axis=-1, dtype=np.float64)
    total = np.maximum(earlier[..., -1:], 1e-300)
    earlier = (earlier - 0.5 * light) / total
    rate = np.asarray(per_period)[..., None]
    # survival until a share F of the period's photons has come is exp(−rate·F); its mean 1−e^−r/r
    corrected = light * np.exp(rate * earlier)
    corrected *= total / np.maximum(corrected.sum(axis=-1, keepdims=True), 1e-300)
    return corrected.astype(light.dtype if light.dtype.kind == "f" else np.float32)
