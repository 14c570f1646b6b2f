# SPDX-License-Identifier: Apache-2.0
"""A daemon's application over a camera in memory."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

import pytest

pytest.importorskip("starlette", reason="the extra 'daemon' is not installed")
pytest.importorskip("httpx2", reason="httpx2 is not installed (extra dev)")

from starlette.testclient import TestClient

import hueflight as hf
from hueflight.daemon.config import DaemonConfig, ServerConfig
from hueflight.daemon.http.app import make_app
from hueflight.daemon.server_config import CameraConfig, Tokens
from hueflight.devices import Camera, Rig, rig_from_uri
from hueflight.emulation import CameraModel, FrameBank
from hueflight.emulation.simulated_transport import SimulatedStream, SimulatedTransport

PORT = 8470
BASE = f"http://127.0.0.1:{PORT}"
Small = Callable[..., hf.Instrument]


class FakeIllumination:
    name = "test lights"

    def prepare(self, kind: str, frames: int, /) -> None:
        pass

    def keep_alive(self) -> None:
        pass

    def close(self) -> None:
        pass


@pytest.fixture(scope="session")
def instrument(small: Small) -> hf.Instrument:
    return small(rows=6, cols=8, frame_rate_hz=2000.0, exposure_ms=0.2)


@pytest.fixture
def open_daemon(tmp_path: Path, instrument: hf.Instrument) -> Callable[..., Any]:
    """Function that opens a daemon and gives a client of it."""

    @contextmanager
    def opened(
        *,
        token: str | None = None,
        viewer_token: str | None = None,
        bank: FrameBank | None = None,
        rig: str = "",
        cameras: tuple[CameraConfig, ...] = (),
        sends: Literal["codes", "sums", "auto"] = "auto",
        **server: Any,
    ) -> Iterator[TestClient]:
        bank = bank or FrameBank.random(instrument.sensor, occupancy=0.3, frames=16)
        model = CameraModel(instrument.sensor, bank)

        def connect() -> Rig:
            camera = Camera(
                SimulatedTransport(model.handle),
                lambda size: SimulatedStream(model, size),
                simulated=True,
            )
            return Rig(camera, FakeIllumination())

        config = DaemonConfig(
            data=str(tmp_path / "data"), server=ServerConfig(**server), cameras=cameras, sends=sends
        )
        open_rig = rig_from_uri(rig, instrument) if rig else connect
        app = make_app(config, open_rig, instrument, port=PORT, tokens=Tokens(token, viewer_token))
        with TestClient(app, base_url=BASE, raise_server_exceptions=False) as client:
            yield client

    return opened


@pytest.fixture
def client(open_daemon: Callable[..., Any]) -> Iterator[TestClient]:
    with open_daemon(requests_per_s=1000, burst=1000) as made:
        yield made
