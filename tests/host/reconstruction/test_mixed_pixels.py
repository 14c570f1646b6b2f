# SPDX-License-Identifier: Apache-2.0
"""Pixels at edges: flagged where their depth lies between two surfaces, and only there.

Pixels see a disc in front of a wall, or a tilted plane, by 8 × 8 rays each, in a model that shares
no code with the simulator: photons are drawn from the instrument's pulses themselves.
"""

from __future__ import annotations

from dataclasses import replace

import msgspec
import numpy as np
import pytest

import hueflight as hf
from hueflight.analysis import reliable, stack
from hueflight.errors import ImageError
from hueflight.model.spectra import band_weights, reflectance
from hueflight.reconstruction import expected_shares, find_mixed
from hueflight.reconstruction.edges import neighbors

ROWS, COLS, RAYS = 48, 64, 8
PHOTONS, BACKGROUND = 620, 62


@pytest.fixture(scope="module")
def calibrated(draw):
    """Instrument, calibration and the angle between the pixels of its lens."""
    instrument = hf.Instrument.load("paper")
    sensor = msgspec.structs.replace(instrument.sensor, rows=ROWS, cols=COLS)
    instrument = instrument.replace(sensor=sensor)
    right, _ = instrument.ray_slopes()
    flat = instrument.replace(lens=None)  # all rays meet a wall at the same distance
    one_by_one = np.stack(
        [
            draw(flat, photons=600, depth=1, reflectance=led, seed=number)
            for number, led in enumerate(np.eye(9))
        ]
    )
    reference = draw(flat, photons=3000, depth=1, seed=20)
    calibration = hf.calibrate(reference, flat, distance=1, bands=one_by_one)
    return flat, calibration, float(right[0, 1] - right[0, 0])


def waveform(instrument, depth, surface=1.0):
    """Expected counts per bin of a surface, without background."""
    shares, _, _ = expected_shares(instrument, depth)
    light = instrument.band_brightness() * (band_weights(instrument) @ reflectance(surface))
    return PHOTONS * (light / light.sum()) @ shares


def drawn(instrument, mean, seed):
    """Counts (row, col, code) from expected counts (row, col, bin) of the signal."""
    bins = instrument.time_bins()
    mean = mean + BACKGROUND * bins.widths_ns / bins.span_ns
    counts = np.zeros(instrument.histogram_shape, np.uint32)
    counts[..., bins.codes] = np.random.default_rng(seed).poisson(mean)
    if instrument.sensor.reports_empty:
        counts[..., 0] = 1_000_000 - counts.sum(axis=-1)
    return counts


def disc_share(seed):
    """Share of each pixel's rays that meet a disc whose center is nowhere special."""
    row, col = np.random.default_rng(seed).uniform(-0.5, 0.5, 2)
    y = (np.arange(ROWS * RAYS) + 0.5) / RAYS - ROWS / 2 - row
    x = (np.arange(COLS * RAYS) + 0.5) / RAYS - COLS / 2 - col
    hit = y[:, None] ** 2 + x**2 < 18**2
    return hit.reshape(ROWS, RAYS, COLS, RAYS).mean(axis=(1, 3))


def disc_image(calibrated, share, step, surfaces, seed, **options):
    instrument, calibration, angle = calibrated
    near = waveform(instrument, 1.0, surfaces[0])
    far = waveform(instrument, 1.0 + step, surfaces[1])
    mean = share[..., None] * near + (1 - share[..., None]) * far
    # of large steps, many pixels show both surfaces by their own counts
    counts = drawn(instrument, mean, seed)
    image = hf.reconstruct(counts, calibration, second_returns=False, **options)
    return hf.flag_mixed(image, calibration, pixel_angle=angle)


def is_mixed(image):
    return (image["quality"].values & int(hf.Quality.MIXED)) != 0


@pytest.mark.parametrize(
    ("surfaces", "step", "share_error"),
    [
        ((1.0, 1.0), 0.2, 0.18),
        ((1.0, 1.0), 0.4, 0.095),
        ((1.0, 1.0), 0.8, 0.065),
        (("ink red", "ink blue"), 0.2, 0.05),
        (("ink red", "ink blue"), 0.8, 0.045),
    ],
)
def test_disc_in_front_of_a_wall(calibrated, surfaces, step, share_error):
    phantoms = unflagged = false = mixed_pixels = clean_pixels = 0
    errors = []
    for seed in range(4):
        share = disc_share(seed)
        image = disc_image(calibrated, share, step, surfaces, seed)
        flagged = is_mixed(image)
        depth, std = image["depth"].values, image["depth_std"].values
        off = np.minimum(np.abs(depth - 1.0), np.abs(depth - 1.0 - step)) > 3 * std
        off |= flagged
        mixed = (share > 0) & (share < 1)
        phantoms += (off & mixed).sum()
        unflagged += (off & mixed & ~flagged).sum()
        false += (flagged & ~mixed).sum()
        mixed_pixels += mixed.sum()
        clean_pixels += (~mixed).sum()
        near, far = np.where(flagged, depth, np.nan), image["second_depth"].values
        assert (np.isfinite(near) == flagged).all()
        assert (np.isfinite(far) == flagged).all()
        assert np.nanmedian(near) == pytest.approx(1.0, abs=0.02)
        assert np.nanmedian(far) == pytest.approx(1.0 + step, abs=0.02)
        found = image["near_share"].values
        errors.append((found - share)[flagged & mixed & np.isfinite(found)])
    errors = np.concatenate(errors)
    assert phantoms > 0.05 * mixed_pixels
    # 510 mixed pixels, of which at most 3 were not flagged: more than 10 are one seed in 3000
    assert unflagged <= 0.02 * mixed_pixels
    # 11 778 clean pixels, of which 6 to 16 were flagged: more than 35 are one seed in 60 000
    assert false <= 0.003 * clean_pixels
    # 109 to 361 shares; four standard deviations of their scatter: one seed in 30 000
    assert len(errors) >= 70
    assert np.sqrt(np.mean(errors**2)) < share_error


@pytest.mark.parametrize("degrees", [0, 60, 75])
def test_a_tilted_plane_has_no_edge(calibrated, degrees):
    instrument, calibration, angle = calibrated
    across = ((np.arange(COLS * RAYS) + 0.5) / RAYS - COLS / 2) * angle
    depths = 1 / (1 - np.tan(np.radians(degrees)) * across)
    rays = np.array([waveform(instrument, depth) for depth in depths])
    line = rays.reshape(COLS, RAYS, -1).mean(axis=1)
    counts = drawn(instrument, np.broadcast_to(line, (ROWS, *line.shape)), seed=degrees)
    image = hf.flag_mixed(hf.reconstruct(counts, calibration), calibration, pixel_angle=angle)
    # none of 9216 pixels was flagged; 3 of 3072 are allowed
    assert is_mixed(image).mean() <= 0.001


def test_flagging_leaves_the_rest(calibrated):
    instrument, calibration, angle = calibrated
    share = disc_share(9)
    first = disc_image(calibrated, share, 0.8, (1.0, 1.0), 9)
    with pytest.raises(ImageError, match="found already"):
        hf.flag_mixed(first, calibration, pixel_angle=angle)
    assert "mixed" in first["quality"].attrs["flag_meanings"].split()
    assert not (reliable(first).values & is_mixed(first)).any()
    three = disc_image(calibrated, share, 0.8, (1.0, 1.0), 9, bands=[0, 3, 5])
    assert (is_mixed(three) == is_mixed(first)).all()
    wall = np.tile(waveform(instrument, 1.0), (ROWS, COLS, 1))
    plain = hf.reconstruct(drawn(instrument, wall, 1), calibration)
    flagged = hf.flag_mixed(plain, calibration, pixel_angle=angle)
    for name in plain.data_vars:
        assert plain[name].equals(flagged[name])


def test_second_returns_are_kept(calibrated):
    instrument, calibration, angle = calibrated
    near, far = waveform(instrument, 1.0), waveform(instrument, 1.8)
    counts = drawn(instrument, disc_share(3)[..., None] * (near - far) + far, 3)
    image = hf.reconstruct(counts, calibration)
    second = image["second_depth"].values
    assert np.isfinite(second).any()
    after = hf.flag_mixed(image, calibration, pixel_angle=angle)
    kept = np.isfinite(second) & ~is_mixed(after)
    assert kept.any()
    np.testing.assert_array_equal(after["second_depth"].values[kept], second[kept])
    assert "near_share" in after


def test_pixels_without_a_depth_are_no_neighbors():
    depth = np.full((9, 9), 1.0)
    depth[:, 5:] = 2.0
    depth[:, 4] = 1.5
    std = np.full((9, 9), 0.02)
    assert np.nonzero(find_mixed(depth, std, 0.002).mixed.all(axis=0))[0].tolist() == [4]
    depth[:, 5:] = np.nan
    found = find_mixed(depth, std, 0.002)
    assert not found.mixed.any()
    assert np.isnan(found.near).all()


def test_a_steeper_lens_needs_a_larger_step():
    depth = np.full((9, 9), 1.0)
    depth[:, 5:] = 1.2
    depth[:, 4] = 1.1
    std = np.full((9, 9), 0.002)
    assert find_mixed(depth, std, 0.002).mixed.any()
    assert not find_mixed(depth, std, 0.01).mixed.any()


def test_what_can_not_be_judged_is_refused(calibrated):
    instrument, calibration, angle = calibrated
    wall = np.tile(waveform(instrument, 1.0), (ROWS, COLS, 1))
    image = hf.reconstruct(drawn(instrument, wall, 3), calibration)
    with pytest.raises(ImageError, match="has no lens"):
        hf.flag_mixed(image, calibration)
    for bad in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(ImageError, match="pixel_angle = "):
            hf.flag_mixed(image, calibration, pixel_angle=bad)
    with pytest.raises(ImageError, match="no depth_std"):
        hf.flag_mixed(image.drop_vars("depth_std"), calibration, pixel_angle=angle)
    with pytest.raises(ImageError, match="series of 2 images"):
        hf.flag_mixed(stack([image, image]), calibration, pixel_angle=angle)
    pooled = image.assign(resolution=image["depth"])
    with pytest.raises(ImageError, match="share their photons"):
        hf.flag_mixed(pooled, calibration, pixel_angle=angle)


@pytest.fixture(scope="module")
def with_lens(calibrated):
    """The instrument with a lens whose rays are nearly parallel, and the same calibration."""
    flat, calibration, _ = calibrated
    lens = msgspec.structs.replace(hf.Instrument.load("paper").lens, focal_length_mm=250.0)
    instrument = flat.replace(lens=lens)
    assert instrument.ray_cosine().min() > 0.9999  # a wall is at one distance
    return instrument, replace(calibration, instrument=instrument)


def lens_image(with_lens, share, step, surfaces, seed, **options):
    instrument, calibration = with_lens
    near = waveform(instrument, 1.0, surfaces[0])
    far = waveform(instrument, 1.0 + step, surfaces[1])
    mean = share[..., None] * near + (1 - share[..., None]) * far
    return hf.reconstruct(drawn(instrument, mean, seed), calibration, **options)


@pytest.mark.parametrize("range_correction", [True, False])
def test_reconstruct_separates_two_colors_by_their_counts(with_lens, range_correction):
    share = disc_share(5)
    args = (with_lens, share, 0.2, ("ink red", "ink blue"), 5)
    image = lens_image(*args, range_correction=range_correction)
    plain = lens_image(*args, range_correction=range_correction, mixed=False, second_returns=False)
    flagged, mixed = is_mixed(image), (share > 0) & (share < 1)
    # by the depth alone about a tenth of them, by their counts also most others
    assert flagged[mixed].mean() > 0.5
    # 2945 pixels see one surface: .02 % were flagged, more than .3 % are one seed in 10 000
    assert flagged[~mixed].mean() < 0.003
    assert "second_depth" not in plain
    assert not is_mixed(plain).any()
    for name in ("depth", "second_depth", "second_depth_std"):
        assert (np.isfinite(image[name].values[flagged])).all()
    assert np.isnan(image["second_depth"].values[~flagged]).all()
    assert np.isnan(image["near_share"].values[~flagged]).all()
    assert np.nanmedian(image["depth"].values[flagged]) == pytest.approx(1.0, abs=0.02)
    assert np.nanmedian(image["second_depth"].values) == pytest.approx(1.2, abs=0.02)
    told = flagged & mixed & np.isfinite(image["near_share"].values)
    error = (image["near_share"].values - share)[told]
    assert np.sqrt(np.mean(error**2)) < 0.06
    for name in ("depth", "depth_std", "reflectance", "background"):
        np.testing.assert_array_equal(image[name].values[~flagged], plain[name].values[~flagged])
    # the neighbors tell the color of either surface
    instrument, _ = with_lens
    for name, color in (("near_reflectance", "ink red"), ("second_reflectance", "ink blue")):
        light = band_weights(instrument) @ reflectance(color)
        light *= PHOTONS / (instrument.band_brightness() @ light)
        white = (image["white_photons"] * image["white_share"]).values[flagged]
        depth = image["depth" if color == "ink red" else "second_depth"].values[flagged][:, None]
        if range_correction:
            light = light * (depth / image["depth"].values[flagged][:, None]) ** 2
        truth = light * instrument.band_brightness() / white
        z = (image[name].values[flagged] - truth) / image[f"{name}_std"].values[flagged]
        assert np.abs(np.median(z)) < 0.5
    # counts, which intervals of reflectance rest on, stay what they were
    photons, before = (
        (one["reflectance"] * one["white_photons"] * one["white_share"]).values[flagged]
        for one in (image, plain)
    )
    np.testing.assert_allclose(photons, before, rtol=1e-4, atol=1e-4)
    # the light that a pixel returns is corrected for the depth that is stated
    power = 2 if range_correction else 0
    ratio = (image["depth"].values / plain["depth"].values)[flagged] ** power
    np.testing.assert_allclose(
        image["reflectance"].values[flagged],
        plain["reflectance"].values[flagged] * ratio[:, None],
        rtol=1e-4, atol=1e-6,
    )  # fmt: skip


def test_counts_on_disk_give_the_same(with_lens, tmp_path):
    instrument, calibration = with_lens
    near, far = waveform(instrument, 1.0, "ink red"), waveform(instrument, 1.2, "ink blue")
    counts = drawn(instrument, disc_share(7)[..., None] * (near - far) + far, 7)
    np.save(tmp_path / "counts.npy", counts)
    stored = np.load(tmp_path / "counts.npy", mmap_mode="r")
    image, other = (hf.reconstruct(given, calibration) for given in (counts, stored))
    assert is_mixed(image).any()
    for name in image.data_vars:
        np.testing.assert_array_equal(image[name].values, other[name].values)


def test_a_part_of_the_picture_and_methods_that_find_none(with_lens, calibrated):
    args = (with_lens, disc_share(6), 0.8, (1.0, 1.0), 6)
    part = lens_image(*args, region=np.s_[:, :30])
    whole = lens_image(*args)
    assert not is_mixed(part)[:, 30:].any()
    assert np.isnan(part["second_depth"].values[:, 30:]).all()
    # windows of pixels farther from the border lie inside
    assert (is_mixed(part)[:, :28] == is_mixed(whole)[:, :28]).all()
    assert is_mixed(part).any()
    assert "second_depth" not in lens_image(*args, method="paper")
    with pytest.raises(hf.HueflightError, match="mixed = True: method 'paper'"):
        lens_image(*args, method="paper", mixed=True)
    instrument, calibration, _ = calibrated
    counts = drawn(instrument, np.tile(waveform(instrument, 1.0), (ROWS, COLS, 1)), 3)
    assert "near_share" not in hf.reconstruct(counts, calibration)
    with pytest.raises(hf.HueflightError, match="has no lens"):
        hf.reconstruct(counts, calibration, mixed=True)


def test_a_wall_without_an_edge_has_no_mixed_pixel(with_lens):
    nowhere = np.zeros((ROWS, COLS))
    image = lens_image(with_lens, nowhere, 0.2, (1.0, 1.0), 8, second_returns=False)
    assert not is_mixed(image).any()
    for name in ("second_depth", "near_share", "near_reflectance", "second_reflectance"):
        assert np.isnan(image[name]).all()
        assert np.isnan(image[f"{name}_std"]).all()


def test_an_image_is_flagged_by_the_angle_of_its_lens(with_lens):
    options = {"range_correction": False, "mixed": False, "second_returns": False}
    image = lens_image(with_lens, disc_share(5), 0.8, (1.0, 1.0), 5, **options)
    flagged = hf.flag_mixed(image, with_lens[1])
    assert is_mixed(flagged).any()
    assert flagged["reflectance"].equals(image["reflectance"])  # there is no range to correct for


def test_the_window_of_a_pixel_at_the_border_is_moved_inwards():
    values = np.arange(42.0).reshape(6, 7, 1)
    about = neighbors(values, np.array([0, 3, 5]), np.array([6, 3, 0]))[..., 0]
    grid = values[..., 0]
    for found, window, own in zip(
        about, (grid[:5, 2:], grid[1:6, 1:6], grid[1:, :5]), (6.0, 24.0, 35.0), strict=True
    ):
        assert sorted(found) == sorted(set(window.ravel()) - {own})


def test_neighbors_beyond_a_small_image_are_unknown():
    values = np.arange(12.0).reshape(3, 4, 1)
    about = neighbors(values, np.array([0]), np.array([3]))[0, :, 0]
    assert sorted(about[np.isfinite(about)]) == [*range(3), *range(4, 12)]


def test_edges_at_the_border_of_the_image_are_seen():
    # a window of three columns about the first one would not reach the far surface
    depth = np.full((9, 9), 2.0)
    depth[:, 0] = 1.5
    depth[:, 1:3] = 1.0
    mixed = find_mixed(depth, np.full((9, 9), 0.02), 0.002).mixed
    assert np.nonzero(mixed.all(axis=0))[0].tolist() == [0]


def test_a_pixel_that_strays_beside_no_edge_is_not_mixed():
    depth = np.full((9, 9), 1.0)
    depth[:, 6:] = 2.0
    std = np.full((9, 9), 0.02)
    depth[4, 4] = 1.1  # two columns away from the edge
    assert not find_mixed(depth, std, 0.002).mixed.any()
    depth[4, 5] = 1.1  # next to it
    assert np.argwhere(find_mixed(depth, std, 0.002).mixed).tolist() == [[4, 5]]
