# SPDX-License-Identifier: Apache-2.0
"""The paper's method compiled, against its definition: the same to single precision's rounding."""

from dataclasses import fields, replace

import numpy as np
import pytest

import hueflight as hf
from hueflight import backend
from hueflight.backend.fit import CORRELATIONS
from hueflight.reconstruction import paper
from hueflight.reconstruction import paper_kernel as paper_compiled
from hueflight.reconstruction.inputs import prepare_histogram
from hueflight.reconstruction.options import EstimatorOptions

compiled = pytest.mark.usefixtures("compiled_fit")


@pytest.fixture(scope="module")
def instrument(small):
    return small(rows=12, cols=12)


@pytest.fixture(scope="module")
def calibration(instrument, draw):
    return hf.calibrate(draw(instrument, depth=0.4, photons=5000), instrument, distance=0.4)


def both(light, calibration):
    """Definition and kernel of the pixels with photons, and where two lags tie for the highest."""
    light = light.reshape(-1, light.shape[-1])
    photons = light.sum(axis=-1, dtype=np.float64)
    pixels = np.flatnonzero(photons)
    fast = paper_compiled.measure(
        light,
        pixels,
        photons.max(),
        calibration,
        paper.search_of(calibration),
        paper.outside_windows(calibration),
    )
    assert fast is not None
    search = paper.search_bins(calibration)
    reference = calibration.reference.reshape(light.shape).astype(np.int64)
    tied = np.zeros(len(pixels), bool)
    for place, pixel in enumerate(pixels):  # in whole numbers: no rounding chooses
        every = np.correlate(light[pixel].astype(np.int64), reference[pixel], "full")
        middle = light.shape[1] - 1
        ordered = np.sort(every[middle - search : middle + search + 1])
        tied[place] = ordered[-1] == ordered[-2]
    return paper.measured_numpy(light, pixels, calibration), fast, tied


def assert_same(slow, fast, tied):
    """Delays to a thousandth of a bin but where two lags tie, sums to the last photon.

    Where they tie, the definition's transform chooses by its rounding.
    """
    close = np.abs(slow.delay - fast.delay) < 1e-3
    assert (close | tied).all()
    assert close.mean() > 0.5
    np.testing.assert_allclose(fast.deviation[close], slow.deviation[close], rtol=1e-3)
    np.testing.assert_array_equal(fast.sums[close], slow.sums[close])
    np.testing.assert_allclose(fast.background, slow.background, rtol=1e-12)


@compiled
@pytest.mark.parametrize("depth", [0.4, 0.9, 1.9])  # the last: lags beyond the range searched
@pytest.mark.parametrize("photons", [20, 620, 20_000])
@pytest.mark.parametrize("background", [0.0, 1.0])
def test_same_results(instrument, calibration, draw, depth, photons, background):
    counts = draw(
        instrument, depth=depth, photons=photons, background=background * photons, frames=10**7
    )
    light = instrument.time_bins().in_time_order(counts)
    assert_same(*both(light, calibration))


@pytest.mark.usefixtures("fit_build")
def test_every_width_of_vectors_gives_the_same(instrument, calibration, draw):
    counts = draw(instrument, depth=0.9, photons=620, background=62)
    assert_same(*both(instrument.time_bins().in_time_order(counts), calibration))


@compiled
@pytest.mark.parametrize("dtype", [np.uint16, np.uint32])
@pytest.mark.parametrize("reverse", [False, True])
def test_every_type_and_direction_of_counts(instrument, calibration, draw, dtype, reverse):
    light = instrument.time_bins().in_time_order(draw(instrument, photons=620)).astype(dtype)
    if reverse:
        light = np.ascontiguousarray(light[..., ::-1])[..., ::-1]
    assert_same(*both(light, calibration))


@compiled
@pytest.mark.parametrize("dtype", [np.uint16, np.uint32])
def test_counts_that_lie_apart_and_large_ones(instrument, calibration, draw, dtype):
    light = instrument.time_bins().in_time_order(draw(instrument, photons=620)).astype(dtype)
    apart = np.repeat(light, 2, axis=-1)[..., ::2]
    assert apart.reshape(144, -1).strides[1] == 2 * apart.itemsize
    assert_same(*both(apart, calibration))
    assert_same(*both(light * dtype(60), calibration))  # beyond pairs of 15 bits


@pytest.mark.usefixtures("fit_build")
@pytest.mark.parametrize(
    ("light_peak", "reference_peak"),
    [(127, 127), (128, 127), (127, 255), (100, 200), (63, 255), (63, 256), (31, 255), (9, 255)],
)
@pytest.mark.parametrize("lit", [1, 2, 4])
def test_counts_at_the_limits_of_bytes(calibration, light_peak, reference_peak, lit):
    """Products of bytes are added up in 16 bits as long as none can overflow.

    Light in every second or fourth bin adds up in half or a quarter of the places.
    """
    bins = np.arange(calibration.reference.shape[-1])
    pulse = np.maximum(1 - ((bins - 250) / 48.0) ** 8, 0)
    reference = np.rint(pulse * reference_peak) + np.zeros_like(calibration.reference)
    light = np.zeros((144, bins.size), np.uint16)
    for pixel, row in enumerate(light):
        row[:] = np.rint(np.roll(pulse, pixel % 31 - 15) * light_peak) * (bins % lit == 0)
    assert_same(*both(light, replace(calibration, reference=reference)))


@pytest.mark.usefixtures("fit_build")
def test_two_products_of_bytes_do_not_saturate(calibration):
    bins = np.arange(calibration.reference.shape[-1])
    reference = np.maximum(1 - ((bins - 250) / 20.0) ** 2, 0) * 255
    other = replace(
        calibration, reference=np.rint(reference) + np.zeros_like(calibration.reference)
    )
    light = np.zeros((144, bins.size), np.uint16)
    light[:, [256, 258]] = 127
    assert_same(*both(light, other))


@compiled
def test_windows_that_wrap_or_end(calibration, instrument, draw):
    light = instrument.time_bins().in_time_order(draw(instrument, depth=0.9, photons=620))
    first, last = calibration.windows[0], calibration.windows[-1]
    far = (replace(first, start=-30, stop=20), replace(last, start=470, stop=530))
    circular = replace(calibration, windows=far)
    assert_same(*both(light, circular))
    bins = replace(calibration.bins, period_ns=None)
    assert_same(*both(light, replace(circular, bins=bins)))


@compiled
@pytest.mark.parametrize(
    "options",
    [
        {},
        {"range_correction": True},
        {"pileup_correction": False},
        {"frames": 50_000},
        {"bands": [0, 4]},
        {"region": np.s_[2:7, 3:9]},
    ],
)
def test_images_are_the_same(instrument, draw, monkeypatch, options):
    reference = draw(instrument, depth=0.4, photons=5000, frames=9000)
    bins = instrument.time_bins()
    reference[1, 2, bins.codes] = 300
    reference[5, 6, 1:] = 0
    calibration = hf.calibrate(reference, instrument, distance=0.4)
    seen = draw(instrument, depth=0.9, photons=2000, frames=4000)  # half the exposures hold one
    seen[3, 4, 1:] = 0
    monkeypatch.setenv("HUEFLIGHT_KERNELS", "numpy")
    slow = hf.reconstruct(seen, calibration, method="paper", **options)
    assert calibration not in paper_compiled._ready
    monkeypatch.setenv("HUEFLIGHT_KERNELS", "c")
    fast = hf.reconstruct(seen, calibration, method="paper", **options)
    assert calibration in paper_compiled._ready
    np.testing.assert_array_equal(fast.quality, slow.quality)
    for name in slow.data_vars:
        np.testing.assert_allclose(fast[name], slow[name], rtol=1e-3, atol=1e-9)
    assert np.isnan(fast.depth.values[[1, 5], [2, 6]]).all()


@compiled
def test_no_photon_anywhere_in_the_windows(instrument, calibration):
    """One photon in each pixel, everywhere in turn."""
    light = np.zeros((144, instrument.time_bins().count), np.uint16)
    light[np.arange(144), np.arange(144) * 3] = 1
    assert_same(*both(light, calibration))


@compiled
@pytest.mark.parametrize("reference", [0.5, 70_000.0, -1.0])
def test_references_the_kernel_does_not_read_go_by_the_definition(
    instrument, calibration, draw, reference
):
    counts = calibration.reference.copy()
    counts[0, 0, 100] = reference
    other = replace(calibration, reference=counts)
    light = instrument.time_bins().in_time_order(draw(instrument, photons=620)).reshape(144, -1)
    lags, outside = paper.search_of(other), paper.outside_windows(other)
    assert paper_compiled.measure(light, np.arange(144), 620, other, lags, outside) is None
    prepared = prepare_histogram(draw(instrument, photons=620), other, None)
    found = paper.estimate(prepared, other, EstimatorOptions())
    # the pixel with the odd reference may find its best delay at the end of the range
    assert np.isfinite(found.depth.ravel()[1:]).all()


@compiled
def test_counts_the_kernel_does_not_read_go_by_the_definition(instrument, calibration, draw):
    light = instrument.time_bins().in_time_order(draw(instrument, photons=620)).reshape(144, -1)
    lags, outside = paper.search_of(calibration), paper.outside_windows(calibration)
    for counts, most in ((light.astype(np.float32), 620), (light, 2**31)):
        found = paper_compiled.measure(counts, np.arange(144), most, calibration, lags, outside)
        assert found is None


@compiled
def test_buffers_that_do_not_fit_are_refused(instrument, calibration, draw):
    light = instrument.time_bins().in_time_order(draw(instrument, photons=620)).reshape(144, -1)
    kernel = backend.compiled("fit", "c")
    both(light, calibration)
    ready = paper_compiled._ready[calibration]

    every = np.arange(144)

    def run(pixels=every, delays=144, **given):
        values = {field.name: getattr(ready, field.name) for field in fields(ready)} | given
        kernel.correlations(
            *CORRELATIONS.arguments(
                counts=light,
                pixels=pixels,
                **values,
                delay=np.empty(delays),
                deviation=np.empty(144),
                window_sums=np.empty((144, 9)),
                background=np.empty(144),
            )
        )

    run()
    with pytest.raises(IndexError, match="no such pixel"):
        run(pixels=np.array([144]))
    with pytest.raises(ValueError, match="do not fit"):
        run(delays=143)
    with pytest.raises(ValueError, match="do not fit"):
        run(windows=np.array([[9, 1, 2]], np.int32))
    wider = ready.sizes.copy()
    wider["reach"] = wider["search"] + 1
    with pytest.raises(ValueError, match="do not fit"):
        run(sizes=wider)
    with pytest.raises(ValueError, match="do not fit"):
        run(sizes=ready.sizes[:0])
