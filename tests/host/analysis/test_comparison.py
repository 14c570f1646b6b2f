# SPDX-License-Identifier: Apache-2.0
"""What changed is found, what did not is left alone, at the rates that are promised."""

from collections.abc import Callable

import numpy as np
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from hueflight.analysis import compare, spectral_angle
from hueflight.analysis.comparison import discoveries
from hueflight.errors import HueflightError
from hueflight.reconstruction.quality import Quality

Noisy = Callable[..., xr.Dataset]


def test_probabilities_are_uniform_where_nothing_changed(noisy: Noisy) -> None:
    found = compare(noisy(seed=1), noisy(seed=2))
    for name in ("depth_p", "spectrum_p"):
        # false alarm 1e-6 each
        assert stats.kstest(found[name].values.ravel(), "uniform").pvalue > 1e-6
    # at a rate of 5 % one pixel in 2000 is called changed in 5 % of such scenes; more than 5
    # in about 1e-6 of them
    assert found["depth_changed"].sum() <= 5
    assert found["spectrum_changed"].sum() <= 5


def test_changes_are_found_at_the_promised_rate(noisy: Noisy) -> None:
    moved = np.zeros((40, 50), dtype=bool)
    moved[10:20, 10:30] = True
    wrong, called, seen = 0, 0, 0
    for seed in range(10):
        after = noisy(
            seed=2 * seed + 1,
            depth=np.where(moved, 1.1, 1.0),  # 3.5 deviations of the difference
            reflectance=np.where(moved[..., None], 0.6, 0.5),
        )
        found = compare(noisy(seed=2 * seed), after, false_discovery_rate=0.1)
        changed = found["depth_changed"].values
        wrong += int((changed & ~moved).sum())
        called += int(changed.sum())
        seen += int((changed & moved).sum())
        assert (found["spectrum_changed"].values & moved).sum() > 0.25 * moved.sum()
    # expected 9 % wrong among about 1700 calls; 13 % is six deviations away (1e-9)
    assert wrong / called < 0.13
    assert seen > 0.7 * 10 * moved.sum()


def test_differences_by_hand(noisy: Noisy) -> None:
    before, after = noisy(seed=1), noisy(seed=2, depth=1.5, depth_std=0.03)
    found = compare(before, after)
    np.testing.assert_allclose(found["depth_difference"], after["depth"] - before["depth"])
    np.testing.assert_allclose(found["depth_difference_std"], np.hypot(0.02, 0.03))
    scores = (after["reflectance"] - before["reflectance"]) / np.hypot(0.05, 0.05)
    wanted = stats.chi2.sf((scores**2).sum("band"), 9)
    np.testing.assert_allclose(found["spectrum_p"], wanted, rtol=1e-9)
    first, second = before["reflectance"].values[3, 4], after["reflectance"].values[3, 4]
    cosine = first @ second / np.linalg.norm(first) / np.linalg.norm(second)
    assert float(found["spectral_angle"][3, 4]) == pytest.approx(np.arccos(cosine))


def test_what_is_unknown_is_never_a_change(noisy: Noisy) -> None:
    before, after = noisy(seed=1), noisy(seed=2, depth=3.0)
    after["depth"][0, 0] = np.nan
    before["quality"][0, 1] = int(Quality.AMBIGUOUS)
    after["reflectance"][1, 0, :4] = np.nan  # fewer bands, fewer degrees of freedom
    found = compare(before, after)
    assert found["depth_changed"].sum() == 40 * 50 - 2
    assert np.isnan(found["depth_p"][0, :2]).all()
    assert not found["spectrum_changed"][0, 1]
    rest = (after["reflectance"] - before["reflectance"])[1, 0, 4:] / np.hypot(0.05, 0.05)
    assert float(found["spectrum_p"][1, 0]) == pytest.approx(stats.chi2.sf((rest**2).sum(), 5))


def test_images_that_cannot_be_compared(noisy: Noisy) -> None:
    image = noisy()
    with pytest.raises(HueflightError, match="different instruments: 'paper'"):
        compare(image, image.assign_attrs(instrument_fingerprint="g", instrument="other"))
    with pytest.raises(HueflightError, match="differ in size"):
        compare(image, image.isel(row=slice(5)))
    other = image.assign_coords(wavelength=("band", image["wavelength"].values + 1))
    with pytest.raises(HueflightError, match="different bands"):
        compare(image, other)
    with pytest.raises(HueflightError, match="false_discovery_rate = 5"):
        compare(image, image, false_discovery_rate=5)


def spectra(*values: list[float]) -> xr.DataArray:
    return xr.DataArray(np.array(values), dims=("pixel", "band"))


@given(st.lists(st.floats(0.01, 1), min_size=3, max_size=3), st.floats(1e-3, 1e3))
def test_angle_is_blind_to_brightness(colour: list[float], factor: float) -> None:
    angle = spectral_angle(spectra(colour), spectra([factor * v for v in colour]))
    assert angle.item() < 1e-14


def test_angles_of_known_size() -> None:
    tiny = 1e-9  # where the cosine has no digits left
    found = spectral_angle(
        spectra([1, 0], [1, 1], [1, 0], [1, 0], [0, 0], [1, np.nan]),
        spectra([0, 1], [1, 0], [1, tiny], [-1, 0], [1, 1], [1, 5]),
    )
    np.testing.assert_allclose(found[:4], [np.pi / 2, np.pi / 4, tiny, np.pi], rtol=1e-12)
    assert np.isnan(found[4])
    assert float(found[5]) == 0  # only the band that both have


def test_discoveries_by_the_published_example() -> None:
    """Benjamini and Hochberg (1995), section 4.1: of 15 p-values four are rejected at 5 %."""
    values = np.array([0.0001, 0.0004, 0.0019, 0.0095, 0.0201, 0.0278, 0.0298, 0.0344, 0.0459,
                       0.3240, 0.4262, 0.5719, 0.6528, 0.7590, 1.0000])  # fmt: skip
    assert list(np.flatnonzero(discoveries(values, 0.05))) == [0, 1, 2, 3]
    shuffled = np.random.default_rng(0).permutation(np.append(values, np.nan))
    assert set(shuffled[discoveries(shuffled, 0.05)]) == set(values[:4])
    assert not discoveries(np.array([0.9, np.nan]), 0.05).any()
    assert not discoveries(np.array([np.nan]), 0.05).any()
