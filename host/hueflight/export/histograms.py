# SPDX-License-Identifier: Apache-2.0
"""Raw histograms as HDF5, for software for time-correlated single-photon counting."""

from __future__ import annotations

from importlib.metadata import version
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from hueflight.export.hdf5 import buffering_file
from hueflight.files import import_optional, staged
from hueflight.model.histograms import check_histogram, frames_per_pixel
from hueflight.model.instrument import Instrument


def write_histogram(
    histogram: ArrayLike,
    instrument: Instrument,
    path: str | Path,
    /,
    *,
    frames: ArrayLike | None = None,
    overwrite: bool = False,
) -> None:
    """Write a histogram as HDF5, with the time of every code.

    `/histogram` holds the unchanged counts, with raw codes on the last axis. `/code_start_ns` and
    `/code_width_ns` state which interval of the period each code covers (NaN: none), so that a
    reader need not know the direction of the converter. `/frames` holds the number of exposures of
    each pixel, if it is known.

    Parameters
    ----------
    histogram : array_like, shape (row, col, code)
        Counts.
    instrument : Instrument
        Instrument that made them.
    path : str or pathlib.Path
        Name of the file.
    frames : array_like, scalar or shape (row, col), optional
        Number of exposures; by default as the sensor reports it.
    overwrite : bool
        Whether an existing file of this name may be replaced.

    Raises
    ------
    HistogramError
        If the counts do not fit the instrument.
    OutputError
        If the file exists already or can't be written.
    """
    counts = check_histogram(histogram, instrument)
    exposures = frames_per_pixel(counts, instrument, frames)
    h5py = import_optional("h5py", extra="export")
    bins = instrument.time_bins()
    start_ns = np.full(instrument.sensor.codes, np.nan)
    width_ns = np.full(instrument.sensor.codes, np.nan)
    start_ns[bins.codes], width_ns[bins.codes] = bins.edges_ns[:-1], bins.widths_ns
    rows, cols, codes = counts.shape
    with (
        staged(path, overwrite=overwrite) as partial,
        buffering_file(partial) as disk,
        h5py.File(disk, "w") as file,
    ):
        file.attrs.update(
            software=f"hueflight {version('hueflight')}",
            instrument=instrument.name,
            instrument_fingerprint=instrument.fingerprint(),
            instrument_description=instrument.to_json(),
            wavelengths_nm=instrument.wavelengths_nm,
            band_names=[band.name for band in instrument.bands],
            bin_width_ns=instrument.sensor.bin_width_ns,
        )
        if instrument.timing.period_ns is not None:
            file.attrs["period_ns"] = instrument.timing.period_ns
        data = file.create_dataset(
            "histogram",
            data=counts,
            chunks=(min(rows, 16), min(cols, 16), codes),  # the histogram of a pixel is never split
            compression="gzip",
            compression_opts=1,
            shuffle=True,
        )
        data.attrs.update(units="count", axes=["row", "col", "code"])
        if instrument.sensor.reports_empty:
            data.attrs["code_0"] = "exposures without a photon"
        for name, values, about in (
            ("code_start_ns", start_ns, "start of each code within the period"),
            ("code_width_ns", width_ns, "width of each code"),
        ):
            file.create_dataset(name, data=values)
            file[name].attrs.update(units="ns", long_name=about)
        if exposures is not None:
            file.create_dataset("frames", data=exposures)
            file["frames"].attrs.update(units="count", long_name="exposures behind each pixel")
