# SPDX-License-Identifier: Apache-2.0
"""A detector for Bluesky, made of ophyd-async's logics for triggers, acquisition and data.

Each event is a picture of photons that come after its trigger. Pictures are appended to a Zarr
store, and the documents refer to it; see the page *Bluesky* of the documentation.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from hueflight.client import AsyncClient, ClientError, connect_async
from hueflight.files.optional import import_optional
from hueflight.integrations.picture_store import PictureStore

core: Any = import_optional("ophyd_async.core", extra="bluesky")

ARRAYS = ("depth", "depth_std", "reflectance", "reflectance_std", "photons", "quality")
MIMETYPE = "application/x-zarr"
PATIENCE_S = 60.0  #: for a picture, beyond its exposure


class HueflightDetector(core.StandardDetector):
    """Camera of a capture daemon as a detector.

    Parameters
    ----------
    address : str
        Address of the daemon.
    path_provider : ophyd_async.core.PathProvider
        Says where the Zarr stores are written.
    token : str, optional
        Token that the daemon requires, unless it listens on loopback only.
    frames : int
        Frames behind a picture where a plan states no live time; 0 for as many as when the daemon
        started.
    arrays : sequence of str
        Arrays to keep, of `hueflight.integrations.planes.picture_arrays`. The first one is plotted.
    record : bool
        Whether the daemon also records all photons from the first event until the end of the run.
    name : str
        Name of the detector.

    Examples
    --------
    >>> detector = HueflightDetector("localhost:8470", paths, name="camera")  # doctest: +SKIP
    >>> engine(bp.count([detector], num=10))  # doctest: +SKIP
    """

    def __init__(
        self,
        address: str,
        path_provider: Any,
        /,
        *,
        token: str | None = None,
        frames: int = 0,
        arrays: Sequence[str] = ARRAYS,
        record: bool = False,
        name: str = "",
    ) -> None:
        self._camera = _Camera(address, token, frames)
        self.frames, self._set_frames = core.soft_signal_r_and_setter(int, initial_value=frames)
        self.instrument, self._set_instrument = core.soft_signal_r_and_setter(str)
        self.recording, set_recording = core.soft_signal_r_and_setter(str)
        self.written, set_written = core.soft_signal_r_and_setter(int)
        self._data = _DataLogic(
            self._camera, path_provider, tuple(arrays), self.written, set_written
        )
        self.add_detector_logics(
            _TriggerLogic(self._camera, self._set_frames),
            _AcquireLogic(self._camera, self._data, set_recording if record else None),
            self._data,
        )
        self.add_config_signals(self.frames, self.instrument, self.recording)
        super().__init__(name=name)

    async def connect(
        self, mock: Any = False, timeout: float = 10.0, force_reconnect: bool = False
    ) -> None:
        """Connect to the daemon, and start its live run if it is idle.

        Parameters
        ----------
        mock : bool
            Not supported: a simulated camera is a daemon's (``hueflight serve --simulate``).
        timeout : float
            Seconds within which the daemon must answer.
        force_reconnect : bool
            Whether to connect anew.

        Raises
        ------
        ClientError
            If no daemon answers, or it requires another token.
        """
        if mock:
            raise ClientError("there is no mock of a camera: use hueflight serve --simulate")
        await super().connect(mock=False, timeout=timeout, force_reconnect=force_reconnect)
        await self._camera.connect(timeout, anew=force_reconnect)
        self._set_instrument(self._camera.client.instrument.name)


class _Camera:
    """The connection, and what the next exposures are like."""

    def __init__(self, address: str, token: str | None, frames: int) -> None:
        self._address, self._token = address, token
        self._client: AsyncClient | None = None
        self.frames, self.exposures = frames, 1

    @property
    def client(self) -> AsyncClient:
        if self._client is None:
            raise ClientError("the detector is not connected: await detector.connect() first")
        return self._client

    @property
    def rate_hz(self) -> float:
        return self.client.instrument.sensor.usual_frame_rate_hz

    async def connect(self, timeout_s: float, *, anew: bool) -> None:
        if self._client is not None and anew:
            await self._client.close()
            self._client = None
        if self._client is None:
            self._client = await connect_async(
                self._address, token=self._token, timeout_s=timeout_s
            )
        if (await self._client.status())["state"] == "idle":
            await self._client.start()


class _TriggerLogic(core.DetectorTriggerLogic):
    """Exposures begin when the plan triggers, and take the frames of their live time."""

    def __init__(self, camera: _Camera, set_frames: Any) -> None:
        self._camera, self._set_frames = camera, set_frames

    async def prepare_internal(self, num: int, livetime: float, deadtime: float) -> None:
        if livetime:
            self._camera.frames = max(1, round(livetime * self._camera.rate_hz))
        self._camera.exposures = num
        self._set_frames(self._camera.frames)

    async def default_trigger_info(self) -> Any:
        return core.TriggerInfo()


class _DataLogic(core.DetectorDataLogic):
    """Pictures go to a Zarr store, whose arrays are streams."""

    def __init__(
        self, camera: _Camera, paths: Any, names: tuple[str, ...], written: Any, set_written: Any
    ) -> None:
        self._camera, self._paths, self._names = camera, paths, names
        self._written, self._set_written = written, set_written
        self.store: PictureStore | None = None

    async def prepare_unbounded(self, datakey_name: str) -> Any:
        info = self._paths(datakey_name)
        path = Path(info.directory_path) / f"{info.filename}.zarr"
        self.store = await asyncio.to_thread(
            PictureStore, path, self._camera.client.instrument, self._names
        )
        self._set_written(0)
        resources = [
            core.StreamResourceInfo(
                data_key=self._key(datakey_name, name),
                shape=kept.shape,
                chunk_shape=(1, *kept.shape),
                dtype_numpy=kept.dtype.str,
                parameters={"dataset": name},
            )
            for name, kept in self.store.arrays.items()
        ]
        return core.StreamResourceDataProvider(
            uri=f"{info.directory_uri}{info.filename}.zarr",
            resources=resources,
            mimetype=MIMETYPE,
            collections_written_signal=self._written,
        )

    async def append(self, picture: Any) -> None:
        store = self.store
        assert store is not None  # prepared before anything is acquired
        await asyncio.to_thread(store.append, picture)
        self._set_written(store.count)

    def get_hinted_fields(self, datakey_name: str) -> Sequence[str]:
        return [self._key(datakey_name, self._names[0])]

    async def stop(self) -> None:
        self.store = None

    @staticmethod
    def _key(datakey_name: str, name: str) -> str:
        return f"{datakey_name}-{name.replace(' ', '_')}"


class _AcquireLogic(core.DetectorAcquireLogic):
    """Takes pictures one after another, and if asked for lets the daemon record meanwhile."""

    def __init__(self, camera: _Camera, data: _DataLogic, set_recording: Any) -> None:
        self._camera, self._data, self._set_recording = camera, data, set_recording
        self._task: asyncio.Task[None] | None = None
        self._recording = ""

    async def start_acquiring(self) -> None:
        if self._set_recording is not None and not self._recording:
            self._recording = await self._camera.client.record()
            self._set_recording(self._recording)
        self._task = asyncio.create_task(self._expose())

    async def _expose(self) -> None:
        camera = self._camera
        for _ in range(camera.exposures):
            patience_s = PATIENCE_S + camera.frames / camera.rate_hz
            picture = await camera.client.expose(camera.frames, timeout_s=patience_s)
            await self._data.append(picture)

    async def wait_for_idle(self) -> None:
        if self._task is not None:
            await self._task

    async def ensure_stopped(self) -> None:
        if self._task is not None:
            self._task.cancel()
            with contextlib.suppress(asyncio.CancelledError, ClientError):
                await self._task
            self._task = None
        if self._recording:
            name, self._recording = self._recording, ""
            await self._camera.client.stop_recording()
            await self._camera.client.wait_for_recording(name)
