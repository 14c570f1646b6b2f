# SPDX-License-Identifier: Apache-2.0
"""The simulated instrument, behind the same interfaces as the real one."""

from __future__ import annotations

import multiprocessing
import os
import threading
from concurrent.futures import Future, ProcessPoolExecutor

from hueflight.devices.camera import Camera
from hueflight.devices.errors import DeviceError
from hueflight.devices.illumination import CaptureKind
from hueflight.devices.rig import RigAddress, RigPart
from hueflight.emulation.camera_model import CameraModel
from hueflight.emulation.frame_bank import FrameBank, simulated_packets
from hueflight.emulation.simulated_transport import SimulatedStream, SimulatedTransport
from hueflight.model.instrument import Instrument

SERIAL = 0x51D0
DEFAULT_SCENE = "fig1"
_DRAW_TIMEOUT_S = 300


def open_part(address: RigAddress, instrument: Instrument, /) -> RigPart:
    """Return how to open a simulated instrument, for the scheme ``simulated``.

    Parameters
    ----------
    address : RigAddress
        Its path is the scene, empty for the default one; its options are ``distance``,
        ``frames`` and ``seed``, as of `SimulatedInstrument`.
    instrument : Instrument
        The instrument to simulate.

    Returns
    -------
    RigPart
        Opens camera and illumination. Photons are drawn once and kept from one connection to the
        next.

    Raises
    ------
    DeviceError
        If an option is not known, or the instrument scans.
    """
    options = address.convert_options(distance=float, frames=int, seed=int)
    simulated = SimulatedInstrument(instrument, scene=address.path or DEFAULT_SCENE, **options)
    return RigPart(simulated.open_camera, lambda: simulated)


class SimulatedInstrument:
    """A camera model whose sensor sees simulated scenes, and the illumination of these scenes.

    Parameters
    ----------
    instrument : Instrument
        The instrument to simulate.
    scene : str
        What a capture of kind ``"scene"`` sees, one of `hueflight.simulator.scenes`.
    distance : float
        Distance of the white target of the other captures, in metres.
    frames : int
        Number of frames of each exposure for which photons are drawn; they are then repeated in
        changing order.
    seed : int
        Seed of the photons.

    Attributes
    ----------
    name : str
        Name of the illumination.
    model : CameraModel
        The camera.

    Raises
    ------
    DeviceError
        If the sensor scans, which the camera model does not, or a number is out of its range.
    """

    name = "simulated"

    def __init__(
        self,
        instrument: Instrument,
        /,
        *,
        scene: str = DEFAULT_SCENE,
        distance: float = 0.40,
        frames: int = 960,
        seed: int = 1,
    ) -> None:
        if instrument.sensor.scan_steps > 1:
            raise DeviceError(
                f"instrument {instrument.name!r} scans in {instrument.sensor.scan_steps} steps: "
                "the live camera has no stage; use `hueflight simulate` for recordings of it"
            )
        if frames < 1 or seed < 0:
            raise DeviceError(
                f"simulated instrument: frames = {frames} must be 1 or more, seed = {seed} 0 or "
                "more"
            )
        self.instrument = instrument
        self.scene, self.distance, self.frames, self.seed = scene, distance, frames, seed
        self._packets: dict[CaptureKind, list[bytes]] = {}
        self._lock = threading.Lock()
        # all dark until the first capture is prepared
        self.model = CameraModel(
            instrument.sensor,
            FrameBank.random(instrument.sensor, occupancy=0.0, frames=1),
            serial=SERIAL,
        )

    def open_camera(self) -> Camera:
        """Open the camera.

        Returns
        -------
        Camera
            The camera, whose photons are simulated.
        """
        return Camera(
            SimulatedTransport(self.model.handle),
            lambda size: SimulatedStream(self.model, size),
            simulated=True,
        )

    def prepare(self, kind: CaptureKind, frames: int, /) -> None:
        """Put the scene or target of a capture in front of the camera.

        Parameters
        ----------
        kind : CaptureKind
            What the capture is for.
        frames : int
            Number of frames for each LED of a capture of kind ``"bands"``.
        """
        with self._lock:
            if kind not in self._packets:
                self._packets[kind] = self._draw(kind)
            per_step = frames if kind == "bands" else 0
            self.model.bank = FrameBank(
                self._packets[kind], frames_per_step=per_step, seed=self.seed
            )

    def keep_alive(self) -> None:
        """Do nothing: a simulated illumination has no watchdog."""

    def close(self) -> None:
        """Do nothing: there is no port to release."""

    def _draw(self, kind: CaptureKind) -> list[bytes]:
        """Draw photons in a process of its own: here it would delay every thread."""
        frames = max(1, self.frames // 4) if kind == "bands" else self.frames
        arguments = (
            kind, self.instrument.to_json(), self.scene, self.distance, frames, self.seed
        )  # fmt: skip
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(1, mp_context=context, initializer=_end_with_parent) as pool:
            drawn: Future[list[bytes]] = pool.submit(simulated_packets, *arguments)
            return drawn.result(_DRAW_TIMEOUT_S)


def _end_with_parent() -> None:
    """End this process when the one that started it is killed; otherwise it would wait for ever."""
    parent = multiprocessing.parent_process()

    def wait() -> None:
        if parent is not None:
            parent.join()
        os._exit(1)

    threading.Thread(target=wait, daemon=True).start()
