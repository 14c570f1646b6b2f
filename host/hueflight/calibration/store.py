"""A calibration on disk: a Zarr directory that is whole or not there.

Arrays are Zarr v3 arrays of one group; what is not an array stands in the group's attributes.
The format number rises whenever an older reader would be misled.
"""

from __future__ import annotations

import os
import shutil
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any, cast

import google_crc32c
import numpy as np
import zarr
from numpy.typing import NDArray

from hueflight.calibration.calibration import Calibration
from hueflight.calibration.pulse_windows import PulseWindow
from hueflight.errors import CalibrationError, InstrumentError
from hueflight.model.emission import Emission
from hueflight.model.instrument import Instrument
from hueflight.model.time_bins import TimeBins
from hueflight.model.waveforms import Templates

FORMAT = "hueflight calibration"
FORMAT_NUMBER = 1
PIXEL_PLANES = ("pixel_delay_ns", "pixel_delay_std_ns", "flat_field", "dead", "hot")
BAND_VECTORS = ("gain", "brightness")


def save(calibration: Calibration, path: Path, *, overwrite: bool = False) -> None:
    """Write under a temporary name beside `path`, then rename; see `Calibration.save`."""
    if path.exists() and not overwrite:
        raise CalibrationError(f"{path} exists: choose another name, or say overwrite=True")
    partial = path.with_name(f".{path.name}.partial-{os.getpid()}")
    retired = path.with_name(f".{path.name}.retired-{os.getpid()}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        shutil.rmtree(partial, ignore_errors=True)
        _write(calibration, partial)
        if path.exists():  # a directory that holds something can't be renamed over
            path.rename(retired)
        partial.rename(path)
    except OSError as error:
        if retired.exists() and not path.exists():
            retired.rename(path)
        raise CalibrationError(f"can't write calibration {path}: {error}") from None
    finally:
        shutil.rmtree(partial, ignore_errors=True)
        shutil.rmtree(retired, ignore_errors=True)


def load(path: Path) -> Calibration:
    """Read what `save` wrote; see `Calibration.load`."""
    if not path.exists():
        raise CalibrationError(f"no calibration {path}: there is no such folder")
    try:
        group = zarr.open_group(path, mode="r")
        attributes = dict(group.attrs)
    except Exception as error:  # zarr raises many kinds for what is not a store
        raise CalibrationError(
            f"{path} is not a calibration: Zarr can't open it ({_reason(error)})"
        ) from None
    if attributes.get("format") != FORMAT:
        raise CalibrationError(
            f"{path} is not a calibration: it is a Zarr store whose format is "
            f"{attributes.get('format')!r}, not {FORMAT!r}"
        )
    if attributes.get("format_number") != FORMAT_NUMBER:
        raise CalibrationError(
            f"{path} has calibration format {attributes.get('format_number')!r}, this software "
            f"reads {FORMAT_NUMBER}: update the software or calibrate again"
        )
    try:
        return _read(group, attributes)
    except (CalibrationError, InstrumentError) as error:
        raise CalibrationError(f"calibration {path} can't be used: {error}") from None
    except Exception as error:  # missing arrays, broken chunks, ill-typed attributes
        raise CalibrationError(
            f"calibration {path} is damaged: {_reason(error)}. Restore it or calibrate again"
        ) from None


def _write(calibration: Calibration, path: Path) -> None:
    group = zarr.create_group(path, zarr_format=3)
    arrays: dict[str, NDArray[Any]] = {
        name: getattr(calibration, name) for name in PIXEL_PLANES + BAND_VECTORS
    }
    arrays["reference"] = calibration.reference
    arrays["bin_edges_ns"] = calibration.bins.edges_ns
    arrays["bin_codes"] = calibration.bins.codes.astype(np.int64)
    arrays["templates"] = calibration.templates.coefficients
    arrays["windows"] = np.array(
        [(window.band, window.start, window.stop) for window in calibration.windows], np.int64
    )
    if calibration.frames is not None:
        arrays["frames"] = np.asarray(calibration.frames)
    if calibration.emission is not None:
        arrays["emission_nm"] = calibration.emission.wavelengths_nm
        arrays["emission_power"] = calibration.emission.power
    for name, values in arrays.items():
        # a few MB a chunk: rows of the reference, anything else whole
        rows = max(1, min(values.shape[0], int(4e6 * values.shape[0] / max(values.nbytes, 1))))
        group.create_array(
            name, data=np.ascontiguousarray(values), chunks=(rows, *values.shape[1:])
        )
    instrument = calibration.instrument
    # the attributes come last: without them the store is not taken for a calibration
    group.attrs.update(
        {
            "format": FORMAT,
            "format_number": FORMAT_NUMBER,
            "saved": datetime.now(UTC).isoformat(timespec="seconds"),
            "saved_by": f"hueflight {version('hueflight')}",
            "instrument": instrument.to_json(),
            "instrument_name": instrument.name,
            "instrument_fingerprint": instrument.fingerprint(),
            "distance_m": calibration.distance,
            "circle_ns": calibration.templates.circle_ns,
            "crc32c": {name: _checksum(values) for name, values in arrays.items()},
            "provenance": calibration.provenance,
        }
    )


def _read(group: zarr.Group, attributes: dict[str, Any]) -> Calibration:
    instrument = Instrument.from_json(attributes["instrument"], where="its instrument")
    if instrument.fingerprint() != attributes["instrument_fingerprint"]:
        raise CalibrationError(
            "its instrument does not match its fingerprint: the file was edited, or written by "
            "software that describes instruments otherwise"
        )

    def array(name: str) -> NDArray[Any]:
        values = np.asarray(cast("zarr.Array", group[name])[...])
        # Zarr reads a missing chunk as zeros and says nothing
        if _checksum(values) != attributes["crc32c"][name]:
            raise ValueError(f"{name} does not match its checksum")
        return values

    bins = TimeBins(
        array("bin_codes").astype(np.intp), array("bin_edges_ns"), instrument.timing.period_ns
    )
    rows, cols, _ = instrument.histogram_shape
    expected = {
        "reference": (rows, cols, bins.count),
        "bin_edges_ns": (bins.count + 1,),
        **dict.fromkeys(BAND_VECTORS, (len(instrument.bands),)),
        **dict.fromkeys(PIXEL_PLANES, (rows, cols)),
    }
    values = {name: array(name) for name in expected}
    for name, shape in expected.items():
        if values[name].shape != shape:
            raise CalibrationError(f"{name} has shape {values[name].shape}, expected {shape}")
    del values["bin_edges_ns"]
    emission = None
    if "emission_nm" in group:
        emission = Emission(array("emission_nm"), array("emission_power"))
        emission.require(instrument)
    return Calibration(
        instrument=instrument,
        distance=float(attributes["distance_m"]),
        bins=bins,
        frames=array("frames") if "frames" in group else None,
        windows=tuple(PulseWindow(*map(int, window)) for window in array("windows")),
        templates=Templates(array("templates"), float(attributes["circle_ns"])),
        emission=emission,
        provenance=dict(attributes["provenance"]),
        **values,
    )


def _checksum(values: NDArray[Any]) -> int:
    return google_crc32c.value(np.ascontiguousarray(values).tobytes())


def _reason(error: Exception) -> str:
    """Type and first line of an error from below."""
    text = str(error).strip().splitlines()
    return f"{type(error).__name__}: {text[0]}" if text else type(error).__name__
