# SPDX-License-Identifier: Apache-2.0
"""All methods on many kinds of instruments, against a model without project code.

By default a sample; with ``--full`` 1 to 30 bands, each ratio, both directions.
"""

from itertools import product

import numpy as np
import pytest
from scipy.stats import norm

import hueflight as hf
from hueflight.errors import CalibrationError, OverlappingBandsError
from hueflight.model.instrument import Band, Instrument, Sensor, Timing

ROWS, COLS = 12, 12
METERS_PER_NS = 0.299792458 / 2
#: ratios of the spacing of pulses to their width; at the first, pulses overlap widely
RATIOS = (1.5, 2.5, 4.0, 8.0, 16.0)
DIRECTIONS = ("forward", "reverse")
SAMPLE = {
    *product((2, 3), (2.5, 8.0), DIRECTIONS),
    (1, 4.0, "reverse"), (3, 1.5, "forward"), (9, 2.5, "forward"), (16, 16.0, "reverse"),
}  # fmt: skip
EVERYTHING = [
    case if case in SAMPLE else pytest.param(*case, marks=pytest.mark.slow)
    for case in product(range(1, 31), RATIOS, DIRECTIONS)
    # where pulses overlap so widely, one reference can't tell all of many bands apart
    if case[1] > 1.5 or case[0] <= 6
]
#: largest root mean square of (depth - truth) / deviation over 144 pixels: 1.3 has a probability of
#: 2e-6 for independent normal scores; pooled estimates depend on one another
LIMITS = {"joint": 1.3, "pooled": 1.6, "paper": 1.3}


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


def counts(
    instrument: Instrument, distance: float, photons: float, seed: int, background: float = 0.1
):
    """Gaussian pulses, integrated over every bin on the circle of the period."""
    sensor, period_ns = instrument.sensor, 320.0
    bins = int(np.ceil(period_ns / sensor.bin_width_ns - 1e-9))
    edges = np.minimum(np.arange(bins + 1) * sensor.bin_width_ns, period_ns)
    if sensor.direction == "reverse":
        edges = (period_ns - edges)[::-1]
    mean = background * photons * np.diff(edges) / period_ns
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


@pytest.mark.parametrize(("bands", "ratio", "direction"), EVERYTHING)
def test_depth_is_as_good_as_it_says(bands, ratio, direction):
    instrument = camera(bands, ratio, direction)
    photons = max(400.0, 3000.0 / bands)
    step = 0.15 * instrument.bands[0].pulse_fwhm_ns * METERS_PER_NS
    reference = counts(instrument, 1.0, 10 * photons, 1)
    try:
        calibration = hf.calibrate(reference, instrument, distance=1.0)
    except CalibrationError:
        # a single pulse of two thirds of the period can't be told from the background
        assert ratio == 1.5
        assert bands == 1
        return
    truth = 1.0 + step
    scene = counts(instrument, truth, photons, 2)
    for method, limit in LIMITS.items():
        image = hf.reconstruct(scene, calibration, method=method)
        score = (image["depth"].values - truth) / image["depth_std"].values
        known = np.isfinite(score)
        assert known.mean() > 0.98, method
        assert np.sqrt(np.mean(score[known] ** 2)) < limit, method


@pytest.mark.parametrize("ratio", [2.5, 8.0])
@pytest.mark.parametrize("far", [-1.0, 0.15, 1.0])
def test_the_published_method_states_what_its_correlation_errs(ratio, far):
    """Background draws the centroid of a linear correlation to lag 0."""
    instrument = camera(9, ratio, "reverse")
    step = far * min(instrument.bands[0].pulse_fwhm_ns, 10.0) * METERS_PER_NS
    calibration = hf.calibrate(counts(instrument, 3.0, 10_000, 1), instrument, distance=3.0)
    for background in (0.0, 50.0):
        scene = counts(instrument, 3.0 + step, 1000.0, 2, background=background)
        image = hf.reconstruct(scene, calibration, method="paper")
        score = ((image["depth"] - 3.0 - step) / image["depth_std"]).values
        known = np.isfinite(score)
        assert known.mean() > 0.98
        assert np.sqrt(np.mean(score[known] ** 2)) < LIMITS["paper"], background
        if background == 0:  # nor is it so wide that it says nothing
            assert np.median(image["depth_std"]) < 0.3 * instrument.bands[0].pulse_fwhm_ns


@pytest.mark.parametrize(("bands", "direction"), [(3, "forward"), (9, "reverse"), (12, "forward")])
def test_bands_that_overlap_widely_have_equal_brightness_and_reflectance(bands, direction):
    """Of one reference and a scene of half its light, with 10⁴ photons per band and pixel."""
    instrument = camera(bands, 1.5, direction)
    calibration = hf.calibrate(counts(instrument, 1.0, 10_000, 1), instrument, distance=1.0)
    relative = calibration.brightness / calibration.brightness.mean()
    np.testing.assert_allclose(relative, 1.0, atol=0.05)
    image = hf.reconstruct(counts(instrument, 1.0, 5_000, 2), calibration)
    found = image["reflectance"].median(("row", "col"))
    np.testing.assert_allclose(found, 0.5, atol=0.05)


def test_bands_that_overlap_too_widely_have_an_error_of_their_own():
    instrument = camera(2, 1.5, "forward")
    with pytest.raises(OverlappingBandsError, match=r"band 'band 0' .* is known to \d+% only"):
        hf.calibrate(counts(instrument, 1.0, 300, 1), instrument, distance=1.0)


def test_bands_that_overlap_too_widely_are_told_apart_by_captures_of_each():
    instrument = camera(2, 1.5, "forward")
    alone = [
        Instrument(name="one", bands=(band,), sensor=instrument.sensor, timing=instrument.timing)
        for band in instrument.bands
    ]
    calibration = hf.calibrate(
        counts(instrument, 1.0, 300, 1),
        instrument,
        distance=1.0,
        bands=[counts(one, 1.0, 300, 3 + k) for k, one in enumerate(alone)],
    )
    assert calibration.brightness[0] == pytest.approx(calibration.brightness[1], rel=0.2)


@pytest.mark.parametrize("dark", range(4))
@pytest.mark.parametrize("background", [0.0, 0.1])
def test_reference_without_one_of_the_leds(dark, background):
    """Equally spaced bands may be mistaken for one another, but none is calibrated as lit."""
    whole = camera(4, 8.0, "forward")
    lit = tuple(band for number, band in enumerate(whole.bands) if number != dark)
    shown = Instrument(name="three", bands=lit, sensor=whole.sensor, timing=whole.timing)
    with pytest.raises(CalibrationError, match="no light of band"):
        hf.calibrate(counts(shown, 1.0, 10_000, 1, background), whole, distance=1.0)
