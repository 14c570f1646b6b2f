# SPDX-License-Identifier: Apache-2.0
"""MCAP files with the message types of Foxglove, for its viewer and for programs of robotics."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from hueflight.errors import ExportError
from hueflight.export.foxglove_messages import NS, FoxgloveMessages
from hueflight.files import staged
from hueflight.files.image_schema import captures, instrument_of, require_image
from hueflight.files.optional import import_optional
from hueflight.model.instrument import Instrument


def write_foxglove(
    image: xr.Dataset,
    path: str | Path,
    /,
    *,
    instrument: Instrument | None = None,
    interval_s: float = 1.0,
    overwrite: bool = False,
) -> None:
    """Write an image or a series as MCAP with the message types of Foxglove.

    The topics are ``/depth``, ``/depth_std``, one for each other plane and each band
    (``/reflectance/NAME``), ``/color``, ``/points``, ``/calibration``, ``/tf`` and ``/log``.
    Unknown values are NaN. Pixels without a depth are no points.

    Parameters
    ----------
    image : xarray.Dataset
        Image or series.
    path : str or pathlib.Path
        Name of the file.
    instrument : Instrument, optional
        Instrument whose lens gives the direction of each pixel; by default the one that the image
        describes.
    interval_s : float
        Seconds between the images of a series that has no coordinate ``time``; their times then
        count from 1970. A live picture has the time at which it was received.
    overwrite : bool
        Whether an existing file of this name may be replaced.

    Raises
    ------
    ImageError
        If it is not an image, or does not describe its instrument.
    ExportError
        If the interval is not positive.
    MissingPackageError
        If the package foxglove-sdk is not installed.
    OutputError
        If the file exists already or can't be written.
    """
    require_image(image)
    if not interval_s > 0:
        raise ExportError(f"interval_s = {interval_s}: must be positive")
    source = instrument_of(image, instrument)
    sdk = import_optional("foxglove", extra="foxglove")
    file, context = BytesIO(), sdk.Context()
    with staged(path, overwrite=overwrite) as partial:
        with sdk.open_mcap(file, context=context):
            channels = FoxgloveChannels(source, context)
            for number, single in enumerate(captures(image)):
                channels.log(single, time_ns=_time_ns(single, number, interval_s))
        partial.write_bytes(file.getvalue())


class FoxgloveChannels:
    """The channels of one camera in a context of the SDK, which writes a file.

    Parameters
    ----------
    instrument : Instrument
        Instrument of the images.
    context : foxglove.Context
        Context of the SDK.
    """

    def __init__(self, instrument: Instrument, context: Any, /) -> None:
        self._types = import_optional("foxglove.channels", extra="foxglove")
        self._messages = FoxgloveMessages(instrument)
        self._context = context
        self._open: dict[str, Any] = {}

    def log(self, image: xr.Dataset, /, *, time_ns: int) -> None:
        """Log all messages of one image.

        Parameters
        ----------
        image : xarray.Dataset
            The image.
        time_ns : int
            Its time, in nanoseconds since 1970.
        """
        topics = self._messages.topics(image, time_ns=time_ns)
        topics["/log"] = self._messages.summary(image, time_ns=time_ns)
        for name, topic in topics.items():
            if name not in self._open:
                kind = getattr(self._types, f"{topic.schema}Channel")
                self._open[name] = kind(name, context=self._context)
            self._open[name].log(topic.build(), log_time=time_ns)


def _time_ns(image: xr.Dataset, number: int, interval_s: float) -> int:
    """Time of an image, in nanoseconds since 1970."""
    if "received_unix_s" in image.attrs:
        return round(float(image.attrs["received_unix_s"]) * NS)
    if "time" in image.coords:
        when = image["time"].values
        if when.dtype.kind == "M":
            return int(when.astype("datetime64[ns]").astype(np.int64))
        return round(float(when) * NS)
    return round(number * interval_s * NS)
