# SPDX-License-Identifier: Apache-2.0
"""A camera for Micro-Manager in Python: pymmcore-plus' core with devices in Python, UniMMCore.

The camera is that of a capture daemon; see the page *Micro-Manager* of the documentation.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import DTypeLike, NDArray

from hueflight.client import Client, Exposure, connect
from hueflight.files.optional import import_optional
from hueflight.integrations.planes import PictureArray, picture_arrays

unicore: Any = import_optional("pymmcore_plus.experimental.unicore", extra="micro-manager")

IMAGE = "Image"  #: property that chooses the array
FRAMES = "Frames"  #: property that states the exposure in frames of the sensor
PATIENCE_S = 60.0  #: for a picture, beyond its exposure
GetBuffer = Callable[[Sequence[int], DTypeLike], NDArray[Any]]


class HueflightCamera(unicore.CameraDevice):
    """Camera of a capture daemon.

    The property ``Image`` chooses what an image shows: ``photons``, ``depth``, ``color``,
    ``reflectance`` with all bands as components, one band, such as ``reflectance 659 nm``, or the
    deviations and flags of `hueflight.integrations.planes.picture_arrays`. Values are those of the
    reconstruction; unknown ones are NaN.

    The exposure is the time of the frames behind an image. An image that is snapped has photons
    of after the call only. Those of a sequence come at the daemon's rate, and one that exposes for
    longer than the time between two overlaps with the one before. A sensor whose description states
    no frame rate counts as one of 1000 frames per second.

    Parameters
    ----------
    address : str
        Address of the daemon.
    token : str, optional
        Token that it requires, unless it listens on loopback only.

    Examples
    --------
    >>> from pymmcore_plus.experimental.unicore import UniMMCore  # doctest: +SKIP
    >>> core = UniMMCore()  # doctest: +SKIP
    >>> core.loadPyDevice("camera", HueflightCamera("localhost:8470"))  # doctest: +SKIP
    >>> core.initializeDevice("camera")  # doctest: +SKIP
    >>> core.setCameraDevice("camera")  # doctest: +SKIP
    >>> core.setProperty("camera", "Image", "depth")  # doctest: +SKIP
    >>> core.snap()  # doctest: +SKIP
    """

    def __init__(self, address: str = "localhost:8470", /, *, token: str | None = None) -> None:
        super().__init__()
        self._address, self._token = address, token
        self._client: Client | None = None
        self._arrays: Mapping[str, PictureArray] = {}
        self._exposure = Exposure(0, 0)
        self._frame_rate_hz = 0.0

    def initialize(self) -> None:
        """Connect to the daemon, and start its live run if it is idle.

        Raises
        ------
        ClientError
            If no daemon answers, or it requires another token.
        """
        self._client = connect(self._address, token=self._token)
        instrument = self._client.instrument
        self._arrays = picture_arrays(instrument)
        self._frame_rate_hz = instrument.sensor.usual_frame_rate_hz
        self._exposure = self._client.set_frames(0)
        self.register_property(
            IMAGE,
            default_value="photons",
            allowed_values=list(self._arrays),
            property_type=str,
        )
        self.register_property(
            FRAMES, getter=HueflightCamera.get_frames, property_type=int, is_read_only=True
        )

    def shutdown(self) -> None:
        """Restore the frames behind each live picture, and disconnect."""
        if self._client is not None:
            self._client.set_frames(0)
            self._client.close()
            self._client = None

    def get_frames(self) -> int:
        """Return the frames behind an image."""
        return self._exposure.frames

    def get_exposure(self) -> float:
        """Return the time of the frames behind an image, in milliseconds."""
        return 1e3 * self._exposure.frames / self._frame_rate_hz

    def set_exposure(self, exposure: float) -> None:
        """Set the time of the frames behind an image.

        Parameters
        ----------
        exposure : float
            Time in milliseconds; it is rounded up to a multiple of that between two live pictures.
        """
        frames = max(1, round(exposure * 1e-3 * self._frame_rate_hz))
        self._exposure = self._connected().set_frames(frames)

    def get_camera_name(self) -> str:
        """Return the name of the instrument."""
        return self._connected().instrument.name

    def shape(self) -> tuple[int, ...]:
        """Return rows, columns, and of several components their number."""
        return self._array().shape

    def dtype(self) -> DTypeLike:
        """Return the type of the values."""
        return self._array().dtype

    def start_sequence(self, n: int | None, get_buffer: GetBuffer) -> Iterator[Mapping[str, Any]]:
        """Take images.

        Parameters
        ----------
        n : int or None
            Number of images; None for any number.
        get_buffer : callable
            Returns the array for the next image, given its shape and type.

        Yields
        ------
        mapping
            Metadata of each image: number, frames, times and pictures missed.
        """
        client, array = self._connected(), self._array()
        if client.status()["state"] == "idle":
            client.start()
        begun = self._exposure = client.set_frames(self._exposure.frames)
        exposure_s = begun.frames / self._frame_rate_hz
        feed = client.open_feed("newest" if n is None else "all")
        taken = 0
        try:
            while n is None or taken < n:
                picture = feed.next(exposure_s + PATIENCE_S)
                if begun.holds(picture):
                    get_buffer(array.shape, array.dtype)[...] = array.of(picture)
                    taken += 1
                    yield _metadata(picture)
        finally:
            feed.close()

    def _array(self) -> PictureArray:
        self._connected()
        return self._arrays[self.get_property_value(IMAGE)]

    def _connected(self) -> Client:
        if self._client is None:
            raise RuntimeError("the camera is not initialized: call initializeDevice first")
        return self._client


def _metadata(picture: xr.Dataset) -> dict[str, Any]:
    wanted = ("number", "frames", "device_s", "received_unix_s", "missed_pictures", "kind")
    return {f"hueflight.{name}": np.asarray(picture.attrs[name]).item() for name in wanted}
