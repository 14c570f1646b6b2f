# SPDX-License-Identifier: Apache-2.0
"""Flags of broken and dark pixels come where they should, and nowhere else.

Tests that a flag comes, and that it does not, are for the other flags in `test_detection`
(NO_RETURN, OUT_OF_RANGE), `test_assessment` (MISFIT), `test_mixed_pixels` (MIXED),
`test_second_returns` (TWO_RETURNS), `test_interleaved` (AMBIGUOUS_LAG), `test_deviations`
(PILED_UP), `test_options` (SKIPPED) and `pooled/test_pooled` (CONTRADICTED).
"""

import numpy as np
import pytest

import hueflight as hf
from hueflight.reconstruction.quality import Quality

PLACES = {
    Quality.HOT: (1, 2),
    Quality.LOW_SIGNAL: (3, 4),
    Quality.DEAD: (5, 6),
    Quality.SATURATED: (7, 8),
}


@pytest.mark.parametrize("method", ["joint", "paper"])
def test_broken_and_dark_pixels_alone_are_flagged(small, draw, method):
    instrument = small(rows=12, cols=16)
    reference = draw(instrument, photons=3000, depth=0.4)
    reference[(*PLACES[Quality.HOT], slice(1, None))] = 200
    reference[(*PLACES[Quality.DEAD], slice(1, None))] = 0
    calibration = hf.calibrate(reference, instrument, distance=0.4)
    counts = draw(instrument, photons=620, background=62, seed=1).astype(np.uint16)
    counts[(*PLACES[Quality.LOW_SIGNAL], slice(1, None))] = 0
    counts[(*PLACES[Quality.SATURATED], 100)] = np.iinfo(np.uint16).max
    image = hf.reconstruct(counts, calibration, method=method)
    quality = image["quality"].values
    for flag, place in PLACES.items():
        assert np.argwhere(quality & int(flag)).tolist() == [list(place)], flag
        if flag is not Quality.SATURATED:
            assert np.isnan(image["depth"].values[place])
    rest = quality != 0
    for place in PLACES.values():
        rest[place] = False
    assert rest.sum() <= 3  # of 188, by tests with false alarms of 1e-3 each
