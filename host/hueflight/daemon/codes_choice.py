# SPDX-License-Identifier: Apache-2.0
"""Whether the camera sends codes or sums: codes where its link carries them, sums where not.

The mean size of a frame of codes follows from the photons that are counted, which sums tell as
well. What the frames of a second would take is compared with what the link carries.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal

import structlog

from hueflight.acquisition.run_settings import RunSettings
from hueflight.acquisition.runner import Acquisition
from hueflight.acquisition.snapshot import Snapshot
from hueflight.acquisition.sums_reduction import reduction_of
from hueflight.acquisition.supervised_thread import SupervisedThread
from hueflight.calibration import Calibration
from hueflight.devices.reduction import NO_REDUCTION
from hueflight.errors import HueflightError
from hueflight.model.instrument import Sensor
from hueflight_protocol.links import LINKS, packet_bytes

Sent = Literal["codes", "sums"]
Wanted = Literal["codes", "sums", "auto"]

BACK_SHARE = 0.9  #: of the link that codes may take at most for the camera to go back to them
CAPTURE_SHARE = 0.9  #: of the link that full frames of a capture may take: all of it loses some
OCCUPANCY_STEP = 0.02  #: to which occupancies are rounded up
MEASURED_S = 1.0  #: over which photons are counted
_LOOK_S = 0.25
log = structlog.get_logger("hueflight.daemon")


@dataclass(frozen=True)
class Choice:
    """What the camera sends, and why.

    Attributes
    ----------
    sent : str
        ``"codes"`` or ``"sums"``.
    reason : str
        Reason in words.
    """

    sent: Sent
    reason: str


def codes_bytes(sensor: Sensor, occupancy: float, /) -> float:
    """Return the mean size of a frame of codes.

    Parameters
    ----------
    sensor : Sensor
        Geometry and code width.
    occupancy : float
        Share of pixels with a photon.

    Returns
    -------
    float
        Bytes; for the occupancy rounded up to `OCCUPANCY_STEP`.
    """
    rounded = min(1.0, -(-occupancy // OCCUPANCY_STEP) * OCCUPANCY_STEP)
    return packet_bytes(sensor.rows, sensor.cols, round(rounded, 2), code_bits=sensor.code_bits)


def choose(
    wanted: Wanted,
    *,
    obstacle: str,
    link: str,
    codes_bytes_per_s: float | None,
    present: Sent,
) -> Choice:
    """Choose what the camera sends.

    Parameters
    ----------
    wanted : str
        What the configuration says.
    obstacle : str
        Why the camera can't send sums now; empty if it can.
    link : str
        What the stream goes over; empty if that is not known.
    codes_bytes_per_s : float or None
        What codes of all frames take; None while no frame has come.
    present : str
        What the camera sends at present.

    Returns
    -------
    Choice
        What it is to send.
    """
    if wanted == "codes":
        return Choice("codes", "so configured")
    if wanted == "sums":
        return (
            Choice("codes", f"no sums: {obstacle}") if obstacle else Choice("sums", "so configured")
        )
    if link not in LINKS:
        return Choice("codes", "what the link carries is not known")
    if codes_bytes_per_s is None:
        return Choice(present, "no frame has come yet")
    carried = LINKS[link]
    share = 1.0 if present == "codes" else BACK_SHARE
    load = f"{codes_bytes_per_s / 1e6:,.0f} MB/s of codes, {link} carries {carried / 1e6:,.0f}"
    if codes_bytes_per_s <= share * carried:
        return Choice("codes", load)
    return Choice("codes", f"{load}, but no sums: {obstacle}") if obstacle else Choice("sums", load)


class CodesChoice:
    """Has the camera send codes or sums, in a thread of its own.

    Parameters
    ----------
    acquisition : Acquisition
        Acquisition whose controls are changed.
    wanted : str
        ``"codes"``, ``"sums"`` or ``"auto"``.
    calibration : callable
        Returns the calibration in use, or None.
    settings : callable
        Returns how streams are cut into pictures.
    lock : RLock
        Held while calibration or controls are changed.

    Attributes
    ----------
    choice : Choice
        What the camera sends, and why.
    thread : SupervisedThread
        Thread that looks whether anything has changed.
    """

    def __init__(
        self,
        acquisition: Acquisition,
        wanted: Wanted,
        /,
        *,
        calibration: Callable[[], Calibration | None],
        settings: Callable[[], RunSettings],
        lock: threading.RLock,
    ) -> None:
        self._acquisition = acquisition
        self.wanted: Wanted = wanted
        self._calibration, self._settings, self._lock = calibration, settings, lock
        self.choice = choose(wanted, obstacle="", link="", codes_bytes_per_s=None, present="codes")
        if wanted != "codes":
            self.choice = Choice("codes", "no camera yet")
        self._made: tuple[object, ...] | None = None  # what the present sums are of
        self._refused: tuple[object, ...] | None = None  # of what no sums can be made
        self._refusal = ""
        self._measured: tuple[float, int, int] | None = None  # time, frames and photons
        self._occupancy: float | None = None
        self._limit_hz: float | None = None  # of codes that the link carries in any light
        self._closing = threading.Event()
        self.thread = SupervisedThread(self._work, name="codes or sums")
        self.thread.start()

    def as_dict(self) -> dict[str, Any]:
        """Return what the camera sends as plain values, for the API.

        Returns
        -------
        dict
            What it sends, what is configured, the reason, and the link.
        """
        choice = self.choice
        return {
            "sent": choice.sent,
            "configured": self.wanted,
            "reason": choice.reason,
            "link": self._acquisition.snapshot.link,
        }

    def close(self) -> None:
        """End the thread."""
        self._closing.set()
        self.thread.end()
        self.thread.join(10)

    def _work(self) -> None:
        while not self._closing.wait(_LOOK_S):
            self.thread.beat()
            self.look()
            self.thread.recovered()

    def look(self) -> None:
        """Look whether anything has changed, and have the camera send what is right."""
        snapshot = self._acquisition.snapshot
        if not snapshot.connections:
            return
        self._measure(snapshot, time.monotonic())
        calibration, frames = self._calibration(), self._settings().block_frames
        needed = self._codes_bytes_per_s(snapshot)
        choice = choose(
            self.wanted,
            obstacle=self._obstacle(snapshot, calibration, frames),
            link=snapshot.link,
            codes_bytes_per_s=needed,
            present=self.choice.sent,
        )
        self._limit_hz = self._codes_limit_hz(snapshot.link)
        if choice.sent == "codes":
            self._send_codes()
        elif calibration is not None and not self._send_sums(snapshot, calibration, frames):
            return  # something has changed meanwhile: look again
        if choice.sent != self.choice.sent or choice.reason != self.choice.reason:
            changed = choice.sent != self.choice.sent
            self.choice = choice
            (log.info if changed else log.debug)("camera sends", **self.as_dict())

    def _measure(self, snapshot: Snapshot, now_s: float) -> None:
        """Count photons of live frames, once a second."""
        if snapshot.kind != "live":
            self._measured = None
            return
        counted = now_s, snapshot.totals.delivered, snapshot.photons
        if self._measured is None:
            self._measured = counted
            return
        before_s, frames, photons = self._measured
        if now_s - before_s < MEASURED_S or snapshot.totals.delivered <= frames:
            return
        sensor = self._acquisition.instrument.sensor
        pixels = (snapshot.totals.delivered - frames) * sensor.rows * sensor.cols
        self._occupancy = (snapshot.photons - photons) / pixels
        self._measured = counted

    def _codes_bytes_per_s(self, snapshot: Snapshot) -> float | None:
        if self._occupancy is None or not snapshot.rate_hz:
            return None
        sensor = self._acquisition.instrument.sensor
        return codes_bytes(sensor, self._occupancy) * self._settings().rate_hz

    def _codes_limit_hz(self, link: str) -> float | None:
        """Frames per second of which the link carries codes in any light; None if it does anyway.

        For captures, whose targets may be brighter than what is seen before them.
        """
        if link not in LINKS:
            return None
        full = codes_bytes(self._acquisition.instrument.sensor, 1.0)
        most_hz = CAPTURE_SHARE * LINKS[link] / full
        return most_hz if most_hz < self._settings().rate_hz else None

    def _obstacle(self, snapshot: Snapshot, calibration: Calibration | None, frames: int) -> str:
        """Why the camera can't send sums; empty if it can."""
        if snapshot.reduction_room is None:
            return NO_REDUCTION
        if calibration is None:
            return "tables of sums are designed from a calibration, and there is none yet"
        return self._refusal if self._refused == self._asked(snapshot, calibration, frames) else ""

    def _asked(
        self, snapshot: Snapshot, calibration: Calibration | None, frames: int
    ) -> tuple[object, ...]:
        """All that decides what the camera makes of its codes."""
        return calibration, frames, snapshot.reduction_room, self._settings().rate_hz

    def _send_codes(self) -> None:
        self._made = None
        with self._lock:
            controls = self._acquisition.controls
            changed = replace(controls, reduction=None, codes_rate_hz=self._limit_hz)
            if changed != controls:
                self._acquisition.set_controls(changed, self._settings())

    def _send_sums(self, snapshot: Snapshot, calibration: Calibration, frames: int) -> bool:
        """Have the camera send sums of this calibration; True if it does."""
        wanted = self._asked(snapshot, calibration, frames)
        with self._lock:
            controls = self._acquisition.controls
            if self._made == wanted and controls.reduction is not None:
                if controls.codes_rate_hz != self._limit_hz:
                    changed = replace(controls, codes_rate_hz=self._limit_hz)
                    self._acquisition.set_controls(changed, self._settings())
                return True
        try:
            reduction = reduction_of(
                calibration, picture_frames=frames, room=snapshot.reduction_room,
                rate_hz=self._settings().rate_hz,
            )  # fmt: skip
        except HueflightError as error:
            self._refused, self._refusal = wanted, str(error)
            return False
        with self._lock:
            if self._asked(snapshot, self._calibration(), self._settings().block_frames) != wanted:
                return False
            self._acquisition.set_controls(
                replace(
                    self._acquisition.controls, reduction=reduction, codes_rate_hz=self._limit_hz
                ),
                self._settings(),
            )
        self._made = wanted
        return True
