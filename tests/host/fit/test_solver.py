# SPDX-License-Identifier: Apache-2.0
"""The compiled fit against its definition: the same results to single precision's rounding."""

import msgspec
import numpy as np
import pytest

import hueflight as hf
from hueflight.backend.fit import MOST_BANDS
from hueflight.errors import HueflightError
from hueflight.fit import change_detection
from hueflight.fit import reference as definition
from hueflight.fit.reference import FitOptions
from hueflight.fit.solver import change_reference, compiled_kernel, fit_pixels
from hueflight.reconstruction.joint import tables_for_calibration

compiled = pytest.mark.usefixtures("compiled_fit")


@pytest.fixture(scope="module")
def plans(small, draw):
    def with_tails(tail_ns: float):
        instrument = small(rows=12, cols=12)
        bands = tuple(msgspec.structs.replace(b, pulse_tail_ns=tail_ns) for b in instrument.bands)
        instrument = instrument.replace(bands=bands)
        reference = draw(instrument, photons=20_000)
        calibration = hf.calibrate(reference, instrument, distance=0.5)
        return instrument, tables_for_calibration(calibration, (-15.0, 15.0))

    return {tail_ns: with_tails(tail_ns) for tail_ns in (0.0, 6.0)}


def both(light, plan, monkeypatch, **options):
    offsets = np.zeros(len(light))
    monkeypatch.setenv("HUEFLIGHT_KERNELS", "c")
    fast = fit_pixels(light, offsets, plan, **options)
    return definition.fit(light, offsets, plan, options.get("options", definition.DEFAULT)), fast


@compiled
@pytest.mark.parametrize("tail_ns", [0.0, 6.0])
@pytest.mark.parametrize("photons", [20, 50, 620, 100_000])
@pytest.mark.parametrize("background", [0.0, 0.1, 1.0])
def test_same_results(plans, draw, monkeypatch, tail_ns, photons, background):
    instrument, plan = plans[tail_ns]
    counts = draw(
        instrument, depth=0.9, photons=photons, background=background * photons, frames=10**7
    )
    light = instrument.time_bins().in_time_order(counts).reshape(144, -1)
    slow, fast = both(light, plan, monkeypatch)
    deviation = slow.delay_std_ns
    # rounding may turn a decision (a step more, the other maximum) in a pixel or two
    for name, unit in {"delay_ns": deviation, "delay_std_ns": deviation}.items():
        apart = np.abs(getattr(slow, name) - getattr(fast, name)) / unit
        assert np.quantile(apart, 0.98) < 1e-3
    apart = np.abs(slow.amplitudes - fast.amplitudes) / slow.amplitude_std
    assert np.quantile(apart, 0.98) < 1e-3
    assert (slow.steps == fast.steps).mean() > 0.97
    assert (np.isfinite(slow.other_ns) == np.isfinite(fast.other_ns)).mean() > 0.97


def test_every_width_of_vectors_gives_the_same(plans, draw, monkeypatch, fit_build):
    lanes = {"_kernels_v4": 16, "_kernels_v3": 8, "_kernels": 4}
    assert lanes[fit_build.__name__.rpartition(".")[2]] == fit_build.LANES
    instrument, plan = plans[6.0]
    counts = draw(instrument, depth=0.9, photons=200, background=100)
    light = instrument.time_bins().in_time_order(counts).reshape(144, -1)
    slow, fast = both(light, plan, monkeypatch)
    apart = np.abs(slow.delay_ns - fast.delay_ns) / slow.delay_std_ns
    assert np.quantile(apart, 0.98) < 1e-3


@compiled
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.uint32, np.uint64, np.float32, float])
@pytest.mark.parametrize("reverse", [False, True])
@pytest.mark.parametrize("photons", [300, 20])  # the posterior reads the counts of few once more
def test_every_type_and_direction_of_counts(plans, draw, dtype, reverse, photons):
    instrument, plan = plans[0.0]
    counts = draw(instrument, depth=0.9, photons=photons)
    light = instrument.time_bins().in_time_order(counts).reshape(144, -1)
    expected = fit_pixels(np.ascontiguousarray(light, np.float32), np.zeros(144), plan)
    same = light.astype(dtype)
    if reverse:
        same = np.ascontiguousarray(same[:, ::-1])[:, ::-1]
    np.testing.assert_array_equal(fit_pixels(same, np.zeros(144), plan).delay_ns, expected.delay_ns)


@compiled
@pytest.mark.usefixtures("fit_build")
@pytest.mark.parametrize("dtype", [np.uint16, np.uint32, np.float32])
@pytest.mark.parametrize("step", [2, -2])
def test_counts_that_lie_apart(plans, draw, dtype, step):
    """Every second column of an array, as a slice of a larger one has it."""
    instrument, plan = plans[0.0]
    counts = draw(instrument, depth=0.9, photons=300)
    light = instrument.time_bins().in_time_order(counts).reshape(144, -1).astype(dtype)
    wide = np.full((144, 2 * light.shape[1]), 7, dtype)
    wide[:, ::step] = light
    expected = fit_pixels(np.ascontiguousarray(light), np.zeros(144), plan)
    found = fit_pixels(wide[:, ::step], np.zeros(144), plan)
    np.testing.assert_array_equal(found.delay_ns, expected.delay_ns)
    np.testing.assert_array_equal(found.amplitudes, expected.amplitudes)


@compiled
@pytest.mark.parametrize("dtype", [np.uint16, np.uint32, np.float32])
@pytest.mark.parametrize("reverse", [False, True])
def test_lost_photons_and_changes_of_every_type(plans, draw, dtype, reverse):
    """Among them a pixel without counts, and one in which hardly an exposure is empty."""
    instrument, plan = plans[0.0]
    counts = draw(instrument, depth=0.9, photons=300)
    light = instrument.time_bins().in_time_order(counts).reshape(144, -1)
    light[0] = 0
    rates, offsets = np.linspace(0.1, 2.0, 144), np.zeros(144)
    rates[1] = 100.0
    same = np.ascontiguousarray(light, dtype)
    if reverse:
        same = np.ascontiguousarray(same[:, ::-1])[:, ::-1]
    expected = fit_pixels(np.ascontiguousarray(light), offsets, plan, per_period=rates)
    found = fit_pixels(same, offsets, plan, per_period=rates)
    np.testing.assert_array_equal(found.delay_ns, expected.delay_ns)
    np.testing.assert_array_equal(found.amplitudes, expected.amplitudes)
    pixels = np.arange(1, 144)
    fitted = fit_pixels(light, offsets[1:], plan, pixels=pixels)
    references = [
        change_reference(given, pixels, fitted, offsets[1:], plan) for given in (light, same)
    ]
    for name in ("weights", "sums"):
        np.testing.assert_array_equal(*(getattr(one, name) for one in references))


@compiled
def test_threads_and_order_of_pixels_change_nothing(plans, draw):
    instrument, plan = plans[6.0]
    counts = draw(instrument, depth=0.9, photons=100, background=50)
    light = np.tile(instrument.time_bins().in_time_order(counts).reshape(144, -1), (40, 1))
    once = fit_pixels(light, np.zeros(len(light)), plan)
    shared = fit_pixels(light, np.zeros(len(light)), plan, threads=3)
    backwards = fit_pixels(light[::-1], np.zeros(len(light)), plan)
    for name in ("delay_ns", "delay_std_ns", "amplitudes", "background", "steps"):
        np.testing.assert_array_equal(getattr(once, name), getattr(shared, name))
        np.testing.assert_array_equal(getattr(once, name), getattr(backwards, name)[::-1])


@compiled
@pytest.mark.parametrize(
    "options",
    [
        FitOptions(wide_first=True),
        FitOptions(settle=False),
        FitOptions(posterior=False),
        FitOptions(target_ns=10.0),
    ],
)
def test_switches_mean_the_same(plans, draw, monkeypatch, options):
    instrument, plan = plans[6.0]
    counts = draw(instrument, depth=0.9, photons=100, background=50)
    light = instrument.time_bins().in_time_order(counts).reshape(144, -1)
    slow, fast = both(light, plan, monkeypatch, options=options)
    apart = np.abs(slow.delay_ns - fast.delay_ns) / slow.delay_std_ns
    assert np.quantile(apart, 0.98) < 1e-3


def test_without_the_compiled_fit(plans, draw, monkeypatch):
    instrument, plan = plans[0.0]
    counts = draw(instrument, depth=0.9, photons=300)
    light = instrument.time_bins().in_time_order(counts).reshape(144, -1)
    monkeypatch.setenv("HUEFLIGHT_KERNELS", "numpy")
    found = fit_pixels(light, np.zeros(144), plan)
    np.testing.assert_array_equal(
        found.delay_ns, definition.fit(light, np.zeros(144), plan).delay_ns
    )
    arguments = found, np.zeros(144), plan
    reference = change_reference(light, np.arange(144), *arguments)
    expected = change_detection.change_reference(light, *arguments)
    np.testing.assert_array_equal(reference.sums, expected.sums)


@compiled
@pytest.mark.parametrize("bands", [1, 2])
def test_few_bands_have_fewer_contrasts(small, draw, monkeypatch, bands):
    instrument = small(rows=4, cols=4)
    instrument = instrument.replace(bands=instrument.bands[:bands])
    calibration = hf.calibrate(draw(instrument, photons=20_000), instrument, distance=0.5)
    plan = tables_for_calibration(calibration, (-15.0, 15.0))
    assert len(plan.contrasts) == bands - 1
    counts = draw(instrument, depth=0.9, photons=2000, background=100)
    light = instrument.time_bins().in_time_order(counts).reshape(16, -1)
    slow, fast = both(light, plan, monkeypatch)
    for name in ("delay_ns", "chi_square", "misfit"):
        np.testing.assert_allclose(getattr(fast, name), getattr(slow, name), atol=2e-3)


def test_a_backend_that_does_not_exist(plans, monkeypatch):
    _, plan = plans[0.0]
    monkeypatch.setenv("HUEFLIGHT_KERNELS", "fortran")
    with pytest.raises(HueflightError, match="HUEFLIGHT_KERNELS = 'fortran'"):
        fit_pixels(np.ones((1, 499), np.uint16), np.zeros(1), plan)


@compiled
def test_more_bands_than_the_compiled_fit_has_room_for(monkeypatch):
    assert compiled_kernel(MOST_BANDS) is not None
    assert compiled_kernel(MOST_BANDS + 1) is None
    monkeypatch.setenv("HUEFLIGHT_KERNELS", "c")
    with pytest.raises(HueflightError, match=r"has room for 30 bands and there are 31: leave the"):
        compiled_kernel(MOST_BANDS + 1)


def test_light_that_does_not_fit_the_plan(plans):
    _, plan = plans[0.0]
    with pytest.raises(HueflightError, match=r"needs \(pixel, 499\)"):
        fit_pixels(np.ones((2, 500), np.uint16), np.zeros(2), plan)


@pytest.mark.parametrize("tail_ns", [0.0, 6.0])
@pytest.mark.parametrize("photons", [50, 200])
def test_few_delays_integrate_a_posterior_as_well_as_many(
    plans, draw, monkeypatch, tail_ns, photons
):
    instrument, plan = plans[tail_ns]
    counts = draw(instrument, depth=0.9, photons=photons, background=0.1 * photons, frames=10**7)
    light = instrument.time_bins().in_time_order(counts).reshape(144, -1)
    monkeypatch.setattr(definition, "POSTERIOR_PHOTONS", np.inf)
    few = definition.fit(light, np.zeros(144), plan)
    monkeypatch.setattr(definition, "NODES", 25)
    monkeypatch.setattr(definition, "NODE_SPACING", 0.4)
    many = definition.fit(light, np.zeros(144), plan)
    apart = np.abs(few.delay_ns - many.delay_ns) / many.delay_std_ns
    assert 0 < np.sqrt(np.mean(apart**2)) < 0.02
    assert np.abs(few.delay_std_ns / many.delay_std_ns - 1).mean() < 0.01


@pytest.mark.parametrize("tail_ns", [0.0, 6.0])
def test_from_some_photons_on_a_corrected_parabola_says_what_the_posterior_says(
    plans, draw, monkeypatch, tail_ns
):
    instrument, plan = plans[tail_ns]
    counts = draw(instrument, depth=0.9, photons=100, background=10, frames=10**7)
    light = instrument.time_bins().in_time_order(counts).reshape(144, -1)
    found = definition.fit(light, np.zeros(144), plan)
    monkeypatch.setattr(definition, "POSTERIOR_PHOTONS", np.inf)
    whole = definition.fit(light, np.zeros(144), plan)
    apart = np.abs(found.delay_ns - whole.delay_ns) / whole.delay_std_ns
    assert 0 < np.sqrt(np.mean(apart**2)) < 0.15  # adds no more than 2 % to the variance
    assert np.abs(found.delay_std_ns / whole.delay_std_ns - 1).mean() < 0.08
