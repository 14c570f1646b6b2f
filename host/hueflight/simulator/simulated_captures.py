# SPDX-License-Identifier: Apache-2.0
"""Simulated captures: the scene, the white reference, single LEDs, dark and flat."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from hueflight.errors import SceneError
from hueflight.model.instrument import Instrument
from hueflight.model.pileup import periods_per_exposure
from hueflight.simulator.named_scenes import scene as make_scene
from hueflight.simulator.sampling import require_codes, simulate_codes, simulate_histogram
from hueflight.simulator.scene import Scene
from hueflight.simulator.settings import SimulationSettings
from hueflight_protocol import FrameFlags, encode_frame

CaptureKind = Literal["scene", "reference", "bands", "dark", "flat"]

WHITE_PLANE_M = 0.40  #: distance of the white plane, as in the paper

CAPTURES: dict[CaptureKind, str] = {
    "scene": "all LEDs on a scene",
    "reference": "all LEDs on a white plane at a known distance",
    "bands": "the same plane, one LED at a time",
    "dark": "the same plane, LEDs off",
    "flat": "the same plane under strong steady light, LEDs off: equal light for every code",
}


@dataclass(frozen=True)
class Exposure:
    """Scene and settings of one histogram of a capture.

    Attributes
    ----------
    scene : Scene
        What the instrument looks at.
    settings : SimulationSettings
        Light level, imperfections and the LEDs that fire.
    """

    scene: Scene
    settings: SimulationSettings


def exposures(
    kind: CaptureKind,
    instrument: Instrument,
    *,
    scene: Scene | None = None,
    distance: float = WHITE_PLANE_M,
    settings: SimulationSettings | None = None,
) -> tuple[Exposure, ...]:
    """List the exposures that make up a capture: one, or one for each LED of kind ``"bands"``.

    Parameters
    ----------
    kind : {"scene", "reference", "bands", "dark", "flat"}
        Kind of capture, as `CAPTURES` describes them.
    instrument : Instrument
        Simulated instrument.
    scene : Scene or None
        Scene to look at. None stands for a white plane, except for kind ``"scene"``, which
        needs a scene.
    distance : float
        Distance of the white plane, m (paper: 0.40).
    settings : SimulationSettings or None
        Light level and imperfections, None for the defaults. LEDs and ambient light are changed
        as the kind requires.

    Returns
    -------
    tuple of Exposure
        Scene and settings of each histogram of the capture.

    Raises
    ------
    SceneError
        If there is no such kind or the scene is missing.
    """
    settings = settings or SimulationSettings()
    if kind not in get_args(CaptureKind):
        raise SceneError(f"no capture {kind!r}: there are {', '.join(CAPTURES)}")
    if scene is None:
        if kind == "scene":
            raise SceneError('capture "scene" needs a scene: pass one as scene=')
        scene = make_scene("plane", instrument, distance=distance)
    if kind == "bands":
        drives = np.diag(settings.band_drive(instrument))
        return tuple(
            Exposure(scene, settings.replace(drive=tuple(map(float, drive)))) for drive in drives
        )
    if kind == "dark":
        settings = settings.replace(drive=0.0)
    if kind == "flat":
        settings = settings.replace(drive=0.0, ambient=1.0)
    return (Exposure(scene, settings),)


def simulate_capture(
    kind: CaptureKind,
    instrument: Instrument,
    *,
    frames: int,
    scene: Scene | None = None,
    distance: float = WHITE_PLANE_M,
    settings: SimulationSettings | None = None,
    seed: int = 0,
) -> NDArray[np.unsignedinteger]:
    """Simulate the histograms of a capture.

    The white reference at 0.40 m is 6.25 times as bright as white at 1 m, since the LEDs are not
    dimmed for it. With the default settings, 2.2 photons arrive per exposure and 0.89 of the
    exposures contain one; the others have code 0. As in a real instrument, brightness is
    therefore −ln(fraction of empty exposures). Set `settings.drive` below 1 to dim the LEDs.

    Parameters
    ----------
    kind : {"scene", "reference", "bands", "dark", "flat"}
        Kind of capture, as `CAPTURES` describes them.
    instrument : Instrument
        Simulated instrument.
    frames : int
        Number of exposures in each histogram.
    scene : Scene or None
        Scene to look at. None stands for a white plane, except for kind ``"scene"``, which
        needs a scene.
    distance : float
        Distance of the white plane, m (paper: 0.40).
    settings : SimulationSettings or None
        Light level and imperfections, None for the defaults. LEDs and ambient light are changed
        as the kind requires.
    seed : int
        Seed of the photon noise; each kind of capture draws numbers of its own.

    Returns
    -------
    ndarray of uint16 or uint32, shape (row, col, code) or (band, row, col, code)
        Number of exposures with each code; kind ``"bands"`` has one histogram per LED.

    Raises
    ------
    SceneError
        If there is no such kind, the scene is missing or made for another instrument, or
        `frames` is not from 1 to 2³² − 1.
    """
    parts = exposures(kind, instrument, scene=scene, distance=distance, settings=settings)
    histograms = [
        simulate_histogram(
            part.scene,
            instrument,
            frames=frames,
            settings=part.settings,
            seed=(seed, list(CAPTURES).index(kind), index),
        )
        for index, part in enumerate(parts)
    ]
    return np.stack(histograms) if kind == "bands" else histograms[0]


def simulate_packets(
    kind: CaptureKind,
    instrument: Instrument,
    *,
    frames: int,
    scene: Scene | None = None,
    distance: float = WHITE_PLANE_M,
    settings: SimulationSettings | None = None,
    seed: int = 0,
    capture: int = 0,
    clock_hz: int = 100_000_000,
) -> Iterator[bytes]:
    """Simulate the frame packets of a capture, as the camera would send them.

    The exposures of kind ``"bands"`` follow one another, within each of them the positions of a
    scanned sensor, and within those the frames. The step marker of a packet is
    ``exposure · scan_steps + position``.

    Parameters
    ----------
    kind : {"scene", "reference", "bands", "dark", "flat"}
        Kind of capture, as `CAPTURES` describes them.
    instrument : Instrument
        Simulated instrument.
    frames : int
        Number of frames for each exposure and scan position.
    scene : Scene or None
        Scene to look at. None stands for a white plane, except for kind ``"scene"``, which
        needs a scene.
    distance : float
        Distance of the white plane, m (paper: 0.40).
    settings : SimulationSettings or None
        Light level and imperfections, None for the defaults. LEDs and ambient light are changed
        as the kind requires.
    seed : int
        Seed of the photon noise; each kind of capture draws numbers of its own.
    capture : int
        Capture number in every packet.
    clock_hz : int
        Frequency of the device clock whose ticks the timestamps count, Hz.

    Returns
    -------
    iterator of bytes
        One packet per frame, with the codes of all rows and columns of the sensor.

    Raises
    ------
    SceneError
        If there is no such kind, the scene is missing, or the sensor has no code for empty
        exposures.
    """
    require_codes(instrument)
    parts = exposures(kind, instrument, scene=scene, distance=distance, settings=settings)
    seeds = (seed, list(CAPTURES).index(kind))
    return _packets(parts, instrument, frames, seeds, capture, clock_hz)


def _packets(
    parts: tuple[Exposure, ...],
    instrument: Instrument,
    frames: int,
    seeds: tuple[int, int],
    capture: int,
    clock_hz: int,
) -> Iterator[bytes]:
    """Packets of all exposures, scan positions and frames, in this order."""
    sensor = instrument.sensor
    number = count()
    for index, part in enumerate(parts):
        for position in range(sensor.scan_steps):
            blocks = simulate_codes(
                part.scene,
                instrument,
                frames=frames,
                settings=part.settings,
                seed=(*seeds, index, position),
                rows=slice(position * sensor.rows, (position + 1) * sensor.rows),
            )
            for codes in (frame for block in blocks for frame in block):
                yield frame_packet(
                    codes,
                    instrument,
                    next(number),
                    step=index * sensor.scan_steps + position,
                    capture=capture,
                    clock_hz=clock_hz,
                )


def frame_packet(
    codes: NDArray[np.uint16],
    instrument: Instrument,
    frame: int,
    *,
    step: int = 0,
    capture: int = 0,
    clock_hz: int = 100_000_000,
) -> bytes:
    """Return the packet of one simulated frame.

    Parameters
    ----------
    codes : ndarray of uint16, shape (row, col)
        Codes of all pixels of the sensor.
    instrument : Instrument
        Simulated instrument.
    frame : int
        Number of the frame, from 0.
    step : int
        Step marker of the illuminator.
    capture : int
        Capture number.
    clock_hz : int
        Frequency of the device clock whose ticks the timestamp counts, Hz.

    Returns
    -------
    bytes
        The packet.
    """
    sensor = instrument.sensor
    frame_s = 1 / sensor.frame_rate_hz if sensor.frame_rate_hz else (sensor.exposure_ms or 1) * 1e-3
    return encode_frame(
        codes,
        sequence=frame % 2**32,
        frame=frame,
        timestamp=round(frame * frame_s * clock_hz),
        code_bits=sensor.code_bits,
        periods=periods_per_exposure(instrument),
        flags=FrameFlags.SIMULATED,
        step=step,
        capture=capture,
        clock_hz=clock_hz,
    )
