# SPDX-License-Identifier: Apache-2.0
"""A capture with the simulated camera and its synthetic sensor."""

from __future__ import annotations

from collections.abc import Iterator

from hueflight_protocol.camera_map import SyntheticSource

from ..camera.camera import CameraConfig
from .camera import CompiledCamera, SimulatedCamera

BATCH_CLOCKS = 50_000


def camera_packets(
    config: CameraConfig,
    /,
    *,
    frames: int,
    source: SyntheticSource = SyntheticSource.RANDOM,
    occupancy: float = 0.3,
    seed: int = 1,
    delay_step: int = 0,
    period: int = 32,
    exposure: int = 168,
    overlap: bool = True,
    compiled: CompiledCamera | None = None,
) -> Iterator[bytes]:
    """Yield the packets of a capture of the synthetic sensor, in pieces of any size.

    Parameters
    ----------
    config : CameraConfig
        What is simulated.
    frames : int
        Frames of the capture, at least one.
    source : SyntheticSource
        Kind of codes.
    occupancy : float
        Share of pixels with a photon, of random codes; 0 to 1.
    seed : int
        Of random codes and of the scene's photons.
    delay_step : int
        Codes by which the scene moves from frame to frame.
    period : int
        Clocks.
    exposure : int
        Periods.
    overlap : bool
        Whether readouts overlap exposures.
    compiled : optional
        Of the same configuration, by `compile_camera`.
    """
    camera = SimulatedCamera(config, compiled=compiled)
    try:
        camera.write(
            "synthetic", enable=1, source=source, occupancy=min(round(occupancy * 65536), 65535)
        )
        camera.write("synthetic_seed", value=seed)
        camera.write("synthetic_delay", step=delay_step)
        camera.write("period", value=period)
        camera.write("exposure", value=exposure)
        camera.write("readout", overlap=overlap)
        camera.write("frame_limit", value=frames)
        camera.write("run", start=1)
        while True:
            yield camera.packets()
            state = camera.read("state")
            if not (state["running"] or state["sending"]):
                break
            camera.run(clocks=BATCH_CLOCKS)
        camera.run(clocks=BATCH_CLOCKS)  # what waits for the link
        yield camera.packets()
    finally:
        camera.close()
