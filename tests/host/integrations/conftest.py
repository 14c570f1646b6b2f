# SPDX-License-Identifier: Apache-2.0
"""A calibrated daemon with a small simulated instrument, for adapters of other programs."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

import hueflight as hf
from support.daemon_process import Daemon
from support.small_daemon import small_daemon, small_instrument


@pytest.fixture(scope="session")
def calibrated(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Daemon]:
    folder = tmp_path_factory.mktemp("integrations")
    daemon = small_daemon(folder, small_instrument(folder))
    try:
        with hf.connect(daemon.url) as camera:
            camera.start()
            camera.calibrate(distance=0.4, frames=1000, bands=False, timeout_s=240)
            camera.start()
            next(picture for picture in camera.pictures(timeout_s=120) if "depth" in picture)
        yield daemon
    finally:
        daemon.end()


@pytest.fixture(scope="session")
def image_file(calibrated: Daemon, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A live picture as a Zarr store."""
    path = tmp_path_factory.mktemp("image") / "scene.zarr"
    with hf.connect(calibrated.url) as camera:
        hf.write_image(camera.expose(480), path)
    return path
