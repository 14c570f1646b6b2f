# SPDX-License-Identifier: Apache-2.0
"""Numbers at their edges: no warning (they are errors here), no NaN without a flag, no nonsense.

Bad input that must be refused (NaN, infinities, negative counts) is in `test_bad_input`.
"""

import itertools
from fractions import Fraction

import msgspec
import numpy as np
import pytest

import hueflight as hf
from hueflight import backend
from hueflight.fit import reference as definition
from hueflight.fit.solver import fit_pixels
from hueflight.fit.tables import ScheduleView, make_tables, summed
from hueflight.model.waveforms import Templates
from hueflight.reconstruction.bounds import expected_shares
from hueflight.reconstruction.joint import tables_for_calibration
from hueflight.reconstruction.quality import Quality

ROWS, COLS = 4, 6
BACKENDS = ["numpy"] + (["c"] if backend.available("fit") else [])


@pytest.fixture(params=BACKENDS, autouse=True)
def backend(request, monkeypatch):
    monkeypatch.setenv("HUEFLIGHT_KERNELS", request.param)
    return request.param


@pytest.fixture(scope="module")
def rig(small, draw):
    """Makes a calibrated instrument whose bands are changed by some function."""
    made = {}

    def calibrated(change=None, name="paper", photons=20_000):
        if name not in made:
            instrument = small(rows=ROWS, cols=COLS)
            if change is not None:
                instrument = change(instrument)
            one_by_one = [
                draw(instrument, photons=photons, reflectance=led, seed=number)
                for number, led in enumerate(np.eye(len(instrument.bands)))
            ]
            reference = draw(instrument, photons=photons, seed=99)
            calibration = hf.calibrate(
                reference, instrument, distance=0.5, bands=np.stack(one_by_one)
            )
            made[name] = instrument, calibration
        return made[name]

    return calibrated


def sound(image) -> None:
    """Every missing number has a flag, every number that is there an uncertainty."""
    quality = image["quality"].values
    for name in ("depth", "depth_std"):
        values = image[name].values
        assert not np.isinf(values).any(), name
        assert (quality[np.isnan(values)] != 0).all(), name
    known = np.isfinite(image["depth"].values)
    assert (image["depth_std"].values[known] > 0).all()
    for name in ("reflectance", "reflectance_std"):
        values = image[name].values
        assert not np.isinf(values).any(), name
        assert (quality[np.isnan(values).any(axis=-1)] != 0).all(), name
    assert (image["reflectance_std"].values[known] > 0).all()


def empty(instrument, frames=1000) -> np.ndarray:
    histogram = np.zeros(instrument.histogram_shape, np.uint32)
    histogram[..., 0] = frames
    return histogram


def test_no_photon_at_all(rig):
    instrument, calibration = rig()
    image = hf.reconstruct(empty(instrument), calibration)
    sound(image)
    assert np.isnan(image["depth"]).all()
    assert (image["quality"].values & Quality.LOW_SIGNAL).all()


@pytest.mark.parametrize("code", [1, 2, 250, 498, 499])
def test_one_photon(rig, code):
    instrument, calibration = rig()
    counts = empty(instrument)
    counts[..., code] = 1
    image = hf.reconstruct(counts, calibration)
    sound(image)
    assert (image["photons"] == 1).all()


@pytest.mark.parametrize("band", range(9))
def test_light_in_one_band_only(rig, draw, band):
    instrument, calibration = rig()
    only = np.eye(9)[band]
    image = hf.reconstruct(draw(instrument, depth=0.6, photons=2000, reflectance=only), calibration)
    sound(image)
    off = (image["depth"].values - 0.6) / image["depth_std"].values
    assert np.abs(off).max() < 5  # 24 pixels: 1e-5
    strongest = image["reflectance"].values.mean(axis=(0, 1))
    assert strongest.argmax() == band
    assert np.abs(np.delete(strongest, band)).max() < 0.02 * strongest[band]


def test_everything_in_the_background(rig, draw):
    instrument, calibration = rig()
    counts = draw(instrument, photons=1e-9, background=5000)
    image = hf.reconstruct(counts, calibration)
    sound(image)
    shown = image["quality"].values == 0
    assert shown.sum() <= 2  # of 24 at a false-alarm rate of 1e-3: 2e-6 to be exceeded
    assert np.isnan(image["reflectance"].values[~shown]).all()
    assert image["background"].values.sum() * 498.44 == pytest.approx(5000 * 24, rel=0.15)


def test_saturated_counters(rig, draw):
    instrument, calibration = rig()
    counts = draw(instrument, photons=200_000).astype(np.uint16)
    counts[0, 0, 100] = 65535
    image = hf.reconstruct(counts, calibration)
    sound(image)
    assert image["quality"].values[0, 0] & Quality.SATURATED
    full = np.full(instrument.histogram_shape, 65535, np.uint16)
    image = hf.reconstruct(full, calibration)
    sound(image)
    assert (image["quality"].values & Quality.SATURATED).all()


def test_a_thousand_million_photons(rig, draw):
    instrument, calibration = rig()
    counts = draw(instrument, depth=0.6, photons=1e9, background=1e8, frames=2**32 - 1)
    image = hf.reconstruct(counts, calibration, pileup_correction=False)
    sound(image)
    # what is left is the calibration's own noise, which the image states
    off = (image["depth"].values - 0.6) / image["depth_std"].values
    assert np.abs(off).max() < 6
    assert np.abs(image["depth"].values - 0.6).max() < 3e-3
    level = image["reflectance"].values / image["reflectance"].values.mean()
    assert np.abs(level.mean(axis=(0, 1)) - 1).max() < 0.03


@pytest.mark.parametrize("contrast", [1e-6, 1e-4, 1e-2, 1.0])
def test_contrast_of_bands(rig, draw, contrast):
    instrument, calibration = rig()
    colour = np.where(np.arange(9) % 2, contrast, 1.0)
    counts = draw(instrument, depth=0.6, photons=1e6, reflectance=colour, frames=2**31)
    image = hf.reconstruct(counts, calibration)
    sound(image)
    found = image["reflectance"].values.mean(axis=(0, 1))
    found = found / found[0]
    # the templates are known to 1 part in some 1000, and feet of neighbours reach over
    assert np.abs(found - colour)[np.arange(9) != 0].max() < 0.02
    assert np.abs(image["depth"].values - 0.6).max() < 0.01


@pytest.mark.parametrize("turn", np.linspace(0, 1, 9)[:-1] + 0.013)
def test_anywhere_on_the_circle(rig, draw, turn):
    """The light moves around the whole period, across its end; the search goes with it."""
    instrument, calibration = rig()
    half_period = 320 * 0.299792458 / 2
    depth = 0.5 + turn * half_period
    image = hf.reconstruct(
        draw(instrument, depth=depth, photons=5000, background=500),
        calibration,
        depth_range=(depth - 1.4, depth + 1.7),
    )
    sound(image)
    off = (image["depth"].values - depth) / image["depth_std"].values
    assert np.abs(off).max() < 5  # 24 pixels: 1e-5
    assert np.abs(off.mean()) < 1.2


def crowded(plain, delays_ns, fwhm_ns):
    """Plan and light of bands whose pulses stand in one another's way."""
    bands = tuple(
        msgspec.structs.replace(band, delay_ns=delay, pulse_fwhm_ns=fwhm_ns, pulse_tail_ns=0.5)
        for band, delay in zip(plain.bands, delays_ns, strict=True)
    )
    instrument = plain.replace(bands=bands)
    bins = instrument.time_bins()
    middle_ns = np.linspace(0, 320, 1600, endpoint=False)  # of the splines' knots
    density = [
        sum(pulse.wrapped_density(middle_ns, 320.0) for pulse in instrument.pulses(band))
        for band in range(len(bands))
    ]
    templates = Templates.normalized(np.array(density), 320.0)
    plan = make_tables(
        [ScheduleView(bins, templates)],
        shortest_fwhm_ns=fwhm_ns,
        brightness=np.ones(len(bands)),
        search_ns=(-5.0, 5.0),
    )
    return plan, templates.shares(bins.edges_ns, 1.7), bins.widths_ns / bins.span_ns


@pytest.mark.parametrize(
    ("delays_ns", "fwhm_ns"),
    [
        (np.arange(9) * 30.0, 45.0),  # wider than their spacing
        (np.arange(9) * 12.0, 24.0),
        (np.array([0, 30, 60, 90, 90.01, 150, 180, 210, 240]), 10.0),  # two at once
        (np.array([0, 30, 60, 90, 90, 150, 180, 210, 240]), 10.0),  # not to be told apart
        (np.zeros(9), 10.0),  # none of them
    ],
)
def test_bands_that_hide_one_another(rig, delays_ns, fwhm_ns):
    """Their sum is known, their shares are not: the deviations say so, and nothing is wild."""
    instrument, _ = rig()
    plan, shares, widths = crowded(instrument, delays_ns, fwhm_ns)
    mean = 600 * shares.sum(axis=0) + 500 * widths
    light = np.random.default_rng(4).poisson(mean, (200, mean.size)).astype(np.float32)
    found = fit_pixels(light, np.zeros(200), plan)
    for name in ("delay_ns", "delay_std_ns", "amplitudes", "amplitude_std", "background"):
        assert np.isfinite(getattr(found, name)).all(), name
    off = (found.delay_ns - 1.7) / found.delay_std_ns
    assert np.abs(off).max() < 6
    assert np.abs(found.delay_ns).max() <= 5.001
    total = found.amplitudes.sum(axis=1) + found.background
    np.testing.assert_allclose(total, light.sum(axis=1), rtol=0.02)
    assert np.abs(found.amplitudes - 600).max() < 6 * found.amplitude_std.max()


@pytest.mark.parametrize("scale", [5e-324, 1e-310, 1e-40, 1e-20])
def test_denormal_weights(rig, draw, scale):
    """Counts may be weighted; weights that all but vanish are no photons, not a crash."""
    instrument, calibration = rig()
    counts = draw(instrument, photons=1000).astype(np.float64) * scale
    image = hf.reconstruct(counts, calibration, pileup_correction=False)
    sound(image)


def test_sums_are_exact():
    """Counts to 2²⁴ add up in single precision as whole numbers and fractions do."""
    rng = np.random.default_rng(0)
    counts = rng.integers(0, 2**15, (3, 499)).astype(np.float32)
    starts = np.arange(0, 499, 4)
    grouped = summed(counts.astype(np.float64), starts)
    exact = [
        [sum(Fraction(float(c)) for c in row[a:b]) for a, b in itertools.pairwise([*starts, 499])]
        for row in counts
    ]
    assert (grouped == np.array(exact, float)).all()


def test_fisher_sums_against_fractions(rig):
    """The weighted sums of the normal equations, against exact rational arithmetic."""
    _, calibration = rig()
    plan = tables_for_calibration(calibration, (-15.0, 15.0))
    shares = plan.fine.shares[len(plan.fine.shares) // 2]
    light = np.random.default_rng(1).poisson(3.0, shares.shape[1])
    exact = np.array(
        [
            float(sum(Fraction(float(s)) * int(n) for s, n in zip(row, light, strict=True)))
            for row in shares
        ]
    )
    double = shares.astype(np.float64) @ light
    single = shares @ light.astype(np.float32)
    np.testing.assert_allclose(double, exact, rtol=1e-13)
    # 499 roundings of 2⁻²⁴, of terms that are all positive
    np.testing.assert_allclose(single, exact, rtol=499 * 2.0**-24)


def test_order_of_pixels_changes_nothing(rig, draw):
    instrument, calibration = rig()
    counts = draw(instrument, depth=0.6, photons=800, background=80)
    plan = tables_for_calibration(calibration, (-15.0, 15.0))
    light = calibration.bins.in_time_order(counts).reshape(ROWS * COLS, -1).astype(np.float32)
    order = np.random.default_rng(2).permutation(len(light))
    plain = fit_pixels(light, np.zeros(len(light)), plan)
    mixed = fit_pixels(light[order], np.zeros(len(light)), plan)
    # matrix products of other sizes round their last bit otherwise
    np.testing.assert_allclose(mixed.delay_ns, plain.delay_ns[order], rtol=1e-9)
    np.testing.assert_allclose(mixed.amplitudes, plain.amplitudes[order], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("times", [2, 16, 1024])
def test_more_of_the_same_photons(rig, draw, times):
    """Every count times N: the same delay, amplitudes times N, deviations by √N less."""
    instrument, calibration = rig()
    plan = tables_for_calibration(calibration, (-15.0, 15.0))
    counts = draw(instrument, depth=0.6, photons=20_000, background=2000)
    light = calibration.bins.in_time_order(counts).reshape(ROWS * COLS, -1).astype(np.float32)
    once = fit_pixels(light, np.zeros(len(light)), plan)
    more = fit_pixels(light * times, np.zeros(len(light)), plan)
    deviation = once.delay_std_ns
    # scoring ends when a step is below a quarter of a deviation; the next would be far smaller
    assert np.abs(more.delay_ns - once.delay_ns).max() < 0.15 * deviation.max()
    np.testing.assert_allclose(more.amplitudes, once.amplitudes * times, rtol=0.01)
    np.testing.assert_allclose(more.delay_std_ns * np.sqrt(times), deviation, rtol=0.02)


def test_more_photons_never_make_it_worse(rig, draw):
    instrument, calibration = rig()
    errors, stated = [], []
    for photons in (30, 120, 480, 1920, 7680, 30_720):
        images = [
            hf.reconstruct(
                draw(instrument, depth=0.6, photons=photons, background=photons / 10, seed=seed),
                calibration,
            )
            for seed in range(4)
        ]
        depth = np.concatenate([image["depth"].values.ravel() for image in images])
        errors.append(np.sqrt(np.nanmean((depth - 0.6) ** 2)))
        stated.append(np.nanmedian([image["depth_std"].values for image in images]))
    assert (np.diff(stated) < 0).all()
    # each step halves it; 96 pixels know it to 7 %, so that a rise would be ten deviations off
    assert (np.diff(errors) < 0).all()


def test_no_more_steps_than_allowed(rig):
    """Noise that fits nothing: scoring ends at its cap."""
    _, calibration = rig()
    plan = tables_for_calibration(calibration, (-15.0, 15.0))
    rng = np.random.default_rng(3)
    light = rng.exponential(1.0, (200, 499)).astype(np.float32) ** 8
    found = fit_pixels(light, np.zeros(200), plan)
    assert found.steps.max() <= definition.MOST_STEPS
    for values in (found.delay_ns, found.delay_std_ns, found.amplitudes, found.background):
        assert np.isfinite(values).all()


@pytest.mark.usefixtures("compiled_fit")
@pytest.mark.parametrize("backend", ["c"], indirect=True)
def test_single_precision_is_enough(rig, draw, backend):
    """The compiled fit (single) against its definition (double): a thousandth of a deviation."""
    instrument, calibration = rig()
    plan = tables_for_calibration(calibration, (-15.0, 15.0))
    for photons in (100, 10_000, 10_000_000):
        counts = draw(instrument, depth=0.6, photons=photons, background=photons, frames=2**31)
        light = calibration.bins.in_time_order(counts).reshape(ROWS * COLS, -1)
        single = fit_pixels(light, np.zeros(len(light)), plan)
        double = definition.fit(light, np.zeros(len(light)), plan)
        apart = np.abs(single.delay_ns - double.delay_ns) / double.delay_std_ns
        assert np.quantile(apart, 0.9) < (1e-3 if photons < 1e6 else 0.02), photons
        apart = np.abs(single.amplitudes - double.amplitudes) / double.amplitude_std
        assert np.quantile(apart, 0.9) < (1e-3 if photons < 1e6 else 0.05), photons


def test_shares_add_up(rig):
    instrument, _ = rig()
    shares, slopes, widths = expected_shares(instrument, 7.3)
    np.testing.assert_allclose(shares.sum(axis=1), 1, atol=1e-12)
    np.testing.assert_allclose(slopes.sum(axis=1), 0, atol=1e-12)
    assert widths.sum() == pytest.approx(1, abs=1e-12)
