# SPDX-License-Identifier: Apache-2.0
"""The simulated instrument, behind the same interfaces as the real one."""

from __future__ import annotations

import multiprocessing
import os
import tempfile
import threading
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, TypeVar

from hueflight.calibration import Calibration
from hueflight.devices.camera import Camera
from hueflight.devices.errors import DeviceError, DeviceNotFoundError
from hueflight.devices.illumination import CaptureKind
from hueflight.devices.pulse_schedule import Capacity, ChannelLimit
from hueflight.devices.rig import RigAddress, RigPart
from hueflight.devices.simulation import Changes, Repetition
from hueflight.emulation.camera_model import CameraModel
from hueflight.emulation.child_process import take_ordinary_priority
from hueflight.emulation.frame_bank import FrameBank, simulated_packets
from hueflight.emulation.fresh_frames import MOST_PIXELS_PER_S, FreshFrames
from hueflight.emulation.simulated_transport import (
    UNPLUGGED,
    SimulatedStream,
    SimulatedTransport,
)
from hueflight.errors import HueflightError
from hueflight.model.instrument import Instrument
from hueflight_protocol import illuminator_map

SERIAL = 0x51D0
DEFAULT_SCENE = "fig1"
BANK_FRAMES = 960  #: that are repeated if not every frame can have photons of its own
CALIBRATION_FRAMES = 65_000  #: as many as counts of 16 bits hold
#: of an LED, as gateware is built by default
USUAL_LIMIT = ChannelLimit(on_ticks=80, burst_ticks=80, duty_divisor=8)
CALIBRATION_SEED = 1 << 20  #: none of the photons that the camera sees
T = TypeVar("T")
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
    frames : int or None
        Number of frames of each exposure for which photons are drawn; they are then repeated in
        changing order. None draws new photons for every frame, up to the rate at which one core
        can (`fresh_frames.MOST_PIXELS_PER_S`), and beyond repeats `BANK_FRAMES` frames.
    seed : int
        Seed of the photons.

    Attributes
    ----------
    name : str
        Name of the illumination.
    model : CameraModel
        The camera.
    plugged : bool
        False to have the camera disappear as if its cable were pulled.

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
        frames: int | None = None,
        seed: int = 1,
    ) -> None:
        if instrument.sensor.scan_steps > 1:
            raise DeviceError(
                f"instrument {instrument.name!r} scans in {instrument.sensor.scan_steps} steps: "
                "the live camera has no stage; use `hueflight simulate` for recordings of it"
            )
        if (frames is not None and frames < 1) or seed < 0:
            raise DeviceError(
                f"simulated instrument: frames = {frames} must be 1 or more, seed = {seed} 0 or "
                "more"
            )
        self.instrument = instrument
        self.scene, self.distance, self.seed = scene, distance, seed
        sensor = instrument.sensor
        pixels_per_s = sensor.rows * sensor.cols * sensor.usual_frame_rate_hz
        self._draws_each = frames is None and pixels_per_s <= MOST_PIXELS_PER_S
        self.frames = frames or BANK_FRAMES
        self.plugged = True
        self._fresh: FreshFrames | None = None
        self._streams = self._repeated = 0
        self._changes = Changes()
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
        if not self.plugged:
            raise DeviceNotFoundError(f"simulated: {UNPLUGGED}")

        def is_plugged() -> bool:
            return self.plugged

        return Camera(
            SimulatedTransport(self.model.handle, is_plugged=is_plugged),
            lambda size: SimulatedStream(self.model, size, is_plugged=is_plugged),
            simulated=True,
            simulation=self,
        )

    def repetition(self) -> Repetition:
        """Return how far frames are photons of their own.

        Returns
        -------
        Repetition
            Number of distinct frames, and of frames that were repeated for want of time.
        """
        if not self._draws_each:
            return Repetition(self.frames, 0)
        fresh = self._fresh
        return Repetition(None, self._repeated + (fresh.repeated if fresh is not None else 0))

    @property
    def changes(self) -> Changes:
        """What changes in front of the camera."""
        return self._changes

    @property
    def delay_ps(self) -> float:
        """Present delay of all LED light by drift, in picoseconds."""
        return 0.0 if self._fresh is None else self._fresh.delay_ps

    def change(self, changes: Changes, /) -> None:
        """Let a ball move in front of the scene, or delays drift, or end that.

        Parameters
        ----------
        changes : Changes
            What changes in front of the camera.

        Raises
        ------
        DeviceError
            If the camera only repeats frames.
        """
        if not self._draws_each:
            raise DeviceError(
                f"the simulated camera repeats {self.frames} frames, in which nothing can move or "
                "drift: at a lower frame rate, and without 'frames' in its address, it draws each "
                "frame anew"
            )
        with self._lock:
            self._changes = changes
            if self._fresh is not None:
                self._fresh.change(changes)

    def calibrate(self, instrument: Instrument, /) -> Calibration:
        """Return a calibration from many simulated photons.

        Parameters
        ----------
        instrument : Instrument
            The instrument, with the schedule that its LEDs have.

        Returns
        -------
        Calibration
            The calibration.

        Raises
        ------
        HueflightError
            If it can't be made.
        """
        with tempfile.TemporaryDirectory(prefix="hueflight-") as folder:
            path = Path(folder) / "calibration.zarr"
            _in_a_process(simulated_calibration, instrument.to_json(), self.distance, str(path))
            return Calibration.load(path)

    @property
    def capacity(self) -> Capacity:
        """Limits of the schedules that can be simulated: those of the illuminator's usual build."""
        channels = len(self.instrument.bands)
        declared = illuminator_map(channels=channels)
        size = declared["capacity"].decode(declared["capacity"].reset)
        tick_ns = 1e-6 * declared["tick_fs"].reset
        return Capacity(
            channels, size["pulses"], size["steps"], size["lanes"], tick_ns,
            (USUAL_LIMIT,) * channels,
        )  # fmt: skip

    def load_schedule(self, instrument: Instrument, /) -> None:
        """Light scenes with the schedule that an instrument states from the next `prepare` on.

        Parameters
        ----------
        instrument : Instrument
            The instrument with that schedule.
        """
        with self._lock:
            if instrument == self.instrument:
                return
            self.instrument = instrument
            self._packets.clear()
            self._end_fresh()

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
            if self._draws_each:
                self.model.bank = self._fresh_frames(kind, frames)
                return
            if kind not in self._packets:
                self._packets[kind] = self._draw(kind)
            per_step = frames if kind == "bands" else 0
            self.model.bank = FrameBank(
                self._packets[kind], frames_per_step=per_step, seed=self.seed
            )

    def keep_alive(self) -> None:
        """Do nothing: a simulated illumination has no watchdog."""

    def close(self) -> None:
        """Do nothing: there is no port to release, and photons go on when the camera is back."""

    def _fresh_frames(self, kind: CaptureKind, frames: int) -> FreshFrames:
        """Frames of a capture: those of the run before go on, unless LEDs or target change."""
        before = self._fresh
        if before is not None:
            if before.kind == kind and kind != "bands":
                return before
            self._end_fresh()
        self._streams += 1
        self._fresh = FreshFrames(
            kind, self.instrument, scene=self.scene, distance=self.distance,
            seed=self.seed + self._streams - 1, frames=frames, changes=self._changes,
        )  # fmt: skip
        return self._fresh

    def _end_fresh(self) -> None:
        """End the process that draws photons, if there is one."""
        if self._fresh is not None:
            self._repeated += self._fresh.repeated
            self._fresh.close()
            self._fresh = None

    def _draw(self, kind: CaptureKind) -> list[bytes]:
        """Draw photons in a process of its own: here it would delay every thread."""
        frames = max(1, self.frames // 4) if kind == "bands" else self.frames
        arguments = (
            kind, self.instrument.to_json(), self.scene, self.distance, frames, self.seed
        )  # fmt: skip
        return _in_a_process(simulated_packets, *arguments)


def simulated_calibration(instrument_json: str, distance: float, path: str) -> None:
    """Calibrate with simulated captures, and save the result; in a process of its own.

    Parameters
    ----------
    instrument_json : str
        The instrument as JSON.
    distance : float
        Distance of the white target, in metres.
    path : str
        Where to save the calibration.
    """
    from hueflight import simulator
    from hueflight.calibration import calibrate

    instrument = Instrument.from_json(instrument_json)
    # captures of one LED at a time would take several times as long, and nobody wants to wait
    reference = simulator.simulate_capture(
        "reference", instrument, frames=CALIBRATION_FRAMES, distance=distance, seed=CALIBRATION_SEED
    )
    calibrate(reference, instrument, distance=distance).save(path)


def _in_a_process(work: Callable[..., T], *arguments: Any) -> T:
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_send_result, args=(sender, work, arguments), daemon=True)
    process.start()
    sender.close()  # so that the end of the process is the end of the stream
    try:
        if not receiver.poll(_DRAW_TIMEOUT_S):
            raise DeviceError(f"simulated instrument: nothing was drawn in {_DRAW_TIMEOUT_S} s")
        result = receiver.recv()
    except EOFError:
        raise DeviceError(
            "simulated instrument: a process has ended without a result; its error is in the log"
        ) from None
    finally:
        receiver.close()
        process.terminate()
        process.join()
    if isinstance(result, BaseException):
        raise result
    return result


def _send_result(sender: Connection, work: Callable[..., Any], arguments: tuple[Any, ...]) -> None:
    """Work in a process of its own, and send the result or the expected failure."""
    _end_with_parent()
    take_ordinary_priority()
    try:
        result = work(*arguments)
    except (HueflightError, OSError) as error:
        result = error
    sender.send(result)


def _end_with_parent() -> None:
    """End this process when the one that started it is killed; otherwise it would wait for ever."""
    parent = multiprocessing.parent_process()

    def wait() -> None:
        if parent is not None:
            parent.join()
        os._exit(1)

    threading.Thread(target=wait, daemon=True).start()
