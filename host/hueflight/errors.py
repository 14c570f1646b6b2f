"""Expected failures of the host software, each a kind of `HueflightError`."""

from hueflight_protocol.errors import HueflightError

__all__ = [
    "BatchError",
    "CalibrationError",
    "ExportError",
    "FileFormatError",
    "HistogramError",
    "HueflightError",
    "ImageError",
    "IngestError",
    "InstrumentError",
    "KernelError",
    "OverflowPolicyError",
    "RecordingError",
    "SceneError",
]


class InstrumentError(HueflightError):
    """An instrument description that can't be read or contradicts itself."""


class HistogramError(HueflightError):
    """Counts whose shape, type or content does not fit the instrument."""


class KernelError(HueflightError):
    """Compiled kernels that were asked for and are missing, or that do not fit the Python code."""


class IngestError(HueflightError):
    """Packets that can't be counted into the histogram asked for."""


class OverflowPolicyError(HistogramError):
    """A counter was about to exceed its type under the policy `error`."""


class CalibrationError(HueflightError):
    """Captures that can't make a calibration, or a calibration used where it does not fit."""


class RecordingError(HueflightError):
    """A recording that can't be read, written or is not one."""


class SceneError(HueflightError):
    """A scene that does not exist or does not fit the instrument."""


class ImageError(HueflightError):
    """A dataset that is no image, or lacks what is asked of it."""


class ExportError(HueflightError):
    """A result that can't be written: the format does not hold it, or the disk did not take it."""


class FileFormatError(HueflightError):
    """A file of results or counts that can't be read, is incomplete, or is not what it says."""


class BatchError(HueflightError):
    """Many captures that can't be worked through together."""
