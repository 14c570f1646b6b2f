# SPDX-License-Identifier: Apache-2.0
"""Histograms and photon lists in HDF5, read by h5py."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from numpy.typing import NDArray

import hueflight as hf
from hueflight.errors import ExportError, HistogramError
from hueflight.export import write_histogram, write_photons
from hueflight.simulator import scene, simulate_codes, simulate_histogram


def test_histogram_is_kept_exactly(
    counts: NDArray[Any], camera: hf.Instrument, tmp_path: Path, same: Callable[..., None]
) -> None:
    write_histogram(counts, camera, tmp_path / "h.h5")
    with h5py.File(tmp_path / "h.h5") as file:
        same(file["histogram"][:], counts)
        np.testing.assert_array_equal(file["frames"][:], 2000)
        start, width = file["code_start_ns"][:], file["code_width_ns"][:]
        assert file["histogram"].attrs["code_0"] == "exposures without a photon"
        assert file.attrs["wavelengths_nm"].tolist() == camera.wavelengths_nm.tolist()
        assert hf.Instrument.from_json(file.attrs["instrument_description"]) == camera
        assert file.attrs["software"].startswith("hueflight ")
    # reverse mode: code 1 ends the period of 320 ns, code 499 is the partial bin at its start
    assert start[1] == pytest.approx(320 - 0.642)
    assert (start[499], width[499]) == pytest.approx((0, 320 - 498 * 0.642))
    assert np.isnan(start[0])
    assert np.isnan(start[500])


def test_counts_of_another_instrument_are_refused(counts: NDArray[Any], tmp_path: Path) -> None:
    with pytest.raises(HistogramError, match="shape"):
        write_histogram(counts, hf.Instrument.load("paper"), tmp_path / "h.h5")
    assert not list(tmp_path.iterdir())


@pytest.fixture(scope="module")
def codes(camera: hf.Instrument) -> NDArray[np.integer]:
    drawn = simulate_codes(scene("colorchecker", camera), camera, frames=40, seed=3)
    return np.concatenate(list(drawn)) if not isinstance(drawn, np.ndarray) else drawn


def test_photon_list_holds_every_photon_once(
    codes: NDArray[np.integer], camera: hf.Instrument, tmp_path: Path
) -> None:
    total = write_photons([codes[:7], codes[7], codes[8:]], camera, tmp_path / "p.h5")
    with h5py.File(tmp_path / "p.h5") as file:
        data = {name: file[f"photon_data/{name}"][:] for name in
                ("timestamps", "nanotimes", "detectors")}  # fmt: skip
        code_of = file["user/hueflight/code_of_nanotime"][:]
        edges = file["user/hueflight/bin_edges_ns"][:]
        unit = file["photon_data/timestamps_specs/timestamps_unit"][()]
        assert file["photon_data/nanotimes_specs/tcspc_num_bins"][()] == 499
        assert file["photon_data/nanotimes_specs/tcspc_unit"][()] == pytest.approx(0.642e-9)
        np.testing.assert_array_equal(
            file["setup/detectors/counts"][:], (codes != 0).sum(axis=0).ravel()
        )
    assert unit == pytest.approx(1 / 480)
    assert total == data["timestamps"].size == np.count_nonzero(codes)
    assert (np.diff(data["timestamps"]) >= 0).all()
    rebuilt = np.zeros_like(codes)
    row, col = np.divmod(data["detectors"].astype(int), camera.image_shape[1])
    rebuilt[data["timestamps"], row, col] = code_of[data["nanotimes"]]
    np.testing.assert_array_equal(rebuilt, codes)
    # later photons have smaller codes but larger nanotimes
    np.testing.assert_allclose(edges, camera.time_bins().edges_ns)
    assert (np.diff(code_of) == -1).all()


# Photon-HDF5 0.5: mandatory fields and what kind each is
MANDATORY = {
    "acquisition_duration": "scalar", "description": "string",
    "photon_data/timestamps": "array", "photon_data/detectors": "array",
    "photon_data/nanotimes": "array",
    "photon_data/timestamps_specs/timestamps_unit": "scalar",
    "photon_data/nanotimes_specs/tcspc_unit": "scalar",
    "photon_data/nanotimes_specs/tcspc_num_bins": "scalar",
    "setup/num_pixels": "scalar", "setup/num_spots": "scalar",
    "setup/num_spectral_ch": "scalar", "setup/num_polarization_ch": "scalar",
    "setup/num_split_ch": "scalar", "setup/modulated_excitation": "scalar",
    "setup/lifetime": "scalar", "setup/excitation_alternated": "array",
    "setup/excitation_cw": "array",
    "identity/creation_time": "string", "identity/software": "string",
    "identity/software_version": "string", "identity/format_name": "string",
    "identity/format_version": "string", "identity/format_url": "string",
}  # fmt: skip


def test_photon_list_has_what_the_format_demands(
    codes: NDArray[np.integer], camera: hf.Instrument, tmp_path: Path
) -> None:
    write_photons([codes], camera, tmp_path / "p.h5", author="A. Researcher", description="test")
    with h5py.File(tmp_path / "p.h5") as file:
        for name, kind in MANDATORY.items():
            field = file[name]
            assert (field.ndim > 0) == (kind == "array"), name
            assert (field.dtype.kind == "S") == (kind == "string"), name
        assert file.attrs["format_name"] == b"Photon-HDF5"
        assert file["identity/author"][()] == b"A. Researcher"
        untitled = []
        file.visititems(lambda name, node: untitled.append(name) if "TITLE" not in node.attrs
                        and not name.startswith("user") else None)  # fmt: skip
        assert not untitled
        wavelengths = file["setup/excitation_wavelengths"][:]
        assert (np.diff(wavelengths) > 0).all()
        assert json.loads(file["user/hueflight/instrument_description"][()])["name"] == "paper"


def test_photon_list_by_the_reference_validator(
    codes: NDArray[np.integer], camera: hf.Instrument, tmp_path: Path
) -> None:
    phconvert = pytest.importorskip("phconvert", reason="phconvert is not installed (extra dev)")
    tables = pytest.importorskip("tables")
    write_photons([codes], camera, tmp_path / "p.h5")
    with tables.open_file(str(tmp_path / "p.h5")) as file:
        # measurement_specs, optional, names kinds of measurement among which imaging is not
        phconvert.hdf5.assert_valid_photon_hdf5(file, warnings=False, skip_measurement_specs=True)


def test_histogram_of_the_photon_list_is_the_histogram(
    codes: NDArray[np.integer], camera: hf.Instrument, tmp_path: Path
) -> None:
    write_photons([codes], camera, tmp_path / "p.h5")
    with h5py.File(tmp_path / "p.h5") as file:
        nanotimes = file["photon_data/nanotimes"][:]
    seen = np.bincount(nanotimes, minlength=499)
    wanted = np.bincount(codes[codes != 0].ravel(), minlength=512)
    np.testing.assert_array_equal(seen, camera.time_bins().in_time_order(wanted))
    whole = simulate_histogram(scene("colorchecker", camera), camera, frames=5, seed=1)
    assert whole.shape == camera.histogram_shape


def test_frames_that_do_not_fit_are_refused(camera: hf.Instrument, tmp_path: Path) -> None:
    frame = np.zeros(camera.image_shape, np.uint16)
    wild = frame.copy()
    wild[2, 3] = 505  # beyond the period: no such arrival time
    with pytest.raises(ExportError, match=r"code 505 of frame 1, pixel \(2, 3\) lies outside"):
        write_photons([frame, wild], camera, tmp_path / "p.h5")
    with pytest.raises(ExportError, match="frames from 1 on have shape"):
        write_photons([frame, frame.T], camera, tmp_path / "p.h5")
    with pytest.raises(ExportError, match="frame_rate_hz = 0"):
        write_photons([frame], camera, tmp_path / "p.h5", frame_rate_hz=0)
    assert not list(tmp_path.iterdir())


def test_an_empty_run_is_an_empty_list(camera: hf.Instrument, tmp_path: Path) -> None:
    assert write_photons([np.zeros((4, *camera.image_shape), np.uint16)], camera,
                         tmp_path / "p.h5") == 0  # fmt: skip
    with h5py.File(tmp_path / "p.h5") as file:
        assert file["photon_data/timestamps"].shape == (0,)
        assert file["acquisition_duration"][()] == pytest.approx(4 / 480)
