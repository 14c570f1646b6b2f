# SPDX-License-Identifier: Apache-2.0
"""Fits become results: the compiled conversion against its definition, and pixel by pixel."""

from dataclasses import replace

import numpy as np
import pytest

import hueflight as hf
from hueflight.fit.reference import no_fit
from hueflight.reconstruction.conversion import put_results
from hueflight.reconstruction.conversion_rules import Conversion
from hueflight.reconstruction.quality import Quality
from hueflight.reconstruction.result_planes import NUMBERS, empty_planes

pytestmark = pytest.mark.usefixtures("compiled_fit")

SHAPE = (9, 13)  #: more pixels than are converted together, and not a multiple of them
SEARCH_NS = (-15.0, 15.0)


@pytest.fixture(scope="module")
def calibration(small, draw):
    instrument = small(rows=SHAPE[0], cols=SHAPE[1])
    counts = draw(instrument, depth=0.4, photons=5000)
    counts[1, 2, 1:] = 0
    counts[3, 4, 1:] *= 30
    found = hf.calibrate(counts, instrument, distance=0.4)
    assert found.dead.any()
    return found


def drawn(rng, calibration, share=0.8):
    """Fits of all kinds of some pixels, and the photons and exposures of all."""
    chosen = (rng.random(SHAPE) < share) & calibration.usable
    size = int(chosen.sum())
    found = no_fit(size, calibration.brightness.size)
    found.delay_ns[:] = rng.choice([-15, -4, 0, 1, 14.9995], size) + rng.uniform(0, 1e-3, size)
    found.delay_std_ns[:] = rng.choice([0.01, 0.3, 8, np.nan], size, p=[0.4, 0.4, 0.1, 0.1])
    found.other_ns[:] = rng.choice([np.nan, 2.0], size)
    found.detection[:] = rng.choice([np.nan, 5, 27.7, 28.5, 31, 40, 1e4], size)
    found.chi_square[:] = rng.choice([np.nan, 0.9, 1.05, 1.3], size)
    found.misfit[:] = rng.choice([np.nan, -12, -1, 2.3, 5, 37.9, 50], size)
    kinds = rng.choice([-5, 0, 1e-6, 1, 40, 1e5], found.amplitudes.shape)
    found.amplitudes[:] = kinds * rng.uniform(0.5, 2, kinds.shape)
    found.amplitude_std[:] = np.sqrt(np.abs(found.amplitudes) + 1) * rng.uniform(0.5, 2)
    found.background[:] = rng.choice([-1, 0, 0.3, 1, 70, 1e5], size)
    frames = rng.choice([1.0, 100, 5000], SHAPE)
    photons = np.floor(frames * rng.choice([0, 1e-4, 0.3, 0.97, 0.996, 1, 1.2], SHAPE))
    return found, chosen, photons, frames


def converted(found, changed, chosen, photons, frames, conversion):
    planes = empty_planes(SHAPE, conversion.calibration.brightness.size)
    for array in (planes.numbers, planes.reflectances, planes.quality):
        array[...] = 77
    put_results(planes, found, changed, chosen, photons, frames, conversion)
    return planes


def assert_alike(compiled, defined):
    np.testing.assert_array_equal(compiled.quality, defined.quality)
    for number, name in enumerate(NUMBERS):
        # the noise of delays, and reflectances, have some numbers in single precision
        rtol = 2e-5 if name == "depth_std" else 1e-11
        np.testing.assert_allclose(
            compiled.numbers[number], defined.numbers[number], rtol=rtol, err_msg=name
        )
    np.testing.assert_allclose(compiled.reflectances, defined.reflectances, rtol=1e-5)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("pileup_correction", [True, False])
@pytest.mark.parametrize("range_correction", [True, False])
@pytest.mark.parametrize("exposures", ["known", "of the reference", "unknown"])
def test_the_compiled_conversion_is_the_defined_one(
    calibration, monkeypatch, seed, pileup_correction, range_correction, exposures
):
    rng = np.random.default_rng(seed)
    # all pixels fitted: whole groups whose fits follow one another are read as they are
    found, chosen, photons, frames = drawn(rng, calibration, share=1.0 if seed == 1 else 0.8)
    if exposures != "known":
        frames = None
    if exposures == "unknown":
        calibration = replace(calibration, frames=None)
    conversion = Conversion(calibration, SEARCH_NS, range_correction, pileup_correction)
    changed = chosen | (rng.random(SHAPE) < 0.5)
    if seed < 2:
        changed[:] = True
    both = []
    for kernels in ("c", "numpy"):
        monkeypatch.setenv("HUEFLIGHT_KERNELS", kernels)
        both.append(converted(found, changed, chosen, photons, frames, conversion))
    assert_alike(*both)
    compiled = both[0]
    assert (compiled.numbers[:, ~changed] == 77).all()
    assert (compiled.quality[~changed] == 77).all()
    assert (compiled.reflectances[:, ~changed] == 77).all()
    assert np.isnan(compiled.reflectances[:, changed & ~chosen]).all()
    seen = np.bitwise_or.reduce(compiled.quality[changed])
    for flag in (Quality.NO_RETURN, Quality.OUT_OF_RANGE, Quality.AMBIGUOUS_LAG, Quality.MISFIT):
        assert seen & flag, flag


def test_drawn_numbers_reach_every_rule(calibration, monkeypatch):
    monkeypatch.setenv("HUEFLIGHT_KERNELS", "numpy")
    conversion = Conversion(calibration, SEARCH_NS, True, True)
    everywhere = np.ones(SHAPE, bool)
    found, chosen, photons, frames = drawn(np.random.default_rng(1), calibration)
    planes = converted(found, everywhere, chosen, photons, frames, conversion)
    seen = np.bitwise_or.reduce(planes.quality.ravel())
    for flag in (Quality.DEAD, Quality.LOW_SIGNAL, Quality.SATURATED, Quality.PILED_UP):
        assert seen & flag, flag
    assert np.isfinite(planes.numbers[0]).sum() > 10


def test_a_misfit_that_all_have_widens_deviations(calibration):
    conversion = Conversion(calibration, SEARCH_NS, False, True)
    found, chosen, photons, frames = drawn(np.random.default_rng(2), calibration)
    results = []
    for chi_square in (1.0, 4.0):
        found.chi_square[:] = chi_square
        planes = converted(found, chosen, chosen, photons, frames, conversion)
        results.append(planes.reflectances[1][chosen])
    told = np.isfinite(results[0])
    assert told.any()
    ratio = results[1][told] / results[0][told]
    assert ratio.max() == pytest.approx(2.0, rel=1e-3)  # but for what does not come from photons
