import itertools

import msgspec
import numpy as np
import pytest

import hueflight as hf
from hueflight.calibration import PulseWindow, window_sums


def with_bands(instrument, delays_ns, **changes):
    """The instrument with as many bands as delays are given (a tuple for a coded band)."""
    template = instrument.bands[0]
    bands = tuple(
        msgspec.structs.replace(
            template, name=f"band {k}", wavelength_nm=400.0 + 20 * k, delay_ns=delay, **changes
        )
        for k, delay in enumerate(delays_ns)
    )
    return instrument.replace(bands=bands)


@pytest.mark.parametrize(
    "delays_ns",
    [
        (0.0,),
        (0.0, 100.0),
        (0.0, 70.0, 40.0),
        tuple(np.arange(9) * 30.0),
        (18.75, 65.0, 247.5, 270.0, 100.0, 168.75, 300.0, 220.0, 125.0),
        ((0.0, 90.0), (40.0, 190.0)),
    ],
)
def test_each_window_holds_its_own_pulse(small, draw, delays_ns):
    instrument = with_bands(small(), delays_ns, pulse_fwhm_ns=8.0)
    calibration = hf.calibrate(draw(instrument, photons=20_000), instrument, distance=0.5)
    bins = calibration.bins
    for band in range(len(instrument.bands)):
        alone = draw(instrument, photons=5000, reflectance=np.arange(len(delays_ns)) == band)
        light = bins.in_time_order(alone).reshape(-1, bins.count)
        sums = window_sums(
            light,
            calibration.windows,
            np.zeros(len(light), np.intp),
            bands=len(delays_ns),
            circular=True,
        ).sum(axis=1)
        assert sums[band] > 0.95 * light.sum()


def test_windows_do_not_overlap(small, draw):
    instrument = small()
    calibration = hf.calibrate(draw(instrument, photons=20_000), instrument, distance=0.5)
    ordered = sorted(calibration.windows, key=lambda window: window.start)
    assert all(a.stop <= b.start for a, b in itertools.pairwise(ordered))


def test_a_window_that_wraps_the_period_counts_both_ends():
    counts = np.arange(10.0)[None]
    window = (PulseWindow(0, 8, 12),)
    assert window_sums(counts, window, np.array([0]), bands=1, circular=True)[0, 0] == 8 + 9 + 0 + 1
    assert window_sums(counts, window, np.array([1]), bands=1, circular=True)[0, 0] == 9 + 0 + 1 + 2
    assert window_sums(counts, window, np.array([0]), bands=1, circular=False)[0, 0] == 8 + 9


def test_reference_with_a_pulse_across_the_end_of_the_period(small, draw):
    instrument = with_bands(small(), (0.0, 290.0), pulse_fwhm_ns=8.0)  # 290 + 25 + 3 ns of flight
    calibration = hf.calibrate(draw(instrument, photons=20_000), instrument, distance=0.5)
    wrapping = next(window for window in calibration.windows if window.band == 1)
    assert wrapping.start < calibration.bins.count < wrapping.stop or wrapping.start < 0
    image = hf.reconstruct(draw(instrument, depth=0.5, photons=5000), calibration, method="paper")
    assert float(image.reflectance[..., 1].mean()) == pytest.approx(0.25, rel=0.05)


def test_latency_that_differs_from_the_instrument_file(small, draw):
    instrument = small()
    late = instrument.replace(timing=msgspec.structs.replace(instrument.timing, latency_ns=58.0))
    calibration = hf.calibrate(draw(late, photons=20_000), instrument, distance=0.5)
    counts = draw(late, depth=0.9, photons=5000)
    image = hf.reconstruct(counts, calibration, method="paper", range_correction=False)
    assert float(image.depth.mean()) == pytest.approx(0.9, abs=0.02)
    assert image.reflectance.mean(("row", "col")).values == pytest.approx(0.25, rel=0.05)
