# SPDX-License-Identifier: Apache-2.0
"""Reference spectra: recognised in a simulated scene, colours against published figures."""

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import hueflight as hf
from hueflight.analysis import SpectralLibrary, delta_e_2000, lab, match
from hueflight.analysis.library import bands_to_xyz
from hueflight.color import tristimulus
from hueflight.color.color_chart import PATCHES
from hueflight.color.recovery import NODES_NM
from hueflight.errors import FileFormatError, HueflightError

# Sharma, Wu and Dalal, Color Res. Appl. 30, 21 (2005), table 1: L a b, L a b, ΔE00
SHARMA = np.fromstring(
    """
50 2.6772 -79.7751 50 0 -82.7485 2.0425      50 3.1571 -77.2803 50 0 -82.7485 2.8615
50 2.8361 -74.0200 50 0 -82.7485 3.4412      50 -1.3802 -84.2814 50 0 -82.7485 1.0000
50 -1.1848 -84.8006 50 0 -82.7485 1.0000     50 -0.9009 -85.5211 50 0 -82.7485 1.0000
50 0 0 50 -1 2 2.3669                        50 -1 2 50 0 0 2.3669
50 2.4900 -0.0010 50 -2.4900 0.0009 7.1792   50 2.4900 -0.0010 50 -2.4900 0.0010 7.1792
50 2.4900 -0.0010 50 -2.4900 0.0011 7.2195   50 2.4900 -0.0010 50 -2.4900 0.0012 7.2195
50 -0.0010 2.4900 50 0.0009 -2.4900 4.8045   50 -0.0010 2.4900 50 0.0010 -2.4900 4.8045
50 -0.0010 2.4900 50 0.0011 -2.4900 4.7461   50 2.5 0 50 0 -2.5 4.3065
50 2.5 0 73 25 -18 27.1492                   50 2.5 0 61 -5 29 22.8977
50 2.5 0 56 -27 -3 31.9030                   50 2.5 0 58 24 15 19.4535
50 2.5 0 50 3.1736 0.5854 1.0000             50 2.5 0 50 3.2972 0 1.0000
50 2.5 0 50 1.8634 0.5757 1.0000             50 2.5 0 50 3.2592 0.3350 1.0000
60.2574 -34.0099 36.2677 60.4626 -34.1751 39.4387 1.2644
63.0109 -31.0961 -5.8663 62.8187 -29.7946 -4.0864 1.2630
61.2901 3.7196 -5.3901 61.4292 2.2480 -4.9620 1.8731
35.0831 -44.1164 3.7933 35.0232 -40.0716 1.5901 1.8645
22.7233 20.0904 -46.6940 23.0331 14.9730 -42.5619 2.0373
36.4612 47.8580 18.3852 36.2715 50.5065 21.2231 1.4146
90.8027 -2.0831 1.4410 91.1528 -1.6435 0.0447 1.4441
90.9257 -0.5406 -0.9208 88.6381 -0.8985 -0.7239 1.5381
6.7747 -0.2908 -2.4247 5.8714 -0.0985 -2.2286 0.6377
2.0776 0.0795 -1.1350 0.9033 -0.0636 -0.5514 0.9082
""",
    sep=" ",
).reshape(34, 7)


@pytest.fixture(scope="module")
def paper() -> hf.Instrument:
    return hf.Instrument.load("paper")


@pytest.fixture(scope="module")
def chart() -> SpectralLibrary:
    return SpectralLibrary.colorchecker()


def test_colour_difference_by_the_published_pairs() -> None:
    found = delta_e_2000(SHARMA[:, :3], SHARMA[:, 3:6])
    np.testing.assert_allclose(found, SHARMA[:, 6], atol=5.1e-5)
    np.testing.assert_allclose(delta_e_2000(SHARMA[:, 3:6], SHARMA[:, :3]), found, atol=1e-12)
    assert (delta_e_2000(SHARMA[:, :3], SHARMA[:, :3]) == 0).all()


def test_lab_of_known_colours() -> None:
    white = [0.95047, 1.0, 1.08883]
    found = lab([white, [0, 0, 0], [v * 0.18418651851244416 for v in white]], white=white)
    # 18.4 % grey has L* = 50 by definition
    np.testing.assert_allclose(found, [[100, 0, 0], [0, 0, 0], [50, 0, 0]], atol=1e-6)


def test_colours_from_nine_bands_are_near_the_true_ones(
    paper: hf.Instrument, chart: SpectralLibrary
) -> None:
    to_xyz = tristimulus(NODES_NM, illuminant="C")
    white = to_xyz.sum(axis=1)
    true = lab(chart.at(NODES_NM) @ to_xyz.T, white=white)
    seen = lab(chart.in_bands(paper).values @ bands_to_xyz(paper).T, white=white)
    error = delta_e_2000(true, seen)
    # a map trained on Munsell spectra reaches 0.58 on average and 1.4 at most
    assert error.mean() < 0.8
    assert error.max() < 3
    neutral = lab(np.full((1, 9), 0.4) @ bands_to_xyz(paper).T, white=white)
    assert np.abs(neutral[0, 1:]).max() < 0.5, "grey must come out grey"


def test_patches_are_recognised_through_noise(paper: hf.Instrument, chart: SpectralLibrary) -> None:
    truth = chart.in_bands(paper)
    noise = np.random.default_rng(0).normal(0, 0.002, (20, *truth.shape))
    measured = xr.DataArray(truth.values + noise, dims=("trial", "patch", "band"))
    found = match(measured, chart, paper)
    assert found["angle"].dims == ("trial", "patch", "entry")
    names = np.array(list(PATCHES))
    coloured = ~np.char.startswith(names.astype(str), "neutral") & (names != "white")
    coloured &= names != "black"  # greys differ in brightness only, to which angles are blind
    np.testing.assert_array_equal(
        found["best"].values[:, coloured], np.tile(names[coloured], (20, 1))
    )
    nearest = names[found["delta_e"].values.argmin(axis=-1)]
    assert (nearest == names).mean() > 0.97, "colour difference tells the greys apart, too"


def test_perfect_spectra_match_perfectly(paper: hf.Instrument, chart: SpectralLibrary) -> None:
    found = match(chart.in_bands(paper).rename(entry="patch"), chart, paper)
    angle, difference = found["angle"].values, found["delta_e"].values
    assert np.diag(angle).max() < 1e-12
    assert np.diag(difference).max() < 1e-6
    assert (angle + 1e-12 >= np.diag(angle)).all()


def test_unknown_spectra_match_nothing(paper: hf.Instrument, chart: SpectralLibrary) -> None:
    spectra = xr.DataArray(np.full((2, 9), np.nan), dims=("pixel", "band"))
    found = match(spectra, chart, paper)
    assert list(found["best"].values) == ["", ""]
    assert np.isnan(found["angle"]).all()


def test_infrared_has_no_colour() -> None:
    camera = hf.Instrument.from_toml(
        """
        name = "infrared"
        [sensor]
        rows = 1
        cols = 1
        code_bits = 6
        bin_width_ns = 1.0
        [[bands]]
        name = "a"
        wavelength_nm = 850
        [[bands]]
        name = "b"
        wavelength_nm = 940
        """
    )
    library = SpectralLibrary(
        ("leaf", "soil"), np.array([800.0, 1000.0]), np.array([[0.5, 0.5], [0.2, 0.3]])
    )
    spectra = xr.DataArray([0.5, 0.5], dims="band")
    found = match(spectra, library, camera)
    assert str(found["best"].values) == "leaf"
    assert np.isnan(found["delta_e"]).all()
    with pytest.raises(HueflightError, match="'a' at 850 nm lies outside the library"):
        match(spectra, SpectralLibrary(("x",), np.array([400.0, 700.0]), np.ones((1, 2))), camera)


def test_library_from_csv(tmp_path: Path) -> None:
    (tmp_path / "lib.csv").write_text(
        "# measured indoors\nwavelength_nm, red brick ,blue brick\n400,0.1,0.6\n700,0.5,0.1\n"
    )
    found = SpectralLibrary.load(tmp_path / "lib.csv")
    assert found.names == ("red brick", "blue brick")
    np.testing.assert_allclose(found.at(np.array([550.0])), [[0.3], [0.35]])


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "give a heading"),
        ("nm,a\n", "give a heading"),
        ("nm,a\n400,x\n", r"line 2: \['400', 'x'\]"),
        ("nm,a\n400,0.1,0.2\n", "line 2 has 3 entries, the heading 2"),
        ("nm,a\n500,0.1\n400,0.2\n", "wavelengths must rise"),
        ("nm,a\n400,nan\n", "must all be numbers"),
    ],
)
def test_libraries_that_cannot_be_read(tmp_path: Path, text: str, complaint: str) -> None:
    (tmp_path / "lib.csv").write_text(text)
    with pytest.raises(FileFormatError, match=complaint):
        SpectralLibrary.load(tmp_path / "lib.csv")
    with pytest.raises(FileFormatError, match="can't read library"):
        SpectralLibrary.load(tmp_path / "none.csv")


def test_spectra_of_other_bands_are_refused(paper: hf.Instrument, chart: SpectralLibrary) -> None:
    with pytest.raises(HueflightError, match="has 9 bands"):
        match(xr.DataArray(np.ones(3), dims="band"), chart, paper)
