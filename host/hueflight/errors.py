# SPDX-License-Identifier: Apache-2.0
"""Expected failures of the host software, each a kind of `HueflightError`, and its warnings.

Where Python has a class of its own for a failure, ours derives from that as well, so that
`except FileNotFoundError` or `except ValueError` works as usual.
"""

from hueflight_protocol.errors import HueflightError

__all__ = [
    "ArgumentError",
    "BatchError",
    "CalibrationError",
    "CalibrationNotFoundError",
    "ExportError",
    "FileFormatError",
    "HistogramError",
    "HueflightError",
    "ImageError",
    "IngestError",
    "InputNotFoundError",
    "InstrumentError",
    "InstrumentNotFoundError",
    "KernelError",
    "MemoryLimitError",
    "MissingPackageError",
    "OutputError",
    "OutputExistsError",
    "OverflowPolicyError",
    "OverlappingBandsError",
    "RecordingError",
    "RecordingNotFoundError",
    "SceneError",
    "SlowKernelsWarning",
]


class ArgumentError(HueflightError, TypeError, ValueError):
    """An argument of another type than a function takes, or not a value of that type."""


class InstrumentError(HueflightError, ValueError):
    """An instrument description that can't be read or contradicts itself."""


class InstrumentNotFoundError(InstrumentError, FileNotFoundError):
    """Neither a preset nor a file of that name exists."""


class HistogramError(HueflightError, ValueError):
    """Counts whose shape, type or content does not fit the instrument."""


class KernelError(HueflightError):
    """Compiled kernels that were asked for and are missing, or that do not fit the Python code."""


class SlowKernelsWarning(UserWarning):
    """Work is done by NumPy because nothing was compiled when the package was installed."""


class MemoryLimitError(HueflightError, MemoryError):
    """Work that takes more memory than it may have, or than there is; nothing of it is left."""


class IngestError(HueflightError):
    """Packets that can't be counted into the requested histogram."""


class OverflowPolicyError(HistogramError, OverflowError):
    """A counter was about to exceed its type under the policy `error`."""


class CalibrationError(HueflightError, ValueError):
    """Captures that can't make a calibration, or a calibration used where it does not fit."""


class OverlappingBandsError(CalibrationError):
    """The pulses of the bands overlap so much that one capture can't tell them apart."""


class CalibrationNotFoundError(CalibrationError, FileNotFoundError):
    """No calibration of that name exists."""


class RecordingError(HueflightError):
    """A recording that can't be read or written, or a file that is not a recording."""


class RecordingNotFoundError(RecordingError, FileNotFoundError):
    """No recording of that name exists."""


class SceneError(HueflightError, ValueError):
    """A scene that does not exist or does not fit the instrument."""


class ImageError(HueflightError, ValueError):
    """A dataset that is not an image, or lacks what is asked of it."""


class ExportError(HueflightError, ValueError):
    """A result that the chosen format does not hold, or a format that does not exist."""


class OutputError(HueflightError, OSError):
    """A file or folder that can't be written."""


class OutputExistsError(OutputError, FileExistsError):
    """A file or folder that exists and was not to be overwritten."""


class FileFormatError(HueflightError, ValueError):
    """A file of results or counts that can't be read, is incomplete, or is not what it says."""


class InputNotFoundError(FileFormatError, FileNotFoundError):
    """No file of that name exists."""


class MissingPackageError(HueflightError, ImportError):
    """An optional package that is not installed."""


class BatchError(HueflightError):
    """A batch of captures that can't be processed together."""
