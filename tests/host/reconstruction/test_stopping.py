# SPDX-License-Identifier: Apache-2.0
"""The stop rule: shares of pixels, and how many frames a rule will take."""

import numpy as np
import pytest

import hueflight as hf
from hueflight.errors import HueflightError
from hueflight.reconstruction.quality import Quality
from hueflight.reconstruction.stopping import StopRule, frames_needed, seen_enough, share_known


@pytest.fixture(scope="module")
def scene(small, draw):
    instrument = small(rows=12, cols=12)
    calibration = hf.calibrate(draw(instrument, photons=20_000), instrument, distance=0.5)

    def image(photons):
        return hf.reconstruct(draw(instrument, depth=0.9, photons=photons), calibration)

    return image


def test_more_photons_meet_the_rule(scene):
    rule = StopRule(depth_std=0.012)
    assert not seen_enough(scene(300), rule)
    assert seen_enough(scene(30_000), rule)


def test_frames_needed_are_those_that_bring_it(scene):
    # Poisson: standard deviations fall as 1/sqrt(frames); 144 pixels' medians agree to 3 %
    before = scene(2000)
    rule = StopRule(depth_std=float(before["depth_std"].median()) / 3, share=0.5)
    assert frames_needed(before, rule, 100) == pytest.approx(900, rel=0.02)
    after = StopRule(depth_std=rule.depth_std * 1.1, share=0.5)
    assert seen_enough(scene(2000 * 9), after)


def test_what_no_wait_would_help_is_left_out(scene):
    image = scene(30_000).copy(deep=True)
    image["depth_std"].values[:6] = np.nan
    rule = StopRule(depth_std=0.012)
    assert share_known(image, rule) == pytest.approx(0.5)
    assert frames_needed(image, rule, 10) == float("inf")
    image["quality"].values[:6] |= int(Quality.DEAD)
    assert share_known(image, rule) == 1.0


def test_nothing_is_waited_for_where_no_pixel_works(scene):
    image = scene(300).copy(deep=True)
    image["quality"].values[:] |= int(Quality.DEAD)
    assert frames_needed(image, StopRule(depth_std=1e-6), 100) == 100


def test_frames_needed_for_reflectance(scene):
    image = scene(30_000)
    worst = float(np.median(image["reflectance_std"].values.max(axis=-1)))
    rule = StopRule(reflectance_std=worst / 2, share=0.5)
    assert frames_needed(image, rule, 100) == pytest.approx(400, rel=0.02)
    both = StopRule(reflectance_std=worst / 2, depth_std=1e9, share=0.5)
    assert frames_needed(image, both, 100) == frames_needed(image, rule, 100)


def test_every_band_counts(scene):
    image = scene(30_000).copy(deep=True)
    rule = StopRule(reflectance_std=float(image["reflectance_std"].max()) * 1.001, share=1)
    assert seen_enough(image, rule)
    image["reflectance_std"].values[3, 4, 2] *= 2
    assert not seen_enough(image, rule)


@pytest.mark.parametrize(
    ("wish", "message"),
    [
        ({}, "give depth_std"),
        ({"depth_std": 0.0}, "depth_std = 0.0"),
        ({"reflectance_std": float("nan")}, "reflectance_std = nan"),
        ({"depth_std": 0.01, "share": 0.0}, "share = 0.0"),
    ],
)
def test_wishes_that_make_no_sense(wish, message):
    with pytest.raises(HueflightError, match=message):
        StopRule(**wish)
