# SPDX-License-Identifier: Apache-2.0
"""The client for programs that use asyncio: the same requests, each awaited."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Self

import xarray as xr

from hueflight.client.feed import PictureFeed
from hueflight.client.sync_client import Client, connect
from hueflight.client.types import CaptureKind, Delivery, Exposure, RemoteRecording
from hueflight.model.instrument import Instrument


async def connect_async(
    address: str,
    /,
    *,
    token: str | None = None,
    timeout_s: float = 10.0,
    reconnect_s: float = 30.0,
) -> AsyncClient:
    """Connect to a capture daemon, in a program that uses asyncio.

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
    AsyncClient
        The client, to be closed or used in an `async with` block.

    Raises
    ------
    NotReachableError
        If no daemon answers.
    TokenError
        If the daemon requires another token.
    VersionMismatchError
        If it speaks another version of the protocol.
    """
    client = await asyncio.to_thread(
        connect, address, token=token, timeout_s=timeout_s, reconnect_s=reconnect_s
    )
    return AsyncClient(client)


class AsyncClient:
    """Connection to a daemon, for asyncio; `connect_async` makes it.

    Every method does what the method of `Client` with the same name does.

    Parameters
    ----------
    client : Client
        The client that does the work, in threads.
    """

    def __init__(self, client: Client, /) -> None:
        self._client = client
        self._snapshots: _AsyncFeed | None = None

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    @property
    def instrument(self) -> Instrument:
        """Instrument of the daemon."""
        return self._client.instrument

    async def close(self) -> None:
        """Close the connection."""
        if self._snapshots is not None:
            await self._snapshots.close()
            self._snapshots = None

    async def pictures(
        self, which: Delivery = "newest", /, *, timeout_s: float | None = None
    ) -> AsyncIterator[xr.Dataset]:
        """Iterate over live pictures; see `Client.pictures`."""
        feed = _AsyncFeed(self._client.open_feed(which))
        try:
            while True:
                yield self._client.described(await feed.next(timeout_s))
        finally:
            await feed.close()

    async def picture(self, *, timeout_s: float | None = 10.0) -> xr.Dataset:
        """Return the newest picture that was not returned before; see `Client.picture`."""
        if self._snapshots is None:
            self._snapshots = _AsyncFeed(self._client.open_feed("newest"))
        try:
            return self._client.described(await self._snapshots.next(timeout_s))
        except asyncio.CancelledError:
            self._snapshots = None  # its thread was interrupted
            raise

    async def status(self) -> dict[str, Any]:
        """Return the daemon's status."""
        return await asyncio.to_thread(self._client.status)

    async def start(self) -> None:
        """Start the live run."""
        await asyncio.to_thread(self._client.start)

    async def stop(self) -> None:
        """End the present run, and stay idle."""
        await asyncio.to_thread(self._client.stop)

    async def expose(self, frames: int = 0, /, *, timeout_s: float | None = 60.0) -> xr.Dataset:
        """Return a picture of photons that come from now on; see `Client.expose`."""
        return await asyncio.to_thread(self._client.expose, frames, timeout_s=timeout_s)

    async def set_frames(self, frames: int = 0, /) -> Exposure:
        """Set the frames behind each live picture; see `Client.set_frames`."""
        return await asyncio.to_thread(self._client.set_frames, frames)

    async def record(
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
        """Begin a recording and return its name; see `Client.record`."""
        return await asyncio.to_thread(
            self._client.record,
            name,
            kind=kind,
            frames=frames,
            seconds=seconds,
            note=note,
            until_depth_std=until_depth_std,
            until_reflectance_std=until_reflectance_std,
            share=share,
        )

    async def stop_recording(self) -> str:
        """End the recording in progress and return its name."""
        return await asyncio.to_thread(self._client.stop_recording)

    async def wait_for_recording(
        self, name: str, /, *, timeout_s: float | None = None
    ) -> dict[str, Any]:
        """Wait until a recording has ended; see `Client.wait_for_recording`."""
        return await asyncio.to_thread(self._client.wait_for_recording, name, timeout_s=timeout_s)

    async def recordings(self) -> list[RemoteRecording]:
        """Return the finished recordings, newest first."""
        return await asyncio.to_thread(self._client.recordings)

    async def download(
        self, name: str, folder: str | Path = ".", /, *, overwrite: bool = False
    ) -> Path:
        """Download all segments of a recording; see `Client.download`."""
        return await asyncio.to_thread(self._client.download, name, folder, overwrite=overwrite)

    async def calibrate(
        self,
        *,
        distance: float,
        frames: int = 4000,
        bands: bool = True,
        dark: bool = False,
        timeout_s: float | None = None,
    ) -> dict[str, Any]:
        """Calibrate, and wait until the calibration is in use; see `Client.calibrate`."""
        return await asyncio.to_thread(
            self._client.calibrate,
            distance=distance,
            frames=frames,
            bands=bands,
            dark=dark,
            timeout_s=timeout_s,
        )

    async def controls(self) -> dict[str, Any]:
        """Return what of camera and LEDs may be changed; see `Client.controls`."""
        return await asyncio.to_thread(self._client.controls)

    async def set_controls(self, **changes: Any) -> dict[str, Any]:
        """Change schedule, frame rate, region, time gate or masked pixels.

        See `Client.set_controls`.
        """
        return await asyncio.to_thread(self._client.set_controls, **changes)

    async def pixel(self, row: int, col: int, /) -> dict[str, Any]:
        """Return facts about a pixel of the latest picture; see `Client.pixel`."""
        return await asyncio.to_thread(self._client.pixel, row, col)


class _AsyncFeed:
    """Feed of pictures in a thread of its own, so that many of them can wait at once."""

    def __init__(self, feed: PictureFeed) -> None:
        self._feed = feed
        self._thread = ThreadPoolExecutor(1, "hueflight-pictures")

    async def next(self, timeout_s: float | None) -> xr.Dataset:
        loop = asyncio.get_running_loop()
        try:
            return await loop.run_in_executor(self._thread, self._feed.next, timeout_s)
        except asyncio.CancelledError:
            await self.close()
            raise

    async def close(self) -> None:
        await asyncio.to_thread(self._feed.close)
        self._thread.shutdown(wait=False)
