# SPDX-License-Identifier: Apache-2.0
"""Photon-HDF5: lists of single photons with time stamps, as single-molecule labs exchange them.

Format: A. Ingargiola et al., Biophys. J. 110, 26 (2016), and photon-hdf5.org.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hueflight.errors import FileFormatError, InstrumentError
from hueflight.files import import_optional
from hueflight.importers.arrays import read_array_counts
from hueflight.importers.options import ReadOptions, require_instrument
from hueflight.model.instrument import Instrument
from hueflight.recognition import why_unreadable

GROUP = "photon_data"
TOLERANCE = 1e-3  #: relative, of the width of a bin


def read_hdf5(
    path: Path, instrument: Instrument | None, options: ReadOptions, /
) -> tuple[NDArray[Any], Instrument]:
    """Read counts from an HDF5 file: an array, or the photons of a Photon-HDF5 file.

    Parameters
    ----------
    path : pathlib.Path
        Path of the file.
    instrument : Instrument, optional
        Instrument that made the counts; of a Photon-HDF5 file, one of a single pixel.
    options : ReadOptions
        Name of the array and its axes, or the detector of a Photon-HDF5 file as `channel`.

    Returns
    -------
    counts : numpy.ndarray, shape (row, col, code)
        The counts.
    instrument : Instrument
        The instrument that made them.

    Raises
    ------
    FileFormatError
        If the file can't be read, or it is not clear which array or detector is meant.
    InstrumentError
        If no instrument is known, or it does not fit the file.
    """
    h5py = import_optional("h5py", extra="import")
    try:
        with h5py.File(path, "r") as file:
            # other entries may be missing
            found = {
                name: file[f"{GROUP}/{name}"][...]
                for name in ("nanotimes", "detectors", "nanotimes_specs/tcspc_unit")
                if options.dataset is None and f"{GROUP}/{name}" in file
            }
    except OSError as error:
        raise FileFormatError(why_unreadable(path, error)) from error
    if "nanotimes" not in found:
        return read_array_counts(path, instrument, options)
    times, detectors = found["nanotimes"], found.get("detectors")
    unit_s = found.get("nanotimes_specs/tcspc_unit")
    options.refuse_all_but("channel", path=path)
    instrument = require_instrument(instrument, path)
    if instrument.image_shape != (1, 1):
        raise InstrumentError(
            f"{str(path)!r} holds the photons of a point, but the instrument has "
            f"{instrument.image_shape[0]} rows and {instrument.image_shape[1]} columns: give rows "
            "= 1 and cols = 1"
        )
    width_ns = instrument.sensor.bin_width_ns
    if unit_s is not None and abs(float(unit_s) * 1e9 / width_ns - 1) > TOLERANCE:
        raise InstrumentError(
            f"{str(path)!r} has bins of {float(unit_s) * 1e9:g} ns, the instrument "
            f"{width_ns:g} ns: change sensor.bin_width_ns"
        )
    if detectors is not None:
        present = np.unique(detectors).tolist()
        if options.channel is None and len(present) > 1:
            raise FileFormatError(
                f"{str(path)!r} has photons of the detectors {', '.join(map(str, present))}: say "
                "which with channel (--channel)"
            )
        if options.channel is not None and options.channel not in present:
            raise FileFormatError(
                f"{str(path)!r} has no photons of detector {options.channel}; it has "
                f"{', '.join(map(str, present))}"
            )
        if options.channel is not None:
            times = times[detectors == options.channel]
    codes = instrument.sensor.codes
    if times.size and int(times.max()) >= codes:
        raise InstrumentError(
            f"{str(path)!r} has times up to code {int(times.max())}, the instrument codes up to "
            f"{codes - 1}: raise sensor.code_bits"
        )
    counts = np.bincount(times.astype(np.intp), minlength=codes).astype(np.uint32)
    return counts.reshape(1, 1, codes), instrument
