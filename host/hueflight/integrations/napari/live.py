# SPDX-License-Identifier: Apache-2.0
"""Live pictures of a camera as layers of napari."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Any

import xarray as xr

from hueflight.client import ClientError, connect
from hueflight.color.live_color import LiveColor
from hueflight.files.optional import import_optional
from hueflight.integrations.napari.layers import Layer, image_layers

if TYPE_CHECKING:
    import napari  # pyright: ignore[reportMissingImports]  # not where types are checked

PATIENCE_S = 60.0  #: for the next picture
STOP_S = 5.0
POLL_MS = 15  #: between two looks for a picture


def show_live(
    viewer: napari.Viewer,  # pyright: ignore[reportAttributeAccessIssue]
    address: str = "localhost:8470",
    token: str = "",
) -> LiveLayers:
    """Show the newest picture of a camera in layers of a viewer, until it is stopped.

    Parameters
    ----------
    viewer : napari.Viewer
        Viewer that gets the layers.
    address : str
        Address of the daemon.
    token : str
        Token that it requires; empty if it listens on loopback only.

    Returns
    -------
    LiveLayers
        The layers, with a method that stops them.

    Raises
    ------
    ClientError
        If no daemon answers, or it requires another token.
    """
    return LiveLayers(viewer, address, token=token or None)


class LiveLayers:
    """Layers that show the newest picture of a camera.

    Parameters
    ----------
    viewer : napari.Viewer
        Viewer that gets the layers.
    address : str
        Address of the daemon.
    token : str, optional
        Token that it requires.

    Attributes
    ----------
    shown : int
        Number of the picture that is shown; 0 before the first one.
    failure : ClientError or None
        Why there are no more pictures.
    """

    def __init__(self, viewer: Any, address: str, /, *, token: str | None = None) -> None:
        qt = import_optional("qtpy.QtCore", extra="napari")
        self._viewer = viewer
        self._client = connect(address, token=token)
        self._color = LiveColor(self._client.instrument)
        self._layers: dict[str, Any] = {}
        self.shown = 0
        self.failure: ClientError | None = None
        self._made: tuple[int, list[Layer]] | None = None
        self._feed = self._client.open_feed("newest")
        self._taken = threading.Event()
        self._thread = threading.Thread(target=self._receive, name="hueflight-live", daemon=True)
        self._timer = qt.QTimer()
        self._timer.timeout.connect(self._show)
        self._timer.start(POLL_MS)
        self._thread.start()

    def stop(self) -> None:
        """Leave the layers as they are, and disconnect."""
        self._timer.stop()
        self._feed.close()
        self._taken.set()
        self._thread.join(STOP_S)
        self._client.close()

    def _receive(self) -> None:
        """In a thread: make the newest picture's layers, each time the last ones were shown."""
        try:
            while True:
                picture = self._client.described(self._feed.next(PATIENCE_S))
                color = self._color.shown(picture) if "reflectance" in picture else None
                self._taken.clear()
                made = image_layers(_shown(picture), color=color, points=False)
                self._made = (picture.attrs["number"], made)
                self._taken.wait(PATIENCE_S)
        except ClientError as error:  # also after a stop, which closes the feed
            self.failure = error

    def _show(self) -> None:
        """In the thread of the window: put new data into the layers that are there."""
        if self.failure is not None:
            self._timer.stop()
            raise self.failure  # napari shows it to its user
        if self._made is None:
            return
        (number, layers), self._made = self._made, None
        for data, settings, _ in layers:
            layer = self._layers.get(settings["name"])
            if layer is not None and layer in self._viewer.layers:
                layer.data = data
            else:
                self._layers[settings["name"]] = self._viewer.add_image(data, **settings)
        self.shown = number
        self._taken.set()


def _shown(picture: xr.Dataset) -> xr.Dataset:
    """The variables that change from picture to picture and are looked at."""
    wanted = ("photons", "depth", "depth_std", "reflectance", "quality")
    return picture[[name for name in wanted if name in picture]]
