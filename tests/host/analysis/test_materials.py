# SPDX-License-Identifier: Apache-2.0
"""Bands by wavelength, spectral indices and unmixing, with the coverage of their deviations."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import xarray as xr
from scipy.optimize import nnls

import hueflight as hf
from hueflight.analysis import SpectralLibrary, normalized_difference, spectral_index, unmix
from hueflight.errors import HueflightError, ImageError
from hueflight.files.bands import find_band

#: probability that a normal value lies within one and within two standard deviations
WITHIN = {1: 0.6827, 2: 0.9545}


@pytest.fixture(scope="module")
def paper() -> hf.Instrument:
    return hf.Instrument.load("paper")


def test_a_wavelength_finds_the_nearest_band_or_says_how_far_it_is(noisy: Any) -> None:
    image = noisy(rows=2, cols=2)
    named = image.assign_coords(band_name=("band", [f"b{n}" for n in range(9)]))
    assert find_band(image, "532 nm") == find_band(image, "525nm") == 4
    assert find_band(named, "b3") == find_band(named, "3") == find_band(named, 3) == 3
    with pytest.raises(ImageError, match=r"'b4' at 525 nm, 15 nm away, which is more than 10 nm"):
        find_band(named, "540 nm")
    assert find_band(named, "540 nm", within_nm=20) == 4
    for wrong in ("9", "green", "nm", "-1"):
        with pytest.raises(ImageError, match=r"b0, b1.*numbers 0 to 8"):
            find_band(named, wrong)


def test_an_index_by_its_formula(noisy: Any) -> None:
    image = noisy(reflectance=np.linspace(0.2, 1.0, 9), reflectance_std=1e-6, rows=1, cols=1)
    found = normalized_difference(image, "525 nm", "659 nm")
    assert found["index"].item() == pytest.approx((0.6 - 0.2) / 0.8, abs=1e-4)
    image["reflectance_std"][..., 4], image["reflectance_std"][..., 0] = 0.03, 0.01
    # Gaussian propagation, with the derivatives 2b/(a+b)² and 2a/(a+b)²
    wanted = np.hypot(2 * 0.2 * 0.03, 2 * 0.6 * 0.01) / 0.8**2
    found = normalized_difference(image, "525 nm", "659 nm")
    assert found.index_std.item() == pytest.approx(wanted, rel=1e-3)


@pytest.mark.parametrize("std", [0.002, 0.01, 0.02])
def test_deviations_of_an_index_cover_the_truth(noisy: Any, std: float) -> None:
    """2000 pixels: the share has a deviation of 0.0104 at most; 4.5 of them, false alarm 7e-6."""
    truth = np.linspace(0.1, 0.9, 9)
    image = noisy(reflectance=truth, reflectance_std=std, seed=5)
    found = normalized_difference(image, 4, 0)
    away = np.abs(found["index"] - (truth[4] - truth[0]) / (truth[4] + truth[0]))
    for sigmas, share in WITHIN.items():
        covered = (away <= sigmas * found.index_std).values
        bound = 4.5 * np.sqrt(share * (1 - share) / covered.size)
        assert covered.mean() == pytest.approx(share, abs=bound)


def test_an_index_of_noise_is_unknown(noisy: Any) -> None:
    found = normalized_difference(noisy(reflectance=0.0, reflectance_std=0.05), 4, 0)
    assert np.isnan(found["index"]).all()
    assert np.isnan(found.index_std).all()


def test_an_index_that_the_bands_do_not_support_is_refused(
    noisy: Any, paper: hf.Instrument
) -> None:
    image = noisy(rows=2, cols=2)
    image.attrs["instrument_fingerprint"] = paper.fingerprint()
    found = spectral_index(image, "NGRDI", instrument=paper)
    assert "Tucker" in found["index"].attrs["standard_index"]
    expected = normalized_difference(image, "525 nm", "659 nm")
    xr.testing.assert_equal(found, expected)
    with pytest.raises(ImageError, match=r"NDVI needs a band between 760 and 900 nm.*659 nm"):
        spectral_index(image, "NDVI", instrument=paper)
    with pytest.raises(ImageError, match="PRI needs a band between 528 and 534 nm"):
        spectral_index(image, "PRI", instrument=paper)
    with pytest.raises(ImageError, match="'EVI': choose one of NDVI, NGRDI, PRI"):
        spectral_index(image, "EVI", instrument=paper)
    bands = list(paper.bands)
    bands[4] = type(bands[4])(**{**_facts(bands[4]), "wavelength_nm": 531.0})
    near = paper.replace(bands=tuple(bands))
    image.attrs["instrument_fingerprint"] = near.fingerprint()
    with pytest.raises(ImageError, match=r"at most 10 nm wide .* is 34 nm wide"):
        spectral_index(image, "PRI", instrument=near)


def _facts(band: Any) -> dict[str, Any]:
    return {name: getattr(band, name) for name in band.__struct_fields__}


def materials(*names: str) -> SpectralLibrary:
    chart = SpectralLibrary.colorchecker()
    rows = [chart.names.index(name) for name in names]
    return SpectralLibrary(names, chart.wavelengths_nm, chart.reflectance[rows])


def mixed(
    paper: hf.Instrument, truth: np.ndarray, library: SpectralLibrary, *, std: float, seed: int
) -> tuple[xr.DataArray, xr.DataArray]:
    clean = truth @ library.in_bands(paper).transpose("entry", "band").values
    values = clean + std * np.random.default_rng(seed).standard_normal(clean.shape)
    dims = ("pixel", "band")
    return xr.DataArray(values, dims=dims), xr.DataArray(np.full(clean.shape, std), dims=dims)


def test_abundances_are_those_of_lawson_and_hanson(paper: hf.Instrument) -> None:
    """Pixel by pixel, with and without entries at the bound, against SciPy's implementation."""
    library = materials(*SpectralLibrary.colorchecker().names[:4])
    rng = np.random.default_rng(2)
    truth = rng.dirichlet(np.full(4, 0.4), 300)
    spectra, stds = mixed(paper, truth, library, std=0.02, seed=3)
    stds = stds * xr.DataArray(rng.uniform(0.5, 2, 9), dims="band")
    found = unmix(spectra, stds, library, paper)
    design = library.in_bands(paper).transpose("band", "entry").values
    for row in range(300):
        weights = 1 / stds.values[row]
        wanted, _ = nnls(design * weights[:, None], spectra.values[row] * weights)
        assert found.abundance.values[row] == pytest.approx(wanted, abs=1e-9)
    at_bound = (found.abundance == 0).any("entry").values
    assert at_bound.any()
    assert not at_bound.all()


def test_deviations_of_abundances_cover_the_truth(paper: hf.Instrument) -> None:
    """Inside, the stated share; with entries at 0, at least that.

    4000 pixels: the share has a deviation of 0.0074 at most; 4.5 of them, false alarm 7e-6 each.
    """
    library = materials(*SpectralLibrary.colorchecker().names[:4])
    for truth, inside in ((np.full(4, 0.25), True), (np.array([0.5, 0.5, 0, 0]), False)):
        # so precise that the bound plays no part inside
        spectra, stds = mixed(paper, np.tile(truth, (4000, 1)), library, std=2e-4, seed=4)
        found = unmix(spectra, stds, library, paper)
        away = np.abs(found.abundance - truth)
        for sigmas, share in WITHIN.items():
            covered = (away <= sigmas * found.abundance_std).mean("pixel").values
            bound = 4.5 * np.sqrt(share * (1 - share) / 4000)
            assert (covered >= share - bound).all()
            if inside:
                assert (covered <= share + bound).all()


def test_twenty_materials_each_mixed_with_three_others(paper: hf.Instrument) -> None:
    """Every one of 20 materials is found within its interval at least as often as stated."""
    names = SpectralLibrary.colorchecker().names[:20]
    covered = {1: [], 2: []}
    for first in range(20):
        library = materials(*(names[(first + step) % 20] for step in (0, 3, 7, 12)))
        truth = np.random.default_rng(first).dirichlet(np.ones(4), 400)
        spectra, stds = mixed(paper, truth, library, std=0.01, seed=100 + first)
        found = unmix(spectra, stds, library, paper)
        away = np.abs(found.abundance.values - truth)
        for sigmas, kept in covered.items():
            kept.append((away <= sigmas * found.abundance_std.values).mean())
    # 20 × 400 pixels, entries of a pixel are dependent: deviation of the share at most 0.0053
    for sigmas, share in WITHIN.items():
        assert np.mean(covered[sigmas]) >= share - 4.5 * 0.0053


def test_chi_square_is_one_if_the_library_explains_the_spectra(paper: hf.Instrument) -> None:
    """5 degrees of freedom, 4000 pixels: its mean has a deviation of 0.01."""
    library = materials(*SpectralLibrary.colorchecker().names[:4])
    spectra, stds = mixed(paper, np.full((4000, 4), 0.25), library, std=2e-4, seed=6)
    found = unmix(spectra, stds, library, paper)
    assert found.fit_chi_square.mean().item() == pytest.approx(1, abs=0.045)
    stranger = spectra + xr.DataArray(np.linspace(0, 0.1, 9), dims="band")
    assert unmix(stranger, stds, library, paper).fit_chi_square.min().item() > 10


def test_unknown_bands_are_left_out_and_too_few_give_nothing(paper: hf.Instrument) -> None:
    library = materials(*SpectralLibrary.colorchecker().names[:3])
    spectra, stds = mixed(paper, np.full((3, 3), 0.3), library, std=1e-6, seed=7)
    spectra[1, :4] = np.nan
    spectra[2, :7] = np.nan
    found = unmix(spectra, stds, library, paper)
    assert (np.abs(found.abundance - 0.3) < 5 * found.abundance_std).values[:2].all()
    assert found.abundance.values[:2] == pytest.approx(0.3, abs=0.02)
    assert (found.abundance_std[1] > found.abundance_std[0]).all()
    assert np.isnan(found.abundance.values[2]).all()
    assert np.isnan(found.abundance_std.values[2]).all()


def test_libraries_that_the_bands_do_not_resolve_are_refused(paper: hf.Instrument) -> None:
    chart = SpectralLibrary.colorchecker()
    spectra = xr.DataArray(np.ones((2, 9)), dims=("pixel", "band"))
    with pytest.raises(HueflightError, match="9 bands can't tell 24 materials apart"):
        unmix(spectra, spectra, chart, paper)
    twins = SpectralLibrary(
        ("wood", "oak", "ink"),
        chart.wavelengths_nm,
        np.stack([chart.reflectance[0], 1.5 * chart.reflectance[0], chart.reflectance[12]]),
    )
    with pytest.raises(HueflightError, match="most similar are 'wood' and 'oak'"):
        unmix(spectra, spectra, twins, paper)
    with pytest.raises(HueflightError, match=r"'pixel': 2, 'band': 4.*has 9 bands"):
        unmix(spectra[:, :4], spectra, materials(*chart.names[:2]), paper)
