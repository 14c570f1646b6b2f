# SPDX-License-Identifier: Apache-2.0
"""The client of a capture daemon."""

from __future__ import annotations

import time
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import Any, Self
from urllib.parse import quote

import xarray as xr

from hueflight.client.address import Address
from hueflight.client.errors import ClientError
from hueflight.client.feed import PictureFeed
from hueflight.client.requests import Requests
from hueflight.client.types import CaptureKind, Delivery, Exposure, RemoteRecording
from hueflight.files.atomic import staged
from hueflight.model.instrument import Instrument
from hueflight.recording.layout import SUFFIX, segment_path

POLL_S = 0.2  #: between two looks at what is awaited


def connect(
    address: str,
    /,
    *,
    token: str | None = None,
    timeout_s: float = 10.0,
    reconnect_s: float = 30.0,
) -> Client:
    """Connect to a capture daemon (`hueflight serve`).

    Parameters
    ----------
    address : str
        ``HOST``, ``HOST:PORT`` or the address of the live page.
    token : str, optional
        Token that the daemon requires, unless it listens on loopback only.
    timeout_s : float
        Seconds within which the daemon must answer a request.
    reconnect_s : float
        Seconds for which a lost connection is tried to be opened again.

    Returns
    -------
    Client
        The client, to be closed or used in a `with` block.

    Raises
    ------
    NotReachableError
        If no daemon answers.
    TokenError
        If the daemon requires another token.
    VersionMismatchError
        If it speaks another version of the protocol.

    Examples
    --------
    >>> import hueflight as hf
    >>> with hf.connect("localhost:8470") as camera:  # doctest: +SKIP
    ...     for picture in camera.pictures():
    ...         print(picture.depth.median().item())
    """
    where = Address.parse(address)
    requests = Requests(where, token=token or where.token, timeout_s=timeout_s)
    return Client(requests, reconnect_s=reconnect_s, timeout_s=timeout_s)


class Client:
    """Connection to a daemon; `connect` makes it.

    Parameters
    ----------
    requests : Requests
        Requests to the daemon.
    reconnect_s : float
        Seconds for which a lost connection is tried to be opened again.
    timeout_s : float
        Seconds within which the daemon must accept a connection.

    Attributes
    ----------
    instrument : Instrument
        Instrument of the daemon.
    """

    def __init__(self, requests: Requests, /, *, reconnect_s: float, timeout_s: float) -> None:
        self._requests = requests
        self._reconnect_s, self._timeout_s = reconnect_s, timeout_s
        self._snapshots: PictureFeed | None = None
        self._read_instrument()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the connection."""
        if self._snapshots is not None:
            self._snapshots.close()
            self._snapshots = None

    def pictures(
        self, which: Delivery = "newest", /, *, timeout_s: float | None = None
    ) -> Iterator[xr.Dataset]:
        """Iterate over live pictures.

        A slow loop never delays acquisition. With ``"newest"`` it gets the newest picture each
        time, and with ``"all"`` one after another; the daemon then keeps up to 32 pictures that
        were not taken yet and drops older ones. The attribute ``missed_pictures`` of a picture
        counts those that were made since the last one and not received.

        Parameters
        ----------
        which : str
            ``"newest"`` or ``"all"``.
        timeout_s : float, optional
            Seconds within which each picture must come; by default there is no limit.

        Yields
        ------
        xarray.Dataset
            Image as `hueflight.reconstruct` gives it, with the same values. Without a calibration
            it holds only ``photons``. The arrays can't be written to.

        Raises
        ------
        NoPictureError
            If no picture comes in time.
        ConnectionLostError
            If the connection breaks and can't be opened again.
        """
        feed = self.open_feed(which)
        try:
            while True:
                yield self.described(feed.next(timeout_s))
        finally:
            feed.close()

    def picture(self, *, timeout_s: float | None = 10.0) -> xr.Dataset:
        """Return the newest picture that was not returned before.

        Parameters
        ----------
        timeout_s : float or None
            Seconds within which it must come.

        Returns
        -------
        xarray.Dataset
            The picture, as `pictures` yields it.

        Raises
        ------
        NoPictureError
            If no picture comes in time.
        ConnectionLostError
            If the connection breaks and can't be opened again.
        """
        if self._snapshots is None:
            self._snapshots = self.open_feed("newest")
        return self.described(self._snapshots.next(timeout_s))

    def open_feed(self, which: Delivery, /) -> PictureFeed:
        """Return a source of pictures, to be closed by the caller.

        Parameters
        ----------
        which : str
            ``"newest"`` or ``"all"``.

        Returns
        -------
        PictureFeed
            The source.
        """
        return PictureFeed(
            self._requests,
            which,
            reconnect_s=self._reconnect_s,
            open_timeout_s=self._timeout_s,
        )

    def _read_instrument(self) -> None:
        """Ask for the instrument, which changes when the schedule of its LEDs is changed."""
        self._definition = str(self._requests.check_protocol()["definition"])
        self.instrument = Instrument.from_json(
            self._definition, where=f"instrument of {self._requests.address.netloc}"
        )
        self._fingerprint = self.instrument.fingerprint()

    def described(self, picture: xr.Dataset, /) -> xr.Dataset:
        """Return a picture with the description of its instrument, which exports need.

        Parameters
        ----------
        picture : xarray.Dataset
            Picture from a feed of this client.

        Returns
        -------
        xarray.Dataset
            The same object.
        """
        made_by = picture.attrs.get("instrument_fingerprint", self._fingerprint)
        if made_by != self._fingerprint:
            self._read_instrument()
        if made_by == self._fingerprint:
            picture.attrs["instrument_description"] = self._definition
        return picture

    def status(self) -> dict[str, Any]:
        """Return the daemon's status.

        Returns
        -------
        dict
            State, totals, frames lost, rates, recording, calibration.
        """
        return self._requests.ask("GET", "/api/status")

    def start(self) -> None:
        """Start the live run."""
        self._requests.ask("POST", "/api/start")

    def stop(self) -> None:
        """End the present run, and stay idle."""
        self._requests.ask("POST", "/api/stop")

    def expose(self, frames: int = 0, /, *, timeout_s: float | None = 60.0) -> xr.Dataset:
        """Return a picture of photons that come from now on.

        The live picture of all viewers begins anew, and holds so many frames from now on.

        Parameters
        ----------
        frames : int
            Frames behind the picture at least: they are rounded up to a multiple of those from one
            live picture to the next. 0 for as many as when the daemon started.
        timeout_s : float or None
            Seconds within which it must come.

        Returns
        -------
        xarray.Dataset
            The picture, as `pictures` yields it; its attribute ``frames`` is the number of its
            frames.

        Raises
        ------
        RefusedError
            If the number of frames is out of range.
        NoPictureError
            If no picture of so many frames comes in time, for example as the run was not started.
        ConnectionLostError
            If the connection breaks and can't be opened again.
        """
        begun = self.set_frames(frames)
        deadline = None if timeout_s is None else time.monotonic() + timeout_s
        while True:
            left = None if deadline is None else max(0.0, deadline - time.monotonic())
            picture = self.picture(timeout_s=left)
            if begun.holds(picture):
                return picture

    def set_frames(self, frames: int = 0, /) -> Exposure:
        """Set the frames behind each live picture, which begins anew.

        Parameters
        ----------
        frames : int
            Frames behind each picture at least, rounded up to a multiple of those from one to the
            next; 0 for as many as when the daemon started.

        Returns
        -------
        Exposure
            Tells which pictures have so many frames, all of them taken from now on.

        Raises
        ------
        RefusedError
            If the number of frames is out of range.
        """
        answer = self._requests.ask("POST", "/api/picture", {"frames": frames})
        return Exposure(answer["frames"], answer["number"])

    def record(
        self,
        name: str | None = None,
        *,
        kind: CaptureKind = "scene",
        frames: int = 0,
        seconds: float | None = None,
        note: str = "",
        until_depth_std: float | None = None,
        until_reflectance_std: float | None = None,
        share: float = 0.9,
    ) -> str:
        """Begin a recording, which ends at the first limit that is reached or by `stop_recording`.

        Parameters
        ----------
        name : str, optional
            Name of the recording; by default the present time.
        kind : str
            Kind of capture.
        frames : int
            Number of frames; 0 for no limit.
        seconds : float, optional
            Duration.
        note : str
            Note that is kept in the recording.
        until_depth_std : float, optional
            Standard deviation of depth, in metres, that ends the recording.
        until_reflectance_std : float, optional
            Standard deviation of the reflectance in every band that ends the recording.
        share : float
            Fraction of the pixels that must reach the standard deviations.

        Returns
        -------
        str
            Name of the recording.

        Raises
        ------
        RefusedError
            If a recording is in progress, the name is taken, or a value is out of range.
        """
        body = {
            "name": name,
            "kind": kind,
            "frames": frames,
            "seconds": seconds,
            "note": note,
            "until_depth_std": until_depth_std,
            "until_reflectance_std": until_reflectance_std,
            "share": share,
        }
        return self._requests.ask("POST", "/api/recordings", body)["name"]

    def stop_recording(self) -> str:
        """End the recording in progress and return its name.

        Returns
        -------
        str
            Name of the recording.

        Raises
        ------
        RefusedError
            If there is none.
        """
        return self._requests.ask("POST", "/api/recordings/stop")["name"]

    def wait_for_recording(self, name: str, /, *, timeout_s: float | None = None) -> dict[str, Any]:
        """Wait until a recording has ended.

        Parameters
        ----------
        name : str
            Name of the recording.
        timeout_s : float, optional
            Seconds to wait; by default there is no limit.

        Returns
        -------
        dict
            Summary of the recording: frames exposed, delivered, recorded and lost.

        Raises
        ------
        ClientError
            If the recording failed, is unknown, or does not end in time.
        """
        deadline = None if timeout_s is None else time.monotonic() + timeout_s
        while True:
            found = self.status()["recording"]
            if found["name"] != name:
                break
            if deadline is not None and time.monotonic() >= deadline:
                raise ClientError(f"recording {name!r} did not end within {timeout_s:g} s")
            time.sleep(POLL_S)
        last = found["last"]
        if last.get("name") != name:
            raise ClientError(
                f"the daemon does not record {name!r}, and its last recording was "
                f"{last.get('name', 'none')!r}"
            )
        if last.get("failure"):
            raise ClientError(f"recording {name!r} failed: {last['failure']}")
        return last

    def recordings(self) -> list[RemoteRecording]:
        """Return the finished recordings, newest first.

        Returns
        -------
        list of RemoteRecording
            The recordings.
        """
        return [
            RemoteRecording(
                entry["name"],
                entry["bytes"],
                entry["segments"],
                datetime.fromisoformat(entry["modified"]),
            )
            for entry in self._requests.ask("GET", "/api/recordings")["recordings"]
        ]

    def download(self, name: str, folder: str | Path = ".", /, *, overwrite: bool = False) -> Path:
        """Download all segments of a recording.

        Parameters
        ----------
        name : str
            Name of the recording.
        folder : str or Path
            Existing folder to write to.
        overwrite : bool
            Replace what exists under the name.

        Returns
        -------
        Path
            The recording, which `hueflight.open_recording` opens. It appears under its name when
            all of it has arrived.

        Raises
        ------
        ClientError
            If there is no finished recording of that name.
        NotReachableError
            If the daemon stops sending.
        OutputError
            If the folder is missing, a file exists, or the disk refuses.
        """
        [found] = [each for each in self.recordings() if each.name == name] or [None]
        if found is None:
            raise ClientError(
                f"the daemon has no finished recording called {name!r}: recordings() lists them"
            )
        target = Path(folder) / f"{name}{SUFFIX}"
        with staged(target, overwrite=overwrite) as partial:
            for number in range(found.segments):
                path = f"/api/recordings/{quote(name, safe='')}/segments/{number}"
                self._requests.save(path, segment_path(partial, number))
        return target

    def calibrate(
        self,
        *,
        distance: float,
        frames: int = 4000,
        bands: bool = True,
        dark: bool = False,
        timeout_s: float | None = None,
    ) -> dict[str, Any]:
        """Take the captures of a calibration, and wait until it is in use.

        Parameters
        ----------
        distance : float
            Distance of the reference target, in metres.
        frames : int
            Frames of each capture.
        bands : bool
            Also capture the target with one LED at a time.
        dark : bool
            Also take a capture with all LEDs off.
        timeout_s : float, optional
            Seconds to wait; by default there is no limit.

        Returns
        -------
        dict
            Status of the calibration.

        Raises
        ------
        RefusedError
            If a calibration is in progress, or a value is out of range.
        ClientError
            If the calibration fails, or is not done in time.
        """
        body = {"distance": distance, "frames": frames, "bands": bands, "dark": dark}
        self._requests.ask("POST", "/api/calibration", body)
        deadline = None if timeout_s is None else time.monotonic() + timeout_s
        ended = ("done", "failed", "cancelled", "idle")
        while (found := self.status()["calibration"])["step"] not in ended:
            if deadline is not None and time.monotonic() >= deadline:
                raise ClientError(
                    f"the calibration was not done within {timeout_s:g} s: {found['message']}"
                )
            time.sleep(POLL_S)
        if found["step"] != "done":
            raise ClientError(f"there is no new calibration: {found['message']}")
        return found

    def controls(self) -> dict[str, Any]:
        """Return what of camera and LEDs may be changed.

        Returns
        -------
        dict
            Schedule, frame rate, region, time gate and masked pixels as they are, and the limits.
        """
        return self._requests.ask("GET", "/api/controls")

    def set_controls(self, **changes: Any) -> dict[str, Any]:
        """Change schedule, frame rate, region, time gate or masked pixels.

        The live run begins again. A calibration applies to its own schedule only: with another one
        pictures have no depth until there is a calibration of it.

        Parameters
        ----------
        **changes : Any
            What is to change, None for the default: ``rate_hz``, frames per second; ``rows``,
            ``cols`` and ``gate``, the first and the last one; ``masked``, row and column of
            pixels; ``schedule``, a dict of ``delays_ns`` of each band and optionally ``period_ns``.

        Returns
        -------
        dict
            The controls as they are now, as of `controls`.

        Raises
        ------
        RefusedError
            If a board can't do it, or a recording or calibration is in progress.

        Examples
        --------
        >>> camera.set_controls(rate_hz=100, rows=(40, 80), schedule=None)  # doctest: +SKIP
        """
        found = self._requests.ask("POST", "/api/controls", changes)
        self._read_instrument()
        return found

    def pixel(self, row: int, col: int, /) -> dict[str, Any]:
        """Return histogram, depth, reflectance and quality of a pixel of the latest picture.

        Parameters
        ----------
        row, col : int
            The pixel.

        Returns
        -------
        dict
            Facts about the pixel.

        Raises
        ------
        RefusedError
            If there is no such pixel, or no picture yet.
        """
        return self._requests.ask("GET", f"/api/pixel?row={int(row)}&col={int(col)}")
