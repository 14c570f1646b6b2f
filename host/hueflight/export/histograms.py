"""Raw histograms as HDF5, for tools of time-correlated photon counting."""

from __future__ import annotations

from importlib.metadata import version
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from hueflight.export.hdf5 import patient_file
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
    """A histogram as HDF5, with the time of every code.

    `/histogram` keeps the counts exactly as they are, raw codes on the last axis;
    `/code_start_ns` and `/code_width_ns` say which stretch of the period each code covers
    (NaN: none), so that a reader need not know the converter's direction.
    `/frames` are the exposures behind each pixel, where they are known.

    Parameters
    ----------
    histogram : (row, col, code) counts.
    instrument : that made them.
    frames : exposures, a number or (row, col); by default as the sensor reports them.

    Raises
    ------
    HistogramError
        If the counts are not this instrument's.
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
        patient_file(partial) as disk,
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
            chunks=(min(rows, 16), min(cols, 16), codes),  # one pixel's curve in one piece
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
