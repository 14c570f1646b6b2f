# SPDX-License-Identifier: Apache-2.0
"""Host software of Hueflight: from photon codes to depth and reflectance in every band.

The names below are loaded when they are first used, so that importing the package costs next to
nothing.
"""

from typing import TYPE_CHECKING, Any

from hueflight.lazy import lazy_names as _lazy_names

if TYPE_CHECKING:  # for type checkers and editors; `_HOME` says the same at run time
    from hueflight.analysis import compare
    from hueflight.batch import reconstruct_file, reconstruct_many
    from hueflight.calibration import Calibration, calibrate
    from hueflight.client.async_client import connect_async
    from hueflight.client.sync_client import connect
    from hueflight.color import color_picture
    from hueflight.errors import HueflightError
    from hueflight.export import write as write_image
    from hueflight.importers import read_counts, read_image
    from hueflight.importers.captures import Capture, read_capture, write_counts
    from hueflight.model.instrument import Instrument
    from hueflight.model.schedules import Schedule
    from hueflight.reconstruction.bounds import depth_bound, reflectance_bound
    from hueflight.reconstruction.departures import correct_drift
    from hueflight.reconstruction.entry_point import reconstruct, reconstruct_packets
    from hueflight.reconstruction.image_check import check_image
    from hueflight.reconstruction.interleaved import reconstruct_interleaved
    from hueflight.reconstruction.interleaved import (
        reconstruct_interleaved as reconstruct_alternated,
    )
    from hueflight.reconstruction.quality import Quality
    from hueflight.reconstruction.separation import flag_mixed
    from hueflight.reconstruction.sums.design import design_sums
    from hueflight.reconstruction.sums.method import reconstruct_sums
    from hueflight.reconstruction.uncertainty import reflectance_interval
    from hueflight.recording import open_recording

    __version__: str

#: module of each public name, and the name there where it is another one
_HOME = {
    "Calibration": "hueflight.calibration",
    "Capture": "hueflight.importers.captures",
    "HueflightError": "hueflight.errors",
    "Instrument": "hueflight.model.instrument",
    "Quality": "hueflight.reconstruction.quality",
    "Schedule": "hueflight.model.schedules",
    "calibrate": "hueflight.calibration",
    "check_image": "hueflight.reconstruction.image_check",
    "color_picture": "hueflight.color",
    "compare": "hueflight.analysis",
    "connect": "hueflight.client.sync_client",
    "connect_async": "hueflight.client.async_client",
    "correct_drift": "hueflight.reconstruction.departures",
    "depth_bound": "hueflight.reconstruction.bounds",
    "design_sums": "hueflight.reconstruction.sums.design",
    "flag_mixed": "hueflight.reconstruction.separation",
    "open_recording": "hueflight.recording",
    "read_capture": "hueflight.importers.captures",
    "read_counts": "hueflight.importers",
    "read_image": "hueflight.importers",
    "reconstruct": "hueflight.reconstruction.entry_point",
    "reconstruct_alternated": "hueflight.reconstruction.interleaved:reconstruct_interleaved",
    "reconstruct_file": "hueflight.batch",
    "reconstruct_interleaved": "hueflight.reconstruction.interleaved",
    "reconstruct_many": "hueflight.batch",
    "reconstruct_packets": "hueflight.reconstruction.entry_point",
    "reconstruct_sums": "hueflight.reconstruction.sums.method",
    "reflectance_bound": "hueflight.reconstruction.bounds",
    "reflectance_interval": "hueflight.reconstruction.uncertainty",
    "write_counts": "hueflight.importers.captures",
    "write_image": "hueflight.export:write",
}

#: packages that are attributes without being imported by name
_PACKAGES = (
    "analysis",
    "batch",
    "calibration",
    "client",
    "color",
    "export",
    "importers",
    "ingest",
    "model",
    "reconstruction",
    "recording",
    "simulator",
)

__all__ = [
    "Calibration",
    "Capture",
    "HueflightError",
    "Instrument",
    "Quality",
    "Schedule",
    "__version__",
    "calibrate",
    "check_image",
    "color_picture",
    "compare",
    "connect",
    "connect_async",
    "correct_drift",
    "depth_bound",
    "design_sums",
    "flag_mixed",
    "open_recording",
    "read_capture",
    "read_counts",
    "read_image",
    "reconstruct",
    "reconstruct_alternated",  # the name until 0.1
    "reconstruct_file",
    "reconstruct_interleaved",
    "reconstruct_many",
    "reconstruct_packets",
    "reconstruct_sums",
    "reflectance_bound",
    "reflectance_interval",
    "write_counts",
    "write_image",
]


_load, _names = _lazy_names(__name__, _HOME, _PACKAGES)


def __getattr__(name: str) -> Any:
    """Load a public name when it is first used."""
    if name == "__version__":
        from importlib.metadata import version

        globals()[name] = found = version("hueflight")
        return found
    return _load(name)


def __dir__() -> list[str]:
    """Names for `dir` and tab completion."""
    return sorted({*_names(), "__version__"})
