# SPDX-License-Identifier: Apache-2.0
"""Joint and pooled methods on many kinds of instruments, against a model without project code."""

import numpy as np
import pytest
from scipy.stats import norm

import hueflight as hf
from hueflight.model.instrument import Band, Instrument, Sensor, Timing

ROWS, COLS = 12, 12
METERS_PER_NS = 0.299792458 / 2
#: ratio of the spacing of pulses to their width
RATIOS = (2.5, 8.0)
BANDS = (2, 3)


def camera(bands: int, ratio: float, direction: str) -> Instrument:
    """At least five bins to a pulse; the last bin may be partial."""
    spacing_ns = 320.0 / max(bands, 2)
    fwhm_ns = spacing_ns / ratio
    bin_ns = fwhm_ns / 5.3
    bits = int(np.ceil(np.log2(320.0 / bin_ns)))
    return Instrument(
        name="many",
        bands=tuple(
            Band(
                name=f"band {k}",
                wavelength_nm=420.0 + 10 * k,
                delay_ns=spacing_ns * k,
                pulse_fwhm_ns=fwhm_ns,
            )
            for k in range(bands)
        ),
        sensor=Sensor(
            rows=ROWS, cols=COLS, code_bits=bits, bin_width_ns=bin_ns, direction=direction
        ),
        timing=Timing(period_ns=320.0, latency_ns=spacing_ns / 3),
    )


def counts(instrument: Instrument, distance: float, photons: float, seed: int):
    """Gaussian pulses, integrated over every bin on the circle of the period."""
    sensor, period_ns = instrument.sensor, 320.0
    bins = int(np.ceil(period_ns / sensor.bin_width_ns - 1e-9))
    edges = np.minimum(np.arange(bins + 1) * sensor.bin_width_ns, period_ns)
    if sensor.direction == "reverse":
        edges = (period_ns - edges)[::-1]
    mean = 0.1 * photons * np.diff(edges) / period_ns
    for band in instrument.bands:
        center = band.delay_ns + instrument.timing.latency_ns + distance / METERS_PER_NS
        for turn in (-2, -1, 0, 1, 2):
            at = (edges - center - turn * period_ns) / (band.pulse_fwhm_ns / 2.354820045)
            mean = mean + photons * np.diff(norm.cdf(at))
    drawn = np.random.default_rng(seed).poisson(mean, (ROWS, COLS, bins))
    if sensor.direction == "reverse":
        drawn = drawn[..., ::-1]
    whole = np.zeros((ROWS, COLS, 2**sensor.code_bits), np.uint16)
    whole[..., :bins] = drawn
    return whole


@pytest.mark.parametrize("direction", ["forward", "reverse"])
@pytest.mark.parametrize("ratio", RATIOS)
@pytest.mark.parametrize("bands", BANDS)
def test_depth_is_as_good_as_it_says(bands, ratio, direction):
    instrument = camera(bands, ratio, direction)
    photons = max(400.0, 3000.0 / bands)
    step = 0.15 * instrument.bands[0].pulse_fwhm_ns * METERS_PER_NS
    calibration = hf.calibrate(counts(instrument, 1.0, 10 * photons, 1), instrument, distance=1.0)
    truth = 1.0 + step
    scene = counts(instrument, truth, photons, 2)
    for method in ("joint", "pooled"):
        image = hf.reconstruct(scene, calibration, method=method)
        score = (image["depth"].values - truth) / image["depth_std"].values
        known = np.isfinite(score)
        assert known.mean() > 0.98, method
        # 144 pixels: a root mean square above 1.3 has a probability of 2e-6 for normal scores,
        # pooled estimates depend on one another; a mean off by the noise of the calibration
        limit = 1.3 if method == "joint" else 1.6
        assert np.sqrt(np.mean(score[known] ** 2)) < limit, method
