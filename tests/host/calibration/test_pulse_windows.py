# SPDX-License-Identifier: Apache-2.0
import itertools
import re

import msgspec
import numpy as np
import pytest

import hueflight as hf
from hueflight import simulator
from hueflight.calibration import PulseWindow, window_sums
from hueflight.calibration.pulse_windows import expected_train, find_windows
from hueflight.errors import CalibrationError
from hueflight.model.pulses import Pulse


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


def test_centimeters_for_meters(small, draw):
    instrument = small()
    counts = draw(instrument, depth=0.4, photons=5000)
    for wrong in (40.0, 400.0):
        with pytest.raises(CalibrationError, match=r"in meters: .* give 0\.4"):
            hf.calibrate(counts, instrument, distance=wrong)
    assert hf.calibrate(counts, instrument, distance=0.4).distance == 0.4


def test_fixed_reflection_stronger_than_the_target(small):
    """A cover glass at 2 ns, the target where the description expects it, at 8.7 ns."""
    plain = small("paper", rows=8, cols=8)
    sensor = msgspec.structs.replace(
        plain.sensor, code_bits=6, bin_width_ns=0.6, direction="forward", code_zero="bin"
    )
    band = msgspec.structs.replace(
        plain.bands[0], delay_ns=2.0, pulse_fwhm_ns=1.5, pulse_tail_ns=0.0
    )
    timing = msgspec.structs.replace(plain.timing, period_ns=None, latency_ns=0.0)
    instrument = plain.replace(sensor=sensor, bands=(band,), timing=timing)
    edges = instrument.time_bins().edges_ns

    def counts(reflection):
        target = Pulse(2.0 + 2 * 1.0 / 0.299792458, 1.5 / 2.355, 0.0).share(edges, None)
        glass = Pulse(2.1, 1.5 / 2.355, 0.0).share(edges, None)
        mean = 2000 * target + reflection * glass + 2
        return np.random.default_rng(1).poisson(mean, instrument.histogram_shape)

    with pytest.raises(CalibrationError, match=r"due, the first at 8\.7 ns.*a fixed reflection"):
        hf.calibrate(counts(3000), instrument, distance=1.0)
    for weak in (1000, 400, 60, 10):
        with pytest.raises(CalibrationError, match="fixed reflection") as caught:
            hf.calibrate(counts(weak), instrument, distance=1.0)
        share = float(re.search(r"camera itself, ([\d.]+)%", str(caught.value)).group(1))
        assert share == pytest.approx(weak / 20, rel=0.1)
    hf.calibrate(counts(0), instrument, distance=1.0)


@pytest.mark.parametrize("share", [0.05, 0.3, 1.0, 3.0])
def test_fixed_reflection_with_the_jitter_of_a_detector(small, share):
    """Pulses wider than described, captured with uneven bins."""
    plain = small("paper", rows=8, cols=8)
    sensor = msgspec.structs.replace(plain.sensor, code_bits=7, bin_width_ns=0.3)
    bands = tuple(
        msgspec.structs.replace(band, delay_ns=delay_ns, pulse_fwhm_ns=1.5, pulse_tail_ns=0.0)
        for band, delay_ns in zip(plain.bands, (2.0, 18.0), strict=False)
    )
    timing = msgspec.structs.replace(plain.timing, period_ns=38.1, latency_ns=0.0)
    instrument = plain.replace(sensor=sensor, bands=bands, timing=timing)

    def reference(reflection):
        effects = simulator.Effects(reflection=reflection)
        settings = simulator.SimulationSettings(
            white_detections=0.05, ambient=0.005, effects=effects
        )
        return simulator.simulate_capture(
            "reference", instrument, frames=100_000, settings=settings, distance=1.0
        )

    with pytest.raises(CalibrationError, match="fixed reflection"):
        hf.calibrate(reference(share), instrument, distance=1.0)
    hf.calibrate(reference(0.0), instrument, distance=1.0)


def test_background_is_no_fixed_reflection(small):
    """Of 400 references with background as bright as the target none is refused."""
    instrument = small()
    bins = instrument.time_bins()
    flat = bins.widths_ns / bins.span_ns
    for depth in (1.0, 3.0):
        light = instrument.band_brightness() @ expected_train(instrument, bins, distance=depth)
        for photons in (3e4, 3e6):
            mean = photons * (light / light.sum() + flat)
            for seed in range(100):
                pooled = np.random.default_rng(seed).poisson(mean).astype(float)
                assert len(find_windows(pooled, instrument, bins, distance=depth)) == 9


def test_wings_of_pulses_are_no_fixed_reflection():
    """Fine codes and a far target: one of nine reflections would stand free of other pulses."""
    instrument = hf.Instrument.load("fine")
    settings = simulator.SimulationSettings.ideal(white_detections=5e-4)
    for distance in (0.7, 1.0, 1.3):
        plane = simulator.scene("plane", instrument, distance=distance)
        rate = simulator.expected_rates(plane, instrument, settings).detections().mean()
        counts = simulator.simulate_histogram(
            plane, instrument, frames=int(5e5 / rate), settings=settings, seed=1
        )
        assert len(hf.calibrate(counts, instrument, distance=distance).windows) == 9


def test_equally_spaced_pulses_with_another_latency(small, draw):
    """Pulses of other bands stand where those of a band are due."""
    instrument = with_bands(
        small(), tuple(np.arange(10) * 32.0), pulse_fwhm_ns=8.0, pulse_tail_ns=0.0
    )
    brightness = np.linspace(1, 2, 10)
    late = instrument.replace(timing=msgspec.structs.replace(instrument.timing, latency_ns=57.0))
    reference = draw(late, photons=20_000, reflectance=brightness)
    calibration = hf.calibrate(reference, instrument, distance=0.5)
    assert len(calibration.windows) == 10
