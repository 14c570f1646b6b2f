# SPDX-License-Identifier: Apache-2.0
"""A rig in memory whose cable and power can be pulled."""

from __future__ import annotations

import threading
from dataclasses import dataclass, field

import numpy as np

import hueflight as hf
from hueflight.devices import Camera, DeviceGoneError, DeviceNotFoundError, Rig
from hueflight.devices.illumination import CaptureKind
from hueflight.emulation import CameraModel, FrameBank
from hueflight.emulation.simulated_transport import SimulatedStream, SimulatedTransport


@dataclass
class Faults:
    """What a test does to the rig while it is in use."""

    plugged: bool = True
    silent: bool = False
    held: bool = False  #: nothing comes for the time being, and nothing is lost
    damage: float = 0.0
    late_reads: int = 0  #: of a stream just opened, before anything comes
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))


class FaultyTransport(SimulatedTransport):
    def __init__(self, model: CameraModel, faults: Faults) -> None:
        super().__init__(model.handle, "test rig")
        self._faults = faults

    def send(self, message: bytes, /) -> None:
        if not self._faults.plugged:
            raise DeviceGoneError("test rig: unplugged")
        if not self._faults.silent:
            super().send(message)


class FaultyStream(SimulatedStream):
    def __init__(self, model: CameraModel, size: int, faults: Faults) -> None:
        super().__init__(model, size)
        self._faults = faults
        self._late_reads = faults.late_reads

    def read(self, timeout_s: float, /) -> bytes:
        faults = self._faults
        if not faults.plugged:
            raise DeviceGoneError("test rig: unplugged")
        if faults.held:
            return b""
        if self._late_reads:
            self._late_reads -= 1
            return b""
        data = super().read(min(timeout_s, 0.01))
        if data and faults.rng.random() < faults.damage:
            spoiled = bytearray(data)
            spoiled[faults.rng.integers(len(spoiled))] ^= 1 << int(faults.rng.integers(8))
            data = bytes(spoiled)
        return b"" if faults.silent else data


class FaultyRig:
    """One camera model that is plugged, unplugged, and loses power."""

    def __init__(self, instrument: hf.Instrument, *, occupancy: float = 0.3, seed: int = 0) -> None:
        bank = FrameBank.random(instrument.sensor, occupancy=occupancy, frames=16, seed=seed)
        self.model = CameraModel(instrument.sensor, bank)
        self.faults = Faults(rng=np.random.default_rng(seed))
        self.prepared: list[tuple[CaptureKind, int]] = []
        self.kept_alive = threading.Event()
        self.name = "test lights"

    def connect(self) -> Rig:
        if not self.faults.plugged:
            raise DeviceNotFoundError("test rig: not plugged in")
        faults = self.faults
        camera = Camera(
            FaultyTransport(self.model, faults),
            lambda size: FaultyStream(self.model, size, faults),
            simulated=True,
        )
        return Rig(camera, self)

    def power_loss(self) -> None:
        self.faults.plugged = False
        self.model.reset()

    def prepare(self, kind: CaptureKind, frames: int, /) -> None:
        self.prepared.append((kind, frames))

    def keep_alive(self) -> None:
        self.kept_alive.set()

    def close(self) -> None:
        pass
