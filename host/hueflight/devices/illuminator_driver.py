# SPDX-License-Identifier: Apache-2.0
"""The illuminator board as the illumination of captures."""

from __future__ import annotations

from hueflight.devices.errors import DeviceError
from hueflight.devices.illumination import CaptureKind
from hueflight.devices.illuminator import Illuminator
from hueflight.devices.pulse_schedule import Capacity, PulseSchedule, ScheduleError, TickSchedule
from hueflight.devices.sequencer_program import each_alone
from hueflight.model.instrument import Instrument
from hueflight_protocol.illuminator_map import Advance, TriggerSource

WATCHDOG_MS = 2000
"""`keep_alive` comes at least twice a second."""


class IlluminatorDriver:
    """Drives the LEDs through an illuminator that the camera triggers.

    Parameters
    ----------
    illuminator : Illuminator
        The board, opened; it is closed with this driver.
    instrument : Instrument
        Instrument whose bands are the channels, in order.

    Attributes
    ----------
    name : str
        Port of the board.
    schedule : TickSchedule
        What the board plays.
    """

    def __init__(self, illuminator: Illuminator, instrument: Instrument, /) -> None:
        self.name = illuminator.identity.place
        self._illuminator = illuminator
        self._bands = len(instrument.bands)
        illuminator.disarm()
        illuminator.stop()
        illuminator.set_trigger(TriggerSource.EXTERNAL)
        self._wanted = PulseSchedule.of(instrument)
        self.schedule: TickSchedule = illuminator.load(self._wanted, bank=0)
        illuminator.select(0)

    @property
    def capacity(self) -> Capacity:
        """Limits of the schedules that the board plays."""
        return self._illuminator.capacity

    def load_schedule(self, instrument: Instrument, /) -> None:
        """Play the schedule that an instrument states from the next `prepare` on.

        Parameters
        ----------
        instrument : Instrument
            States the delays of the bands and the period.

        Raises
        ------
        DeviceError
            If the board can't play it, or does not answer.
        """
        wanted = PulseSchedule.of(instrument)
        if wanted == self._wanted:
            return
        board = self._illuminator
        board.disarm()  # the bank that plays is locked while the board is armed
        board.stop()
        try:
            self.schedule = board.load(wanted, bank=0)
        except ScheduleError as error:
            raise DeviceError(f"{self.name} can't play the schedule: {error}") from error
        self._wanted = wanted

    def prepare(self, kind: CaptureKind, frames: int, /) -> None:
        """Set the LEDs up for a capture, before the camera's run begins.

        Parameters
        ----------
        kind : CaptureKind
            What the capture is for; for ``"bands"`` the LEDs fire one at a time.
        frames : int
            Number of frames for each LED of a capture of kind ``"bands"``.

        Raises
        ------
        DeviceError
            If the board does not answer, or there is no frame for an LED.
        """
        board = self._illuminator
        board.stop()
        if kind in ("dark", "flat"):
            board.disarm()
            return
        if kind == "bands":
            if frames < 1:
                raise DeviceError(f"frames = {frames}: each LED needs at least one")
            # the last LED goes on until the camera has stopped
            board.run(each_alone(self._bands, frames, stay=True), advance=Advance.FRAME_SYNC)
        board.arm(watchdog_ms=WATCHDOG_MS)

    def keep_alive(self) -> None:
        """Feed the board's watchdog."""
        self._illuminator.feed()

    def close(self) -> None:
        """Turn the LEDs off and release the board."""
        self._illuminator.close()
