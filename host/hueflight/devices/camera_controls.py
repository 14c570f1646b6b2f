# SPDX-License-Identifier: Apache-2.0
"""What may be changed between runs: schedule, frame rate, pixels and codes that are sent."""

from __future__ import annotations

from dataclasses import dataclass, replace

import msgspec
import numpy as np
from numpy.typing import NDArray

from hueflight.devices.camera_settings import CameraSettings
from hueflight.devices.errors import DeviceError
from hueflight.devices.pulse_schedule import Capacity, PulseSchedule, to_ticks
from hueflight.devices.reduction import Reduction
from hueflight.model.instrument import Instrument, Sensor
from hueflight.model.schedules import Schedule

Span = tuple[int, int]
MIN_RATE_HZ = 0.1


@dataclass(frozen=True)
class CameraTiming:
    """What a camera's build says about its frame rates.

    Attributes
    ----------
    clock_hz : int
        Frequency of the camera's clock, in hertz.
    lanes : int
        Number of pixels that the camera reads in one clock.
    can_overlap : bool
        True if the camera can read out one frame while it exposes the next.
    """

    clock_hz: int
    lanes: int
    can_overlap: bool

    def settings(self, instrument: Instrument, /) -> CameraSettings:
        """Return the settings that give an instrument's period, exposure and frame rate.

        Parameters
        ----------
        instrument : Instrument
            The instrument.

        Returns
        -------
        CameraSettings
            The settings.

        Raises
        ------
        WrongDeviceError
            If the camera can't do what the instrument states.
        """
        return CameraSettings.of(
            instrument, clock_hz=self.clock_hz, lanes=self.lanes, can_overlap=self.can_overlap
        )

    def max_rate_hz(self, instrument: Instrument, /) -> float:
        """Return the highest frame rate at the exposure time of an instrument.

        Parameters
        ----------
        instrument : Instrument
            The instrument.

        Returns
        -------
        float
            Frames per second.
        """
        sensor = instrument.sensor
        found = self.settings(_with_rate(instrument, None))
        exposed = found.exposure_periods * found.period_clocks
        readout = -(-sensor.rows * sensor.cols // self.lanes)
        taken = max(exposed, readout) if self.can_overlap else exposed + readout
        return self.clock_hz / taken


@dataclass(frozen=True)
class CameraControls:
    """What of a camera and its LEDs may be changed between runs.

    What is left out is not sent: its pixels have no photons. A calibration remains valid, because
    exposures stay the same, unless the schedule is changed: then it belongs to another instrument.

    Attributes
    ----------
    rate_hz : float or None
        Frames per second; None for those of the instrument.
    rows, cols : tuple of int or None
        First and last row and column of the region that is sent; None for all.
    gate : tuple of int or None
        First and last code that is sent; None for all.
    masked : tuple of (row, col)
        Pixels that are not sent, such as hot ones.
    schedule : Schedule or None
        When each LED fires; None for the delays and the period of the instrument.
    reduction : Reduction or None
        Tables with which the camera reduces its codes to sums; None to have it send codes.
    codes_rate_hz : float or None
        Frames per second at most in runs that need histograms, where the link does not carry the
        codes of all frames. None for no limit.
    """

    rate_hz: float | None = None
    rows: Span | None = None
    cols: Span | None = None
    gate: Span | None = None
    masked: tuple[tuple[int, int], ...] = ()
    schedule: Schedule | None = None
    reduction: Reduction | None = None
    codes_rate_hz: float | None = None

    @property
    def leaves_out(self) -> bool:
        """True if pixels or codes are not sent."""
        return bool(self.rows or self.cols or self.gate or self.masked)

    @property
    def sends_sums_only(self) -> bool:
        """True if the camera sends sums and no codes."""
        return self.reduction is not None and not self.reduction.with_codes

    def with_histograms(self, instrument: Instrument, /) -> CameraControls:
        """Return these controls for a run that needs histograms.

        Parameters
        ----------
        instrument : Instrument
            The instrument, which states the frame rate.

        Returns
        -------
        CameraControls
            With codes instead of sums, at no more frames per second than `codes_rate_hz`; the same
            if nothing is to be changed.
        """
        rate_hz, most = self.rate_hz, self.codes_rate_hz
        present = instrument.sensor.usual_frame_rate_hz if rate_hz is None else rate_hz
        if most is not None and most < present:
            rate_hz = most
        reduction = None if self.sends_sums_only else self.reduction
        return replace(self, reduction=reduction, rate_hz=rate_hz)

    def check(self, instrument: Instrument, timing: CameraTiming | None, /) -> None:
        """Refuse what an instrument's camera can't do.

        Parameters
        ----------
        instrument : Instrument
            The instrument.
        timing : CameraTiming or None
            Limits of the camera's rate; None while there is no camera.

        Raises
        ------
        DeviceError
            If a number is out of its range, or the rate can't be had.
        """
        sensor = instrument.sensor
        for name, span, size in (
            ("rows", self.rows, sensor.rows),
            ("cols", self.cols, sensor.cols),
            ("gate", self.gate, sensor.codes),
        ):
            if span is not None and not 0 <= span[0] <= span[1] < size:
                raise DeviceError(
                    f"{name} = {list(span)}: must be the first and the last one, from 0 to "
                    f"{size - 1}"
                )
        for row, col in self.masked:
            if not (0 <= row < sensor.rows and 0 <= col < sensor.cols):
                raise DeviceError(
                    f"masked: pixel {row}, {col} lies outside the sensor of {sensor.rows} × "
                    f"{sensor.cols} pixels"
                )
        if self.schedule is not None and timing is not None:
            timing.settings(self.scheduled(instrument))
        if self.rate_hz is None:
            return
        if not self.rate_hz >= MIN_RATE_HZ:
            raise DeviceError(f"rate_hz = {self.rate_hz}: must be at least {MIN_RATE_HZ}")
        if timing is not None:
            most = timing.max_rate_hz(self.scheduled(instrument))
            if self.rate_hz > most:
                raise DeviceError(
                    f"rate_hz = {self.rate_hz:g}: this camera takes at most {most:.6g} frames per "
                    f"second at exposures of {sensor.exposure_ms or 1.0:g} ms"
                )

    def in_ticks(self, instrument: Instrument, capacity: Capacity | None, /) -> CameraControls:
        """Return these controls with the schedule as the illuminator plays it.

        Parameters
        ----------
        instrument : Instrument
            The instrument without them.
        capacity : Capacity or None
            Limits of the illuminator; None if there is none whose schedule could be changed.

        Returns
        -------
        CameraControls
            The same, with delays and period in whole ticks.

        Raises
        ------
        DeviceError
            If the schedule can't be changed.
        HueflightError
            If the schedule does not suit the instrument or the limits.
        """
        if self.schedule is None:
            return self
        scheduled = self.scheduled(instrument)
        if capacity is None:
            raise DeviceError(
                "schedule: no illuminator is connected whose schedule could be changed"
            )
        played = to_ticks(PulseSchedule.of(scheduled), capacity).in_ns
        return replace(self, schedule=None if played == Schedule.of(instrument) else played)

    def scheduled(self, instrument: Instrument, /) -> Instrument:
        """Return an instrument with the schedule of these controls.

        Parameters
        ----------
        instrument : Instrument
            The instrument without them.

        Returns
        -------
        Instrument
            The same, or a changed copy.

        Raises
        ------
        InstrumentError
            If the schedule does not suit the instrument.
        """
        return instrument if self.schedule is None else self.schedule.applied_to(instrument)

    def instrument(self, instrument: Instrument, /) -> Instrument:
        """Return an instrument with the schedule and the frame rate of these controls.

        Parameters
        ----------
        instrument : Instrument
            The instrument without them.

        Returns
        -------
        Instrument
            The same, or a changed copy.
        """
        made = self.scheduled(instrument)
        return made if self.rate_hz is None else _with_rate(made, self.rate_hz)

    def mask(self, sensor: Sensor, /) -> NDArray[np.bool_]:
        """Return the pixels that are masked, as an array.

        Parameters
        ----------
        sensor : Sensor
            States the shape.

        Returns
        -------
        ndarray of bool, shape (row, col)
            True for pixels that are left out.
        """
        found = np.zeros((sensor.rows, sensor.cols), bool)
        for row, col in self.masked:
            found[row, col] = True
        return found


def _with_rate(instrument: Instrument, rate_hz: float | None) -> Instrument:
    sensor = msgspec.structs.replace(instrument.sensor, frame_rate_hz=rate_hz)
    return msgspec.structs.replace(instrument, sensor=sensor)
