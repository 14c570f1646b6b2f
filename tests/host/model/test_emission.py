# SPDX-License-Identifier: Apache-2.0
"""Emission spectra: what they must be like, and their overlap."""

import numpy as np
import pytest

import hueflight as hf
from hueflight.errors import CalibrationError
from hueflight.model.emission import Emission
from hueflight.model.spectra import WAVELENGTH_NM, band_weights


@pytest.fixture(scope="module")
def paper() -> hf.Instrument:
    return hf.Instrument.load("paper")


def write(path, wavelengths, power, head="nm,bands"):
    lines = [head] + [",".join(map(str, row)) for row in np.column_stack([wavelengths, power.T])]
    path.write_text("\n".join(lines))
    return path


def test_nominal_shares_are_those_of_the_simulator(paper):
    """Two ways to the same numbers: here gathered onto nodes, there sampled on them."""
    shares = Emission.nominal(paper).shares(paper, WAVELENGTH_NM)
    np.testing.assert_allclose(shares, band_weights(paper), atol=1e-12)
    coarse = Emission.nominal(paper).shares(paper, np.arange(300.0, 1101.0, 5.0))
    np.testing.assert_allclose(coarse.sum(axis=1), 1)
    np.testing.assert_allclose(
        coarse @ np.arange(300.0, 1101.0, 5.0), shares @ WAVELENGTH_NM, atol=1e-6
    )


def test_file_gives_back_what_was_written(paper, tmp_path):
    nominal = Emission.nominal(paper)
    loaded = Emission.load(
        write(tmp_path / "leds.csv", nominal.wavelengths_nm, nominal.power), paper
    )
    np.testing.assert_array_equal(loaded.power, nominal.power)


def test_overlap(paper):
    overlap = Emission.nominal(paper).overlap(paper)
    np.testing.assert_allclose(np.diag(overlap), 1)
    np.testing.assert_allclose(overlap, overlap.T)
    assert overlap[1, 2] > 0.5, "632 and 623 nm are nearly the same light"
    assert overlap[0, -1] < 1e-4, "659 and 418 nm have nothing in common"


def test_spectra_of_other_leds_are_refused(paper, tmp_path):
    nominal = Emission.nominal(paper)
    turned = write(tmp_path / "turned.csv", nominal.wavelengths_nm, nominal.power[::-1])
    with pytest.raises(CalibrationError, match=r"'deep red' is at 659 nm.*peaks at 418 nm"):
        Emission.load(turned, paper)
    with pytest.raises(CalibrationError, match="of 8 LEDs; instrument 'paper' has 9 bands"):
        Emission(nominal.wavelengths_nm, nominal.power[:8]).require(paper)


@pytest.mark.parametrize(
    ("spoil", "complaint"),
    [
        (lambda w, p: (w[::-1], p), "must rise"),
        (lambda w, p: (w, p * np.nan), "must be a number"),
        (lambda w, p: (w, -p), "0 or more"),
        (lambda w, p: (w, p * (np.arange(9) > 0)[:, None]), r"band\(s\) \[0\] emit nothing"),
        (lambda w, p: (w[:-1], p), "must be \\(band, wavelength\\)"),
    ],
)
def test_spectra_that_make_no_sense(paper, spoil, complaint):
    nominal = Emission.nominal(paper)
    with pytest.raises(CalibrationError, match=complaint):
        Emission(*spoil(nominal.wavelengths_nm, nominal.power))


def test_files_that_cannot_be_read(paper, tmp_path):
    with pytest.raises(CalibrationError, match="can't read emission spectra"):
        Emission.load(tmp_path / "none.csv", paper)
    (tmp_path / "short.csv").write_text("nm,a\n400,1\n")
    with pytest.raises(CalibrationError, match="line 2: needs 10 numbers"):
        Emission.load(tmp_path / "short.csv", paper)


def test_spectra_belong_to_the_calibration(small, draw, tmp_path):
    instrument = small(rows=4, cols=4)
    emission = Emission.nominal(instrument)
    reference = draw(instrument, photons=5000)
    with_spectra = hf.calibrate(reference, instrument, distance=0.5, emission=emission)
    assert with_spectra.provenance["emission"]
    with_spectra.save(tmp_path / "a.zarr")
    loaded = hf.Calibration.load(tmp_path / "a.zarr")
    assert loaded.emission is not None
    np.testing.assert_array_equal(loaded.emission.power, emission.power)
    np.testing.assert_array_equal(loaded.emission.wavelengths_nm, emission.wavelengths_nm)
    without = hf.calibrate(reference, instrument, distance=0.5)
    without.save(tmp_path / "b.zarr")
    assert hf.Calibration.load(tmp_path / "b.zarr").emission is None
    turned = Emission(emission.wavelengths_nm, emission.power[::-1])
    with pytest.raises(CalibrationError, match="columns must stand in the instrument's order"):
        hf.calibrate(reference, instrument, distance=0.5, emission=turned)
