# SPDX-License-Identifier: Apache-2.0
"""Messages of Foxglove's types from images.

The schemas are those of the official SDK (https://docs.foxglove.dev/docs/visualization/message-schemas).
Distances are metres; the frame ``camera_optical`` has x right, y down and z along the optical axis,
and ``camera`` has x forward, y left and z up (ROS REP 103).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from typing import Any, Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from hueflight.color import color_picture
from hueflight.export.description import band_labels
from hueflight.export.points import image_points
from hueflight.files.optional import import_optional
from hueflight.model.instrument import Instrument

OPTICAL_FRAME, BODY_FRAME = "camera_optical", "camera"
#: rotation from `OPTICAL_FRAME` to `BODY_FRAME`, as a quaternion x, y, z, w
OPTICAL_ROTATION = (-0.5, 0.5, -0.5, 0.5)
NS = 1_000_000_000
#: sRGB values of an image, uint8, shape (row, col, 3)
Color = Callable[[xr.Dataset], NDArray[np.uint8]]
Level = Literal["Info", "Warning", "Error"]


@dataclass(frozen=True)
class Topic:
    """A message that is built when it is wanted.

    Attributes
    ----------
    schema : str
        Name of the message's type in the SDK, such as ``"RawImage"``.
    build : callable
        Returns the message, an object of that type.
    """

    schema: str
    build: Callable[[], Any]


class FoxgloveMessages:
    """Messages of one camera.

    Parameters
    ----------
    instrument : Instrument
        Instrument of the images.
    color : callable, optional
        Colours of an image; by default those of `hueflight.color.color_picture`.
    """

    def __init__(self, instrument: Instrument, /, *, color: Color | None = None) -> None:
        self.types = import_optional("foxglove.messages", extra="foxglove")
        self._instrument = instrument
        self._color = color or partial(_rendered, instrument=instrument)

    def topics(self, image: xr.Dataset, /, *, time_ns: int) -> dict[str, Topic]:
        """Return the messages of one image by topic.

        Parameters
        ----------
        image : xarray.Dataset
            The image, or a live picture, which holds only ``photons`` before a calibration.
        time_ns : int
            Its time, in nanoseconds since 1970.

        Returns
        -------
        dict of Topic
            ``/tf``, ``/calibration``, every plane and band, and of an image ``/color`` and
            ``/points``.
        """
        stamp = self._stamp(time_ns)
        found = {
            "/tf": Topic("FrameTransforms", partial(self._transforms, stamp)),
            "/calibration": Topic("CameraCalibration", partial(self._calibration, stamp)),
        }
        labels = band_labels(image) if "band" in image.dims else []
        for name in image.data_vars:
            variable = image.variables[name]
            if "band" in variable.dims:
                for number, label in enumerate(labels):
                    found[f"/{name}/{label}"] = self._plane(variable, stamp, band=number)
            else:
                found[f"/{name}"] = self._plane(variable, stamp)
        if "depth" in image and "reflectance" in image:
            rgb = cache(lambda: self._color(image))  # of both messages
            found["/color"] = Topic("RawImage", lambda: self._raw(rgb(), stamp))
            found["/points"] = Topic("PointCloud", lambda: self._points(image, rgb(), stamp))
        return found

    def summary(self, image: xr.Dataset, /, *, time_ns: int) -> Topic:
        """Return a line of the log about an image.

        Parameters
        ----------
        image : xarray.Dataset
            The image.
        time_ns : int
            Its time, in nanoseconds since 1970.

        Returns
        -------
        Topic
            The message, a warning if no pixel has a depth.
        """
        known = int(np.isfinite(image["depth"].values).sum())
        text = f"{known} of {image['depth'].size} pixels have a depth"
        details = [
            f"{name} {image.attrs[name]}"
            for name in ("instrument", "method", "frames", "missed_pictures", "software")
            if name in image.attrs
        ]
        level: Level = "Info" if known else "Warning"
        return self.line("; ".join([text, *details]), level=level, time_ns=time_ns)

    def line(self, text: str, /, *, level: Level, time_ns: int) -> Topic:
        """Return a line of the log.

        Parameters
        ----------
        text : str
            The line.
        level : str
            ``"Info"``, ``"Warning"`` or ``"Error"``.
        time_ns : int
            Its time, in nanoseconds since 1970.

        Returns
        -------
        Topic
            The message.
        """
        build = partial(
            self.types.Log,
            timestamp=self._stamp(time_ns),
            level=getattr(self.types.LogLevel, level),
            message=text,
            name="hueflight",
        )
        return Topic("Log", build)

    def _stamp(self, time_ns: int) -> Any:
        return self.types.Timestamp(*divmod(time_ns, NS))

    def _plane(self, variable: xr.Variable, stamp: Any, *, band: int | None = None) -> Topic:
        def build() -> Any:
            plane = variable if band is None else variable.isel(band=band)
            return self._raw(plane.transpose("row", "col").values, stamp)

        return Topic("RawImage", build)

    def _raw(self, values: NDArray[Any], stamp: Any) -> Any:
        """Colours as they are, flags as 16-bit integers, everything else as floats."""
        if values.ndim == 3:
            encoding = "rgb8"
        elif values.dtype.kind in "ub" and values.dtype.itemsize <= 2:
            encoding, values = "mono16", values.astype("<u2", copy=False)
        else:
            encoding, values = "32FC1", values.astype("<f4", copy=False)
        rows, cols = values.shape[:2]
        return self.types.RawImage(
            timestamp=stamp,
            frame_id=OPTICAL_FRAME,
            width=cols,
            height=rows,
            encoding=encoding,
            step=values.nbytes // rows,
            data=values.tobytes(),
        )

    def _points(self, image: xr.Dataset, rgb: NDArray[np.uint8], stamp: Any) -> Any:
        kinds = self.types.PackedElementFieldNumericType
        records = point_records(image, self._instrument, rgb=rgb)
        fields = [
            self.types.PackedElementField(
                name=name, offset=offset, type=getattr(kinds, dtype.name.capitalize())
            )
            for name, (dtype, offset) in _layout(records.dtype).items()
        ]
        origin = self.types.Pose(
            position=self.types.Vector3(x=0.0, y=0.0, z=0.0),
            orientation=self.types.Quaternion(x=0.0, y=0.0, z=0.0, w=1.0),
        )
        return self.types.PointCloud(
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
        return self.types.CameraCalibration(
            timestamp=stamp,
            frame_id=OPTICAL_FRAME,
            width=cols,
            height=rows,
            K=matrix.ravel().tolist(),
            R=np.eye(3).ravel().tolist(),
            P=np.column_stack([matrix, np.zeros(3)]).ravel().tolist(),
        )

    def _transforms(self, stamp: Any) -> Any:
        transform = self.types.FrameTransform(
            timestamp=stamp,
            parent_frame_id=BODY_FRAME,
            child_frame_id=OPTICAL_FRAME,
            translation=self.types.Vector3(x=0.0, y=0.0, z=0.0),
            rotation=self.types.Quaternion(**dict(zip("xyzw", OPTICAL_ROTATION, strict=True))),
        )
        return self.types.FrameTransforms(transforms=[transform])


def _rendered(image: xr.Dataset, *, instrument: Instrument) -> NDArray[np.uint8]:
    return np.rint(color_picture(image, instrument=instrument) * 255).astype(np.uint8)


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


def point_records(
    image: xr.Dataset, instrument: Instrument, /, *, rgb: NDArray[np.uint8]
) -> NDArray[np.void]:
    """Return the points of an image as packed records.

    Parameters
    ----------
    image : xarray.Dataset
        One image.
    instrument : Instrument
        Its instrument.
    rgb : ndarray of uint8, shape (row, col, 3)
        Its colours.

    Returns
    -------
    structured array, shape (point,)
        Fields x, y, z, red, green, blue, alpha, then every plane and band. It is empty if no
        pixel has a depth.
    """
    if not np.isfinite(image["depth"].values).any():
        return np.empty(0, [(name, "<f4") for name in "xyz"])
    points = image_points(image, instrument=instrument, rgb=rgb)
    columns = {name: values.astype("<f4") for name, values in zip("xyz", points.xyz.T, strict=True)}
    columns |= dict(zip(("red", "green", "blue"), points.rgb.T, strict=True))
    columns["alpha"] = np.full(len(points.xyz), 255, np.uint8)
    columns |= {
        name: values if values.dtype.name in _NUMERIC else values.astype("<f8")
        for name, values in points.fields.items()
    }
    packed = [(name, values.dtype.newbyteorder("<")) for name, values in columns.items()]
    records = np.empty(len(points.xyz), packed)
    for begin in range(0, len(records), _RECORDS_TOGETHER):
        part = slice(begin, begin + _RECORDS_TOGETHER)
        filled = records[part]
        for name, values in columns.items():
            filled[name] = values[part]
    return records


_RECORDS_TOGETHER = 4096  #: so many stay in the processor's cache until all fields are written
_NUMERIC = ("uint8", "int8", "uint16", "int16", "uint32", "int32", "float32", "float64")


def _layout(dtype: np.dtype[np.void]) -> dict[str, tuple[np.dtype[Any], int]]:
    """Type and offset of each field."""
    assert dtype.fields is not None
    return {name: (found[0], found[1]) for name, found in dtype.fields.items()}
