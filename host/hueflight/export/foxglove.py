# SPDX-License-Identifier: Apache-2.0
"""MCAP files with the message types of Foxglove, for its viewer and for programs of robotics.

The schemas are those of the official SDK (https://docs.foxglove.dev/docs/visualization/message-schemas).
Distances are metres; the frame ``camera_optical`` has x right, y down and z along the optical axis,
and ``camera`` has x forward, y left and z up (ROS REP 103).
"""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from hueflight.color import color_picture
from hueflight.errors import ExportError
from hueflight.export.description import band_labels
from hueflight.export.points import image_points
from hueflight.files import staged
from hueflight.files.image_schema import captures, instrument_of, require_image
from hueflight.files.optional import import_optional
from hueflight.model.instrument import Instrument

OPTICAL_FRAME, BODY_FRAME = "camera_optical", "camera"
#: rotation from `OPTICAL_FRAME` to `BODY_FRAME`, as a quaternion x, y, z, w
OPTICAL_ROTATION = (-0.5, 0.5, -0.5, 0.5)
_NS = 1_000_000_000


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
    import_optional("foxglove.channels", extra="foxglove")
    file, context = BytesIO(), sdk.Context()
    with staged(path, overwrite=overwrite) as partial:
        with sdk.open_mcap(file, context=context):
            channels = FoxgloveChannels(source, context)
            for number, single in enumerate(captures(image)):
                channels.log(single, time_ns=_time_ns(single, number, interval_s))
        partial.write_bytes(file.getvalue())


class FoxgloveChannels:
    """The channels of one camera in a context of the SDK, which writes a file or serves viewers.

    Parameters
    ----------
    instrument : Instrument
        Instrument of the images.
    context : foxglove.Context
        Context of the SDK.
    """

    def __init__(self, instrument: Instrument, context: Any, /) -> None:
        self._types = import_optional("foxglove.messages", extra="foxglove")
        self._channels = import_optional("foxglove.channels", extra="foxglove")
        self._instrument, self._context = instrument, context
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
        types, stamp = self._types, self._types.Timestamp(*divmod(time_ns, _NS))
        messages: dict[str, Any] = {
            "/tf": types.FrameTransforms(transforms=[self._transform(stamp)]),
            "/calibration": self._calibration(stamp),
        }
        labels = band_labels(image)
        for name, variable in image.data_vars.items():
            if "band" in variable.dims:
                cube = variable.transpose("band", "row", "col").values
                for label, plane in zip(labels, cube, strict=True):
                    messages[f"/{name}/{label}"] = self._plane(plane, stamp)
            else:
                plane = variable.transpose("row", "col").values
                messages[f"/{name}"] = self._plane(plane, stamp)
        rgb = np.rint(color_picture(image, instrument=self._instrument) * 255).astype(np.uint8)
        messages["/color"] = self._raw(rgb, "rgb8", stamp)
        messages["/points"] = self._points(image, stamp)
        messages["/log"] = self._log(image, stamp)
        for topic, message in messages.items():
            if topic not in self._open:
                kind = getattr(self._channels, f"{type(message).__name__}Channel")
                self._open[topic] = kind(topic, context=self._context)
            self._open[topic].log(message, log_time=time_ns)

    def _plane(self, plane: NDArray[Any], stamp: Any) -> Any:
        """Flags as 16-bit integers, everything else as floats."""
        if plane.dtype.kind in "ub" and plane.dtype.itemsize <= 2:
            return self._raw(plane.astype("<u2"), "mono16", stamp)
        return self._raw(plane.astype("<f4"), "32FC1", stamp)

    def _raw(self, values: NDArray[Any], encoding: str, stamp: Any) -> Any:
        rows, cols = values.shape[:2]
        return self._types.RawImage(
            timestamp=stamp,
            frame_id=OPTICAL_FRAME,
            width=cols,
            height=rows,
            encoding=encoding,
            step=values.nbytes // rows,
            data=values.tobytes(),
        )

    def _points(self, image: xr.Dataset, stamp: Any) -> Any:
        kinds = self._types.PackedElementFieldNumericType
        records = point_records(image, self._instrument)
        fields = [
            self._types.PackedElementField(
                name=name, offset=offset, type=getattr(kinds, dtype.name.capitalize())
            )
            for name, (dtype, offset) in _layout(records.dtype).items()
        ]
        origin = self._types.Pose(
            position=self._types.Vector3(x=0.0, y=0.0, z=0.0),
            orientation=self._types.Quaternion(x=0.0, y=0.0, z=0.0, w=1.0),
        )
        return self._types.PointCloud(
            timestamp=stamp,
            frame_id=OPTICAL_FRAME,
            pose=origin,
            point_stride=records.dtype.itemsize,
            fields=fields,
            data=records.tobytes(),
        )

    def _calibration(self, stamp: Any) -> Any:
        rows, cols = self._instrument.image_shape
        matrix = camera_matrix(self._instrument)
        return self._types.CameraCalibration(
            timestamp=stamp,
            frame_id=OPTICAL_FRAME,
            width=cols,
            height=rows,
            K=matrix.ravel().tolist(),
            R=np.eye(3).ravel().tolist(),
            P=np.column_stack([matrix, np.zeros(3)]).ravel().tolist(),
        )

    def _transform(self, stamp: Any) -> Any:
        return self._types.FrameTransform(
            timestamp=stamp,
            parent_frame_id=BODY_FRAME,
            child_frame_id=OPTICAL_FRAME,
            translation=self._types.Vector3(x=0.0, y=0.0, z=0.0),
            rotation=self._types.Quaternion(**dict(zip("xyzw", OPTICAL_ROTATION, strict=True))),
        )

    def _log(self, image: xr.Dataset, stamp: Any) -> Any:
        known = int(np.isfinite(image["depth"].values).sum())
        text = f"{known} of {image['depth'].size} pixels have a depth"
        details = [
            f"{name} {image.attrs[name]}"
            for name in ("instrument", "method", "frames", "missed_pictures", "software")
            if name in image.attrs
        ]
        return self._types.Log(
            timestamp=stamp,
            level=self._types.LogLevel.Info if known else self._types.LogLevel.Warning,
            message="; ".join([text, *details]),
            name="hueflight",
        )


def camera_matrix(instrument: Instrument, /) -> NDArray[np.float64]:
    """Return the intrinsic matrix that projects points of `OPTICAL_FRAME` to column and row.

    Parameters
    ----------
    instrument : Instrument
        Instrument with a lens.

    Returns
    -------
    ndarray of float, shape (3, 3)
        The matrix; zeros without a lens, which viewers take for an uncalibrated camera.
    """
    rows, cols = instrument.image_shape
    matrix = np.zeros((3, 3))
    if instrument.lens is None:
        return matrix
    width_um, height_um = instrument.sensor.pixel_width_um, instrument.sensor.pixel_height_um
    assert width_um is not None  # an instrument with a lens states them
    assert height_um is not None
    focal_um = 1e3 * instrument.lens.focal_length_mm
    matrix[0] = focal_um / width_um, 0.0, (cols - 1) / 2
    matrix[1] = 0.0, focal_um / height_um, (rows - 1) / 2
    matrix[2, 2] = 1.0
    return matrix


def point_records(image: xr.Dataset, instrument: Instrument, /) -> NDArray[np.void]:
    """Return the points of an image as packed records.

    Parameters
    ----------
    image : xarray.Dataset
        One image.
    instrument : Instrument
        Its instrument.

    Returns
    -------
    structured array, shape (point,)
        Fields x, y, z, red, green, blue, alpha, then every plane and band. It is empty if no
        pixel has a depth.
    """
    if not np.isfinite(image["depth"].values).any():
        return np.empty(0, [(name, "<f4") for name in "xyz"])
    points = image_points(image, instrument=instrument)
    columns = {name: values.astype("<f4") for name, values in zip("xyz", points.xyz.T, strict=True)}
    columns |= dict(zip(("red", "green", "blue"), points.rgb.T, strict=True))
    columns["alpha"] = np.full(len(points.xyz), 255, np.uint8)
    columns |= {
        name: values if values.dtype.name in _NUMERIC else values.astype("<f8")
        for name, values in points.fields.items()
    }
    packed = [(name, values.dtype.newbyteorder("<")) for name, values in columns.items()]
    records = np.empty(len(points.xyz), packed)
    for name, values in columns.items():
        records[name] = values
    return records


_NUMERIC = ("uint8", "int8", "uint16", "int16", "uint32", "int32", "float32", "float64")


def _layout(dtype: np.dtype[np.void]) -> dict[str, tuple[np.dtype[Any], int]]:
    """Type and offset of each field."""
    assert dtype.fields is not None
    return {name: (found[0], found[1]) for name, found in dtype.fields.items()}


def _time_ns(image: xr.Dataset, number: int, interval_s: float) -> int:
    """Time of an image, in nanoseconds since 1970."""
    if "received_unix_s" in image.attrs:
        return round(float(image.attrs["received_unix_s"]) * _NS)
    if "time" in image.coords:
        when = image["time"].values
        if when.dtype.kind == "M":
            return int(when.astype("datetime64[ns]").astype(np.int64))
        return round(float(when) * _NS)
    return round(number * interval_s * _NS)
