"""The simulated instrument behind the same interfaces as the real one."""

from __future__ import annotations

import multiprocessing
import threading
from concurrent.futures import Future, ProcessPoolExecutor

from hueflight.devices.camera import Camera
from hueflight.devices.errors import DeviceError
from hueflight.devices.illumination import CaptureKind
from hueflight.devices.rig import Rig
from hueflight.emulation.camera_model import CameraModel
from hueflight.emulation.frame_bank import FrameBank, simulated_packets
from hueflight.emulation.simulated_transport import SimulatedStream, SimulatedTransport
from hueflight.model.instrument import Instrument

SERIAL = 0x51D0
_DRAW_TIMEOUT_S = 300


class SimulatedInstrument:
    """A camera model whose sensor sees simulated scenes; also the lights that shine on them.

    Parameters
    ----------
    instrument : to simulate.
    scene : what capture ``"scene"`` looks at.
    distance : of the white target of the other captures, metres.
    frames : photons are drawn for so many frames of each exposure, which are then repeated in
        changing order.
    seed : of the photons.

    Raises
    ------
    DeviceError
        If the sensor scans, which no camera model does.
    """

    name = "simulated"

    def __init__(
        self,
        instrument: Instrument,
        /,
        *,
        scene: str = "fig1",
        distance: float = 0.40,
        frames: int = 960,
        seed: int = 1,
    ) -> None:
        if instrument.sensor.scan_steps > 1:
            raise DeviceError(
                f"instrument {instrument.name!r} scans in {instrument.sensor.scan_steps} steps: "
                "the live camera has no stage; use `hueflight simulate` for recordings of it"
            )
        self.instrument = instrument
        self.scene, self.distance, self.frames, self.seed = scene, distance, frames, seed
        self._banks: dict[CaptureKind, list[bytes]] = {}
        self._lock = threading.Lock()
        # all dark until the first capture is prepared
        self.model = CameraModel(
            instrument.sensor,
            FrameBank.random(instrument.sensor, occupancy=0.0, frames=1),
            serial=SERIAL,
        )

    def connect(self) -> Rig:
        """Open the rig."""
        camera = Camera(
            SimulatedTransport(self.model.handle),
            lambda size: SimulatedStream(self.model, size),
            simulated=True,
        )
        return Rig(camera, self)

    def prepare(self, kind: CaptureKind, frames: int, /) -> None:
        """Put the scene or target of a capture before the camera."""
        with self._lock:
            if kind not in self._banks:
                self._banks[kind] = self._draw(kind)
            per_step = frames if kind == "bands" else 0
            self.model.bank = FrameBank(self._banks[kind], frames_per_step=per_step, seed=self.seed)

    def keep_alive(self) -> None:
        """Need nothing."""

    def close(self) -> None:
        """Need nothing."""

    def _draw(self, kind: CaptureKind) -> list[bytes]:
        """Photons from a process of its own: drawing them here would hold up every thread."""
        frames = max(1, self.frames // 4) if kind == "bands" else self.frames
        arguments = (
            kind, self.instrument.to_json(), self.scene, self.distance, frames, self.seed
        )  # fmt: skip
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(1, mp_context=context) as pool:
            drawn: Future[list[bytes]] = pool.submit(simulated_packets, *arguments)
            return drawn.result(_DRAW_TIMEOUT_S)
