# SPDX-License-Identifier: Apache-2.0
"""Two interleaved schedules, fitted together: far ranges, one-colour objects, precision."""

import dataclasses

import msgspec
import numpy as np
import pytest

import hueflight as hf
from hueflight.errors import CalibrationError, HistogramError
from hueflight.model.instrument import SPEED_OF_LIGHT_M_PER_NS
from hueflight.model.time_bins import TimeBins
from hueflight.reconstruction.bounds import bounds, depth_deviation, information
from hueflight.reconstruction.quality import Quality

#: delays in ns, deep red to violet, that together tell every LED from every other
FIRST = (18.75, 65.0, 247.5, 305.0, 100.0, 168.75, 280.0, 220.0, 125.0)
SECOND = (55.0, 178.75, 132.5, 275.0, 26.25, 312.5, 218.75, 80.0, 250.0)
COLOURS = {
    "white": (1, 1, 1, 1, 1, 1, 1, 1, 1),
    "red": (1, 1, 0.9, 0.5, 0.1, 0.05, 0.05, 0.05, 0.05),
    "green": (0.05, 0.05, 0.1, 0.3, 1, 0.7, 0.1, 0.05, 0.05),
    "blue": (0.03, 0.03, 0.03, 0.03, 0.05, 0.3, 1, 1, 0.8),
    "yellow": (1, 1, 1, 0.9, 0.6, 0.2, 0.05, 0.05, 0.05),
    **{f"only band {band}": tuple(np.eye(9)[band]) for band in range(9)},
}
CIRCLE = 320 * SPEED_OF_LIGHT_M_PER_NS / 2  # metres


def with_delays(instrument, delays_ns):
    bands = tuple(
        msgspec.structs.replace(band, delay_ns=delay)
        for band, delay in zip(instrument.bands, delays_ns, strict=True)
    )
    return instrument.replace(bands=bands)


@pytest.fixture(scope="module")
def instruments(small):
    return [with_delays(small(rows=12, cols=12), delays) for delays in (FIRST, SECOND)]


@pytest.fixture(scope="module")
def calibrations(instruments, draw):
    return [
        hf.calibrate(draw(one, photons=20_000, seed=index), one, distance=0.5)
        for index, one in enumerate(instruments)
    ]


def captures(instruments, draw, *, photons, background=0.0, seed=0, **scene):
    """One histogram of each schedule; photons are those of both together."""
    return [
        draw(
            one,
            photons=photons / len(instruments),
            background=background / len(instruments),
            seed=(seed, index),
            **scene,
        )
        for index, one in enumerate(instruments)
    ]


def mislocks(image, depth):
    """Pixels with a depth that is not within half the pulses' spacing, on the circle."""
    assert np.isnan(image.depth.values).mean() < 0.02  # without a detected return
    apart = np.abs((image.depth.values - depth + CIRCLE / 2) % CIRCLE - CIRCLE / 2)
    return apart >= 12.5 * SPEED_OF_LIGHT_M_PER_NS / 2


def test_far_objects_of_every_colour(instruments, calibrations, draw):
    # nine metres hold four pulses' spacings; the whole circle is searched by the slow test
    wrong = total = 0
    for seed, colour in enumerate(COLOURS.values()):
        depth = 1.0 + seed / 2
        histograms = captures(
            instruments, draw, depth=depth, photons=50, reflectance=colour, seed=seed
        )
        image = hf.reconstruct_interleaved(histograms, calibrations, depth_range=(0.2, 9.0))
        wrong += mislocks(image, depth).sum()
        total += image.depth.size
    # 2016 pixels; at a true rate of 0.02 % more than 4 come up by chance less than once in 10⁴
    assert wrong <= 4, f"{wrong} of {total}"


@pytest.mark.parametrize("pileup_correction", [True, False])
def test_sensors_that_do_not_report_empty_exposures(small, draw, pileup_correction):
    """Both schedules are taken to have been seen equally long; pile-up can't be corrected."""
    silent = [
        with_delays(small(rows=6, cols=6, code_zero="bin"), delays) for delays in (FIRST, SECOND)
    ]
    calibrations = [
        hf.calibrate(draw(one, photons=20_000, seed=index), one, distance=0.5)
        for index, one in enumerate(silent)
    ]
    histograms = captures(silent, draw, depth=0.9, photons=5000)
    image = hf.reconstruct_interleaved(
        histograms, calibrations, depth_range=(0.2, 3.0), pileup_correction=pileup_correction
    )
    # 36 pixels within 5 standard deviations: a false alarm in 1 of 50 000 runs
    assert (np.abs(image.depth - 0.9) < 5 * image.depth_std).all()
    assert (image.depth_std < 0.02).all()


def test_bins_too_wide_for_the_pulses(small, draw):
    """Counts are smoothed, and not assessed as Poisson counts would be."""
    sensor = {"rows": 6, "cols": 6, "code_bits": 7, "bin_width_ns": 2.568}
    coarse = [with_delays(small(**sensor), delays) for delays in (FIRST, SECOND)]
    calibrations = [
        hf.calibrate(draw(one, photons=20_000, seed=index), one, distance=0.5)
        for index, one in enumerate(coarse)
    ]
    histograms = captures(coarse, draw, depth=0.9, photons=5000)
    image = hf.reconstruct_interleaved(histograms, calibrations, depth_range=(0.2, 3.0))
    # 36 pixels within 5 standard deviations: a false alarm in 1 of 50 000 runs
    assert (np.abs(image.depth - 0.9) < 5 * image.depth_std).all()
    assert np.isnan(image.fit_chi_square).all()


def test_no_pixel_that_works_in_both(instruments, calibrations, draw):
    dead = np.zeros((12, 12), bool)
    dead[:6] = True
    halves = [
        dataclasses.replace(calibration, dead=half)
        for calibration, half in zip(calibrations, (dead, ~dead), strict=True)
    ]
    with pytest.raises(CalibrationError, match="no pixel is usable in all calibrations"):
        hf.reconstruct_interleaved(captures(instruments, draw, photons=500), halves)


@pytest.mark.slow
def test_whole_circle(instruments, calibrations, draw):
    wrong = {}
    for seed, (name, colour) in enumerate(COLOURS.items()):
        bad = [
            mislocks(
                hf.reconstruct_interleaved(
                    captures(
                        instruments, draw, depth=depth, photons=50, background=5,
                        reflectance=colour, seed=seed,
                    ),
                    calibrations,
                ),
                depth,
            )
            for depth in (0.3, 7.3, 20.0, 33.7, 47.6)
        ]  # fmt: skip
        wrong[name] = float(np.mean(bad))
    # 720 pixels a colour: 3 of them are more than 0.2 % by luck alone in less than 1 of 10⁴ runs
    # at a true rate of 0.01 %
    assert max(wrong.values()) < 0.004, wrong
    assert np.mean(list(wrong.values())) < 0.002, wrong


def test_one_colour_is_ambiguous_to_one_schedule_only(small, draw):
    """Two LEDs alike but in colour: which one a one-colour object answers, one schedule can't say.

    Its two depths are equally likely; both are kept and flagged. A second schedule settles it.
    """
    two = small(rows=8, cols=8)
    alike = tuple(msgspec.structs.replace(two.bands[0], name=name) for name in "ab")
    two = two.replace(bands=alike)
    schedules = [with_delays(two, delays) for delays in ((0.0, 45.0), (0.0, 75.0))]
    depth, other = 10.0, 10.0 + 45 * SPEED_OF_LIGHT_M_PER_NS / 2
    one_colour = (0.0, 1.0)
    alone, settled = schedules[:1] * 2, schedules
    images = []
    for pair in (alone, settled):
        references = [draw(one, photons=50_000, seed=i) for i, one in enumerate(pair)]
        calibrations = [
            hf.calibrate(counts, one, distance=0.5)
            for counts, one in zip(references, pair, strict=True)
        ]
        histograms = captures(pair, draw, depth=depth, photons=200, reflectance=one_colour)
        images.append(hf.reconstruct_interleaved(histograms, calibrations, depth_range=(0.2, 20)))
    fooled, sure = images
    ambiguous = (fooled.quality.values & Quality.AMBIGUOUS) != 0
    kept = np.sort([fooled.depth.values, fooled.other_depth.values], axis=0)
    assert ambiguous.mean() > 0.95
    np.testing.assert_allclose(kept[0][ambiguous], depth, atol=0.3)
    np.testing.assert_allclose(kept[1][ambiguous], other, atol=0.3)
    # a coin's toss for each of 64 pixels: outside 16 … 48 once in 10⁴ runs
    assert 16 <= mislocks(fooled, depth).sum() <= 48
    assert not mislocks(sure, depth).any()
    assert not (sure.quality.values & Quality.AMBIGUOUS).any()


def test_nothing_of_the_precision_is_lost(instruments, calibrations, draw):
    image = hf.reconstruct_interleaved(
        captures(instruments, draw, depth=1.7, photons=1000),
        calibrations,
        depth_range=(0.5, 3.0),
    )
    fisher = sum(information(one, photons=500, depth=1.7) for one in instruments)
    limit = depth_deviation(bounds(np.asarray(fisher), background=0)[0])
    spread = np.sqrt(np.mean((image.depth.values - 1.7) ** 2))
    # 144 pixels know their deviation to 6 %; beyond 1.3 once in 10⁵ runs
    assert 0.75 < spread / limit < 1.3
    assert np.median(image.depth_std) == pytest.approx(limit, rel=0.1)
    np.testing.assert_allclose(image.photons.mean(), 1000, rtol=0.02)


def test_shares_of_unequal_length(instruments, calibrations, draw):
    """Three quarters of the frames on the first schedule: reflectance stays what it was."""
    histograms = [
        draw(instruments[0], depth=0.5, photons=15_000, frames=750_000, seed=1),
        draw(instruments[1], depth=0.5, photons=5_000, frames=250_000, seed=2),
    ]
    image = hf.reconstruct_interleaved(histograms, calibrations, depth_range=(0.0, 2.0))
    np.testing.assert_allclose(image.reflectance.mean(("row", "col")), 1.0, atol=0.02)
    np.testing.assert_allclose(image.depth.mean(), 0.5, atol=2e-3)
    assert image.attrs["exposures"] == "known"


def test_a_capture_may_count_its_pixels_delays_from_elsewhere(instruments, calibrations, draw):
    first, second = calibrations
    bins = second.bins
    same = dataclasses.replace(
        second,
        pixel_delay_ns=second.pixel_delay_ns + 0.5,
        bins=TimeBins(bins.codes, bins.edges_ns + 0.5, bins.period_ns),
    )
    histograms = captures(instruments, draw, depth=1.7, photons=1000)
    there, here = (
        hf.reconstruct_interleaved(histograms, [first, other], depth_range=(0.5, 3.0))
        for other in (second, same)
    )
    np.testing.assert_allclose(there.depth, here.depth, atol=1e-4)


def test_bad_calls(small, instruments, calibrations, draw):
    histograms = captures(instruments, draw, photons=100)
    with pytest.raises(CalibrationError, match="2 histograms and 1 calibrations"):
        hf.reconstruct_interleaved(histograms, calibrations[:1])
    with pytest.raises(HistogramError, match="frames has 1 entries for 2 histograms"):
        hf.reconstruct_interleaved(histograms, calibrations, frames=[100])
    with pytest.raises(HistogramError, match=r"histograms\[1\] has shape"):
        hf.reconstruct_interleaved([histograms[0], histograms[1][:3]], calibrations)
    farther = dataclasses.replace(calibrations[1], distance=0.6)
    with pytest.raises(CalibrationError, match=r"calibrations\[1\].*reference distance"):
        hf.reconstruct_interleaved(histograms, [calibrations[0], farther])
    faster = dataclasses.replace(
        calibrations[1], instrument=small(rows=12, cols=12, frame_rate_hz=100)
    )
    with pytest.raises(CalibrationError, match="frame_rate_hz"):
        hf.reconstruct_interleaved(histograms, [calibrations[0], faster])
