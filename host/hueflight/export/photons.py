# SPDX-License-Identifier: Apache-2.0
"""Photon lists as Photon-HDF5, for software that analyses single photons.

This follows the Photon-HDF5 specification, version 0.5 (A. Ingargiola et al., Biophys. J. 110, 26,
2016; https://photon-hdf5.readthedocs.io): one entry per photon with the time of its exposure,
its arrival within the period (nanotime) and its pixel.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable
from datetime import UTC, datetime
from importlib import resources
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hueflight.errors import ExportError
from hueflight.export.hdf5 import buffering_file
from hueflight.files import import_optional, staged
from hueflight.model.instrument import Instrument

CHUNK_PHOTONS = 1 << 16
FORMAT = {
    "format_name": "Photon-HDF5",
    "format_version": "0.5",
    "format_url": "http://photon-hdf5.org/",
}


def write_photons(
    frames: Iterable[NDArray[np.integer]],
    instrument: Instrument,
    path: str | Path,
    /,
    *,
    frame_rate_hz: float | None = None,
    description: str = "",
    author: str = "unknown",
    overwrite: bool = False,
) -> int:
    """Write every photon of a sequence of frames as a Photon-HDF5 file.

    `timestamps` count frames. `nanotimes` count bins of the period in order of arrival: later
    photons have larger values, whatever the direction of the converter. If the first bin of the
    period is partial, bin n ≥ 1 starts at `first_bin_width_ns` + (n − 1) · `tcspc_unit` (see
    `/user/hueflight`). `detectors` are row · cols + col.

    Parameters
    ----------
    frames : iterable of numpy.ndarray of int, shape (frame, row, col) or (row, col)
        Raw codes, in order of time.
    instrument : Instrument
        Instrument that made them.
    path : str or pathlib.Path
        Name of the file.
    frame_rate_hz : float, optional
        Frames per second; by default those of the sensor.
    description : str
        Description that the format requires; by default a summary.
    author : str
        Author that the format requires.
    overwrite : bool
        Whether an existing file of this name may be replaced.

    Returns
    -------
    int
        Number of photons.

    Raises
    ------
    ExportError
        If there is no frame rate, a frame has another shape, or the sensor has no such code.
    OutputError
        If the file exists already or can't be written.
    """
    rate = frame_rate_hz if frame_rate_hz is not None else instrument.sensor.frame_rate_hz
    if rate is None or not (np.isfinite(rate) and rate > 0):
        raise ExportError(
            f"frame_rate_hz = {rate!r}: photon lists need the frame rate; give it here or as "
            "sensor.frame_rate_hz of the instrument"
        )
    h5py = import_optional("h5py", extra="export")
    with (
        staged(path, overwrite=overwrite) as partial,
        buffering_file(partial) as disk,
        h5py.File(disk, "w") as file,
    ):
        arrays = _photon_arrays(file, instrument)
        counts = np.zeros(int(np.prod(instrument.image_shape)), dtype=np.int64)
        total = 0
        for block in frames:
            total += _append(arrays, block, total, instrument, counts)
            disk.raise_failure()  # stop a long export as soon as the disk is full
        _describe(file, instrument, rate, description=description, frames=total, counts=counts)
        _identify(file, author=author, name=Path(path).name)
        _entitle(file)
        return int(counts.sum())


def _photon_arrays(file: Any, instrument: Instrument) -> dict[str, Any]:
    """Create the arrays of photons, which are empty and can grow."""
    pixels = int(np.prod(instrument.image_shape))
    group = file.create_group("photon_data")
    kinds = {
        "timestamps": np.int64,
        "nanotimes": np.min_scalar_type(instrument.time_bins().count),
        "detectors": np.min_scalar_type(pixels),
    }
    return {
        name: group.create_dataset(
            name,
            shape=(0,),
            maxshape=(None,),
            chunks=(CHUNK_PHOTONS,),
            dtype=kind,
            compression="gzip",
            compression_opts=1,
            shuffle=True,
        )
        for name, kind in kinds.items()
    }


def _append(
    arrays: dict[str, Any],
    block: NDArray[np.integer],
    first_frame: int,
    instrument: Instrument,
    counts: NDArray[np.int64],
) -> int:
    """Append the photons of one block and return its number of frames."""
    codes = np.asarray(block)
    if codes.ndim == 2:
        codes = codes[None]
    if codes.ndim != 3 or codes.shape[1:] != instrument.image_shape or codes.dtype.kind not in "ui":
        raise ExportError(
            f"frames from {first_frame} on have shape {codes.shape} and type {codes.dtype}; "
            f"instrument {instrument.name!r} makes whole numbers (frame, "
            f"{instrument.image_shape[0]}, {instrument.image_shape[1]})"
        )
    bin_of_code = np.full(instrument.sensor.codes, -1)
    bins = instrument.time_bins()
    bin_of_code[bins.codes] = np.arange(bins.count)
    hit = codes != 0 if instrument.sensor.reports_empty else np.ones(codes.shape, dtype=bool)
    frame, row, col = np.nonzero(hit)
    found = codes[frame, row, col]
    outside = (found < 0) | (found >= bin_of_code.size)
    nanotime = np.where(outside, -1, bin_of_code[np.where(outside, 0, found)])
    if (nanotime < 0).any():
        first = int(np.argmax(nanotime < 0))
        raise ExportError(
            f"code {found[first]} of frame {first_frame + frame[first]}, pixel "
            f"({row[first]}, {col[first]}) lies outside the period of instrument "
            f"{instrument.name!r}, which uses codes {bins.codes.min()} to {bins.codes.max()}"
        )
    detector = row * instrument.image_shape[1] + col
    np.add.at(counts, detector, 1)
    columns = {"timestamps": first_frame + frame, "nanotimes": nanotime, "detectors": detector}
    for name, values in columns.items():
        array = arrays[name]
        array.resize(array.shape[0] + values.size, axis=0)
        if values.size:
            array[-values.size :] = values
    return codes.shape[0]


def _describe(
    file: Any,
    instrument: Instrument,
    rate: float,
    *,
    description: str,
    frames: int,
    counts: NDArray[np.int64],
) -> None:
    """Write the fields about time, detectors and light that the format requires."""
    bins = instrument.time_bins()
    unit_s = instrument.sensor.bin_width_ns * 1e-9
    rows, cols = instrument.image_shape
    file["acquisition_duration"] = frames / rate
    file["description"] = _text(description or f"Photons of {frames} frames of {instrument.name}")
    data = file["photon_data"]
    data["timestamps_specs/timestamps_unit"] = 1 / rate
    data["nanotimes_specs/tcspc_unit"] = unit_s
    data["nanotimes_specs/tcspc_num_bins"] = bins.count
    data["nanotimes_specs/tcspc_range"] = bins.count * unit_s
    setup = file.create_group("setup")
    bands = sorted(instrument.bands, key=lambda band: band.wavelength_nm)
    for name, value in {
        "num_pixels": rows * cols,
        "num_spots": 1,
        "num_spectral_ch": 1,  # of detection: the sensor does not distinguish colours
        "num_polarization_ch": 1,
        "num_split_ch": 1,
        "modulated_excitation": 1,
        "excitation_alternated": np.ones(len(bands), dtype=np.uint8),
        "excitation_cw": np.zeros(len(bands), dtype=np.uint8),
        "lifetime": 1,
        "excitation_wavelengths": np.array([band.wavelength_nm for band in bands]) * 1e-9,
        "excitation_input_powers": np.array([band.power_mw for band in bands]) * 1e-3,
    }.items():
        setup[name] = value
    index = np.arange(rows * cols)
    setup["detectors/id"] = index
    setup["detectors/counts"] = counts
    setup["detectors/position"] = np.stack([index % cols, index // cols], axis=1)
    own = file.create_group("user/hueflight")
    own["instrument_description"] = _text(instrument.to_json())
    own["first_bin_width_ns"] = bins.widths_ns[0]
    own["code_of_nanotime"] = bins.codes.astype(np.int64)
    own["bin_edges_ns"] = bins.edges_ns


def _identify(file: Any, *, author: str, name: str) -> None:
    """Write the author, the software and the version of the format."""
    for key, value in FORMAT.items():
        file.attrs[key] = _text(value)
    identity = file.create_group("identity")
    for key, value in {
        "author": author,
        "author_affiliation": "unknown",
        "creation_time": datetime.now(UTC).strftime("%Y-%m-%d %H:%M:%S"),
        "software": "hueflight",
        "software_version": version("hueflight"),
        "filename": name,
        **FORMAT,
    }.items():
        identity[key] = _text(value)


def _entitle(file: Any) -> None:
    """Write the title that the format prescribes for each field, which its readers check."""
    source = resources.files("hueflight.export") / "photon_hdf5_titles.csv"
    titles = {
        row["field"]: row["title"] for row in csv.DictReader(source.read_text("utf-8").splitlines())
    }
    for field, title in titles.items():
        if field in file:
            file[field].attrs["TITLE"] = _text(title)


def _text(value: str) -> np.bytes_:
    """Return text as bytes of fixed length, as the format requires."""
    return np.bytes_(value.encode("utf-8"))
