# SPDX-License-Identifier: Apache-2.0
"""Images from sums: against the bound of the histogram, and what happens where sums can't tell."""

import weakref
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from scipy.stats import chi2

import hueflight as hf
from hueflight import backend
from hueflight.errors import HistogramError, HueflightError
from hueflight.model.instrument import SPEED_OF_LIGHT_M_PER_NS, Lens
from hueflight.reconstruction import Quality, SumsDesign, code_offsets, information_kept
from hueflight.reconstruction.bounds import expected_shares
from hueflight.reconstruction.sums.delay_tables import sum_tables
from hueflight.reconstruction.sums.estimator import (
    FLOOR_PHOTONS,
    FLOOR_SHARE,
    estimate_reference,
    search,
)
from hueflight.reconstruction.sums.kernels import estimate_pixels
from hueflight.reconstruction.sums.method import _exceeded
from hueflight_protocol.reduction import ReductionTables, reduce_histogram

DISTANCE = 1.5
SIDE = 48
RED = (0.05, 0.05, 0.05, 0.05, 0.1, 0.2, 0.6, 0.9, 0.9)
NS = SPEED_OF_LIGHT_M_PER_NS / 2  #: m of depth per ns of delay


@pytest.fixture(scope="module")
def instrument(small):
    return small("paper", rows=SIDE, cols=SIDE).replace(lens=None)


@pytest.fixture(scope="module")
def calibration(instrument, draw):
    counts = draw(instrument, depth=DISTANCE, photons=50_000)
    return hf.calibrate(counts, instrument, distance=DISTANCE)


@pytest.fixture(scope="module")
def design(calibration) -> SumsDesign:
    return hf.design_sums(calibration)


def sums_of(counts, design, offsets=None):
    flat = counts.reshape(-1, counts.shape[-1])
    each = None if offsets is None else offsets.ravel()
    return reduce_histogram(flat, design.tables, offsets=each).reshape(*counts.shape[:2], -1)


def seen(image, name="depth"):
    return image[name].values


@pytest.mark.parametrize(
    ("delay_ns", "background", "most"), [(1.7, 62, 1.08), (5.8, 62, 1.20), (5.8, 620, 1.5)]
)
def test_depth_is_nearly_as_good_as_from_the_histogram(
    instrument, calibration, draw, delay_ns, background, most
):
    depth = DISTANCE + delay_ns * NS
    counts = draw(
        instrument, depth=depth, photons=620, background=background, reflectance=RED, seed=2
    )
    image = hf.reconstruct(counts, calibration, method="sums")
    bound = hf.depth_bound(
        calibration, photons=620, reflectance=RED, background=background, depth=depth
    )
    error = seen(image) - depth
    # the root mean square of 2304 errors strays by 1.5 %: four of these, once in 3e4 tests
    assert np.sqrt(np.mean(error**2)) < most * bound * 1.06
    assert abs(error.mean()) < 0.2 * bound
    inside = np.mean(np.abs(error) < seen(image, "depth_std"))
    assert inside == pytest.approx(0.6827, abs=0.04)  # four standard errors
    assert image.attrs["method"] == "sums"


def test_reflectance_is_that_of_the_histogram(instrument, calibration, draw):
    counts = draw(instrument, depth=DISTANCE + 1.2 * NS, photons=620, background=62, seed=3)
    options = {"range_correction": False}
    image = hf.reconstruct(counts, calibration, method="sums", **options)
    joint = hf.reconstruct(counts, calibration, mixed=False, second_returns=False, **options)
    mean = seen(image, "reflectance").mean(axis=(0, 1)) / seen(joint, "reflectance").mean((0, 1))
    np.testing.assert_allclose(mean, 1, atol=0.01)
    spread = seen(image, "reflectance").std(axis=(0, 1)) / seen(joint, "reflectance").std((0, 1))
    assert spread.max() < 1.15
    assert spread.min() > 0.97
    stated = seen(image, "reflectance_std").mean(axis=(0, 1))
    np.testing.assert_allclose(stated / seen(image, "reflectance").std((0, 1)), 1, atol=0.08)
    assert np.nanmean(seen(image, "fit_chi_square")) == pytest.approx(1, abs=0.06)


def test_sums_never_know_more_than_the_histogram(calibration, design):
    for background in (62, 620):
        kept = information_kept(
            design, calibration, photons=620, background=background, reflectance=np.array(RED)
        )
        assert (kept >= 1 - 1e-9).all()
        assert kept.max() < 1.15
    codes = calibration.bins.codes
    entries = np.zeros((32, 512), np.uint16)
    entries[np.arange(codes.size) * 32 // codes.size, codes] = 1
    coarse = SumsDesign(ReductionTables(entries, (32,) * 32, int(codes.min()), int(codes.max())))
    worse = information_kept(coarse, calibration, photons=620, background=62)
    assert worse[0] > 1.1, "32 windows know less than 15 designed sums"


def test_compiled_and_numpy_estimates_agree(instrument, calibration, design, draw):
    if not backend.available("sums"):
        pytest.skip(backend.why_not("sums"))
    offsets = code_offsets(calibration) + np.arange(SIDE) % 3
    for photons, background in ((5, 5), (620, 62), (20_000, 100)):
        counts = draw(instrument, depth=DISTANCE, photons=photons, background=background, seed=5)
        sums = sums_of(counts, design, offsets).reshape(SIDE * SIDE, -1)[:1003]
        sums = sums[sums[:, 0] > 0].astype(np.float64)
        tables = sum_tables(calibration, design, offsets)
        number = np.searchsorted(tables.offsets, offsets.ravel()[: len(sums)])
        expected = estimate_reference(sums, number, tables)
        found = estimate_pixels(sums, number, tables)
        near = np.abs(found.delay_ns - expected.delay_ns) < 1e-3 * expected.delay_std_ns + 1e-4
        assert near.mean() > 0.99  # two lags may be equally near
        for name in ("delay_std_ns", "amplitudes", "amplitude_std", "dark_distance"):
            a, b = getattr(found, name)[near], getattr(expected, name)[near]
            np.testing.assert_allclose(a, b, rtol=2e-3, atol=2e-3 * np.sqrt(photons))


@pytest.mark.parametrize("delay_ns", [-3.1, 0.0, 5.6])
def test_the_estimate_is_that_of_least_squares_under_the_covariance_of_the_sums(
    calibration, design, delay_ns
):
    """Plain weighted least squares of the sums themselves, written from its textbook form."""
    bins, templates, entries = calibration.bins, calibration.templates, design.tables.entries
    entries = entries[:, bins.codes].astype(np.float64)
    flat = bins.widths_ns / bins.span_ns
    amplitudes = 300 * np.array(RED) * calibration.brightness / calibration.brightness.mean()
    counts = amplitudes @ templates.shares(bins.edges_ns, delay_ns) + 80 * flat
    sums = np.rint(entries @ np.random.default_rng(4).poisson(counts, (200, counts.size)).T).T
    tables = sum_tables(calibration, design, np.array([0]))
    found = estimate_reference(sums, np.zeros(200, np.intp), tables)
    phases = tables.phase_of(search(sums @ tables.whiten.T, tables))
    for n, phase in enumerate(phases):
        at_ns = tables.first_ns + tables.phase_ns * phase
        start = np.maximum((tables.separate[0, phase] @ tables.whiten @ sums[n])[:10], 0)
        start[9] = max(start[9], FLOOR_SHARE * sums[n, 0] + FLOOR_PHOTONS)
        shares = templates.shares(bins.edges_ns, at_ns)
        slope = start[:-1] @ templates.slopes(bins.edges_ns, at_ns)
        columns = entries @ np.vstack([slope, shares, flat]).T
        weight = np.linalg.inv((entries * (start @ np.vstack([shares, flat]))) @ entries.T)
        inverse = np.linalg.inv(columns.T @ weight @ columns)
        moved_ns, *light = inverse @ columns.T @ weight @ sums[n]
        deviations = np.sqrt(np.diag(inverse))
        left = sums[n] - columns @ [moved_ns, *light]
        assert found.delay_ns[n] == pytest.approx(at_ns + moved_ns, abs=1e-3 * deviations[0])
        assert found.delay_std_ns[n] == pytest.approx(deviations[0], rel=1e-4)
        ours = [*found.amplitudes[n], found.background[n]]
        np.testing.assert_allclose(ours, light, rtol=1e-3, atol=1e-2)
        np.testing.assert_allclose(found.amplitude_std[n], deviations[1:-1], rtol=1e-4)
        assert found.distance[n] == pytest.approx(left @ weight @ left, rel=1e-3)


def test_without_the_compiled_estimator(calibration, design, monkeypatch):
    tables = sum_tables(calibration, design, np.zeros((1, 1), np.intp))
    sums, number = np.full((3, design.tables.sums), 50.0), np.zeros(3, np.intp)
    monkeypatch.setenv("HUEFLIGHT_KERNELS", "numpy")
    found, expected = (
        estimate(sums, number, tables) for estimate in (estimate_pixels, estimate_reference)
    )
    np.testing.assert_array_equal(found.delay_ns, expected.delay_ns)
    np.testing.assert_array_equal(found.amplitudes, expected.amplitudes)


def test_one_band_has_few_sums(small, draw):
    single = small("paper", rows=12, cols=12).replace(lens=None)
    single = single.replace(bands=single.bands[4:5])
    reference = draw(single, depth=DISTANCE, photons=50_000)
    calibration = hf.calibrate(reference, single, distance=DISTANCE)
    counts = draw(single, depth=DISTANCE + NS, photons=300, background=50, seed=3)
    design = hf.design_sums(calibration, sums=4)
    image = hf.reconstruct_sums(sums_of(counts, design), design, calibration)
    error = seen(image) - DISTANCE - NS
    assert np.sqrt(np.mean(error**2)) < 2 * seen(image, "depth_std").mean()


def test_offsets_follow_the_depth(instrument, calibration, design, draw):
    far = DISTANCE + 25 * NS
    counts = draw(instrument, depth=far, photons=2000, background=100, seed=6)
    offsets = code_offsets(calibration, np.full((SIDE, SIDE), 24.0))
    image = hf.reconstruct_sums(sums_of(counts, design, offsets), design, calibration,
                                offsets=offsets, frames=1_000_000)  # fmt: skip
    assert (seen(image, "quality") & ~np.uint16(Quality.MISFIT) == 0).all()
    assert np.median(seen(image)) == pytest.approx(far, abs=0.005)
    assert image.attrs["exposures"] == "known"


def test_tables_of_ever_new_offsets_do_not_fill_the_memory(calibration, design):
    made = [weakref.ref(sum_tables(calibration, design, np.array([n]))) for n in range(6)]
    assert [one() is None for one in made] == [True, True, False, False, False, False]
    assert sum_tables(calibration, design, np.array([5])) is made[5]()


def test_a_surface_beyond_the_tables_has_no_depth(instrument, calibration, design, draw):
    counts = draw(instrument, depth=DISTANCE + 9.5 * NS, photons=2000, background=100, seed=6)
    image = hf.reconstruct_sums(sums_of(counts, design), design, calibration)
    assert (seen(image, "quality") != 0).mean() > 0.99
    assert image.attrs["exposures"].startswith("unknown")
    assert np.isnan(seen(image)).mean() > 0.99


def test_the_depth_range_moves_the_tables(instrument, calibration, draw):
    depth = DISTANCE + 20 * NS
    counts = draw(instrument, depth=depth, photons=2000, background=100, seed=7)
    near_far = (depth - 0.6, depth + 0.3)
    image = hf.reconstruct(counts, calibration, method="sums", depth_range=near_far)
    assert np.median(seen(image)) == pytest.approx(depth, abs=0.005)
    with pytest.raises(HueflightError, match="spans 9 m: sums tell depths within"):
        hf.reconstruct(counts, calibration, method="sums", depth_range=(1.0, 10.0))


def test_the_depth_range_holds_for_the_outermost_rays(small, draw):
    wide = small(rows=6, cols=6).replace(lens=Lens(focal_length_mm=0.07, f_number=1.4))
    counts = draw(wide, depth=DISTANCE, photons=50_000)
    calibration = hf.calibrate(counts, wide, distance=DISTANCE)
    near, far = DISTANCE + 3.0, DISTANCE + 3.6
    delayed = DISTANCE + (far - DISTANCE) / wide.ray_cosine()[0, 0]  # of a corner at the far end
    counts = draw(wide, depth=delayed, photons=2000, background=100, seed=7)
    image = hf.reconstruct(counts, calibration, method="sums", depth_range=(near, far))
    assert seen(image)[0, 0] == pytest.approx(far, abs=0.05)


def test_saturated_sums_have_no_result(instrument, calibration, draw):
    design = hf.design_sums(calibration, most_photons=300)
    counts = draw(instrument, depth=DISTANCE, photons=200, background=20, seed=8)
    counts[3] *= 40
    image = hf.reconstruct_sums(sums_of(counts, design), design, calibration)
    flagged = seen(image, "quality") & int(Quality.SATURATED) > 0
    assert flagged[3].all()
    assert flagged.sum() == SIDE
    assert np.isnan(seen(image)[3]).all()
    assert np.isfinite(seen(image)[4]).mean() > 0.99


def test_later_bands_are_not_dimmed_by_earlier_photons(calibration):
    """Counts by first photons of a period in closed form, not by the project's own correction."""
    instrument = calibration.instrument
    shares, _, widths = expected_shares(instrument, DISTANCE)
    arrived = instrument.band_brightness() / instrument.band_brightness().sum() @ shares
    arrived = 0.4 * (0.9 * arrived + 0.1 * widths)  # photons per period
    recorded = np.exp(-np.cumsum(arrived) + arrived) * -np.expm1(-arrived)
    counts = np.zeros(instrument.histogram_shape, np.uint32)
    counts[..., instrument.time_bins().codes] = np.rint(1e5 * recorded / recorded.sum())
    sensor = msgspec.structs.replace(instrument.sensor, exposure_ms=None)  # one period each
    single = instrument.replace(sensor=sensor)
    known = replace(calibration, instrument=single, frames=np.full((SIDE, SIDE), 1e6))
    frames = 1e5 / -np.expm1(-0.4)
    options = {"frames": frames, "range_correction": False}
    image = hf.reconstruct(counts, known, method="sums", **options)
    found = seen(image, "reflectance")[0, 0]
    # without the correction the last band is 30 % darker against the first
    np.testing.assert_allclose(found / found.mean(), 1, atol=0.03)


@pytest.mark.parametrize("freedom", [2, 4, 5, 14])
def test_probabilities_of_chi_square_are_those_of_scipy(freedom):
    distances = np.geomspace(0.01, 1200, 50)
    np.testing.assert_allclose(
        _exceeded(distances, freedom), chi2.sf(distances, freedom), rtol=1e-9, atol=1e-290
    )


def test_p_values_are_those_of_the_distance(instrument, calibration, draw):
    counts = draw(instrument, depth=DISTANCE, photons=620, background=62, seed=9)
    image = hf.reconstruct(counts, calibration, method="sums")
    expected = chi2.sf(4 * seen(image, "fit_chi_square"), 4)
    np.testing.assert_allclose(seen(image, "fit_p_value"), expected, rtol=1e-3, atol=1e-6)


def test_bad_input_is_refused(instrument, calibration, design, draw):
    counts = draw(instrument, depth=DISTANCE, photons=100)
    with pytest.raises(HistogramError, match=r"sums have shape \(48, 48, 14\)"):
        hf.reconstruct_sums(np.zeros((SIDE, SIDE, 14), int), design, calibration)
    with pytest.raises(HistogramError, match="frames = 0: must be above 0"):
        hf.reconstruct_sums(sums_of(counts, design), design, calibration, frames=0)
    with pytest.raises(HistogramError, match="not whole"):
        hf.reconstruct(counts + 0.25, calibration, method="sums")
    with pytest.raises(HueflightError, match="sums = 11: must be from 12"):
        hf.design_sums(calibration, sums=11)
    with pytest.raises(HueflightError, match="entry_bits = 13"):
        hf.design_sums(calibration, entry_bits=13)
    for photons in (0, 2**31):
        with pytest.raises(HueflightError, match=f"most_photons = {photons}: must be from 1 to"):
            hf.design_sums(calibration, most_photons=photons)
    entries = design.tables.entries[::-1]
    swapped = SumsDesign(ReductionTables(entries, (24,) * 15, 1, 511))
    with pytest.raises(HueflightError, match="first table of the design must count photons"):
        hf.reconstruct_sums(sums_of(counts, design), swapped, calibration)


def test_tables_for_few_bits_fit_a_white_surface_and_keep_its_information(
    instrument, calibration, draw
):
    widths, photons = (10,) * 4 + (9,) * 8, 310
    design = hf.design_sums(
        calibration, sums=12, entry_bits=3, most_photons=photons, most_widths=widths
    )
    assert all(w <= most for w, most in zip(design.tables.widths, widths, strict=True))
    assert design.tables.entry_bits <= 3
    counts = draw(instrument, depth=DISTANCE, photons=0.8 * photons)
    sums = sums_of(counts, design)
    assert (sums < design.tables.limits).all()
    assert (sums.max(axis=(0, 1)) > design.tables.limits // 8).all(), "bits are left unused"
    kept = information_kept(design, calibration, photons=620, background=62)
    assert kept[0] < 1.06
    assert kept[1:].max() < 1.15
    # no such tables are lost on a color or a depth that they were not made for
    rng = np.random.default_rng(8)
    for color in rng.uniform(0.1, 1.0, (9, calibration.templates.bands)):
        kept = information_kept(
            design, calibration, photons=620, background=62, reflectance=color,
            delay_ns=rng.uniform(-6, 6),
        )  # fmt: skip
        assert kept[0] < 1.15
        assert kept[1:].max() < 1.4
    with pytest.raises(HueflightError, match="at least 11 bits, to count 1100 photons"):
        hf.design_sums(calibration, sums=12, most_photons=1100, most_widths=widths)
    with pytest.raises(HueflightError, match="2 bits hold no sum of 310 photons"):
        hf.design_sums(calibration, sums=12, most_photons=310, most_widths=(10, *[2] * 11))
