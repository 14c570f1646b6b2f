# SPDX-License-Identifier: Apache-2.0
"""What `reflectance` is: corrected for the distance by default, and labeled either way."""

import numpy as np
import pytest
import xarray as xr

import hueflight as hf
from hueflight.analysis import compare, stack
from hueflight.errors import HueflightError
from hueflight.reconstruction.range_correction import range_correction_of, relative_signal
from hueflight.reconstruction.video import Video

ROWS, COLS, REFERENCE = 20, 20, 50_000


@pytest.fixture(scope="module")
def instrument(small):
    return small(rows=ROWS, cols=COLS)


@pytest.fixture(scope="module")
def calibration(instrument, draw):
    return hf.calibrate(draw(instrument, depth=0.4, photons=REFERENCE), instrument, distance=0.4)


@pytest.fixture(scope="module")
def seen(instrument, draw):
    """A white board at 0.8 m: a quarter of the light of the reference at 0.4 m."""
    return draw(instrument, depth=0.8, photons=REFERENCE / 4, seed=2)


@pytest.mark.parametrize("method", ["joint", "paper", "pooled"])
def test_a_white_board_is_white_at_any_distance(calibration, seen, method):
    # drawn without losses to pile-up
    options = {"method": method, "pileup_correction": False}
    image = hf.reconstruct(seen, calibration, **options)
    # 12 500 photons a pixel, 400 pixels: noise below 0.2 %; windows cut tails elsewhere by 1 %.
    np.testing.assert_allclose(image.reflectance.mean(("row", "col")), 1, rtol=0.02)
    assert image.reflectance.attrs["range_correction"] == "inverse square"
    raw = hf.reconstruct(seen, calibration, **options, range_correction=False)
    np.testing.assert_allclose(raw.reflectance.mean(("row", "col")), 0.25, rtol=0.02)
    assert raw.reflectance.attrs["range_correction"] == "none"
    assert "not corrected" in raw.reflectance.attrs["long_name"]


@pytest.mark.parametrize("method", ["joint", "paper"])
def test_the_deviation_holds_that_of_the_distance(instrument, calibration, draw, method):
    """Scatter over 400 pixels against the stated deviation; each is known to 3.5 %."""
    counts = draw(instrument, depth=0.1, photons=4000, seed=3)
    image = hf.reconstruct(counts, calibration, method=method, frames=100_000)
    scatter = image.reflectance.std(("row", "col")).values
    stated = image.reflectance_std.mean(("row", "col")).values
    # one value beyond five of its deviations in a million; nine bands
    np.testing.assert_allclose(scatter / stated, 1, atol=0.18)
    by_range = (2 * image.reflectance * image.depth_std / image.depth).mean(("row", "col"))
    assert (by_range.values > 0.6 * stated).any()  # the test would see it missing


def test_an_unknown_distance_leaves_the_signal_as_it_is(instrument, draw, seen):
    unknown = hf.calibrate(draw(instrument, depth=0.4, photons=2000), instrument, distance=0)
    assert range_correction_of(hf.reconstruct(seen, unknown)) == "none"
    with pytest.raises(HueflightError, match="distance = 0"):
        hf.reconstruct(seen, unknown, range_correction=True)
    with pytest.raises(HueflightError, match="distance = 0"):
        Video(unknown, range_correction=True)


def test_video_corrects_alike(calibration, seen):
    image = hf.reconstruct(seen, calibration)
    found = Video(calibration).next(seen)
    xr.testing.assert_allclose(found.reflectance, image.reflectance)
    assert found.reflectance.attrs == image.reflectance.attrs


def test_the_correction_can_be_undone(calibration, seen):
    raw = hf.reconstruct(seen, calibration, range_correction=False)
    for image in (raw, hf.reconstruct(seen, calibration)):
        signal, signal_std = relative_signal(image, calibration)
        planes = raw.transpose("band", "row", "col")
        np.testing.assert_allclose(signal, planes.reflectance, rtol=1e-5)
        np.testing.assert_allclose(signal_std, planes.reflectance_std, rtol=1e-4)


def test_images_that_differ_in_it_are_not_compared(calibration, seen):
    image = hf.reconstruct(seen, calibration)
    raw = hf.reconstruct(seen, calibration, range_correction=False)
    for combine in (lambda a, b: compare(a, b), lambda a, b: stack([a, b])):
        with pytest.raises(HueflightError, match="'none', that of image 0 'inverse square'"):
            combine(image, raw)
    earlier = raw.copy()
    del earlier["reflectance"].attrs["range_correction"]
    compare(earlier, raw)  # version 0.1.0 did not correct
    with pytest.raises(HueflightError, match="not stated"):
        compare(image, earlier)


def test_the_label_survives_files(calibration, seen, tmp_path):
    from hueflight.export import write
    from hueflight.importers import read_image

    image = hf.reconstruct(seen, calibration)
    for name in ("image.zarr", "image.nc"):
        write(image, tmp_path / name)
        assert range_correction_of(read_image(tmp_path / name)) == "inverse square"
