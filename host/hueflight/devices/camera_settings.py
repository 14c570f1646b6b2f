# SPDX-License-Identifier: Apache-2.0
"""Clocks and periods of an exposure, chosen so that a camera does what an instrument states."""

from __future__ import annotations

from dataclasses import dataclass

from hueflight.devices.errors import WrongDeviceError
from hueflight.model.instrument import Instrument

LEAST_RATE = 0.9  #: of the frame rate asked for; less is refused


@dataclass(frozen=True)
class CameraSettings:
    """Clocks and periods of an exposure.

    Attributes
    ----------
    period_clocks : int
        Period of the LED pulses, in clocks of the camera.
    exposure_periods : int
        Number of periods in an exposure.
    gap_clocks : int
        Pause between a readout and the next exposure or, where they overlap, between exposures.
    status_interval : int
        Number of frames from one status packet to the next, 0 for no status packets.
    rate_hz : float
        Frames per second that result; slightly less than asked for where readouts leave no more
        time.
    overlap : bool
        True if a frame is read out while the next one is exposed.
    """

    period_clocks: int
    exposure_periods: int
    gap_clocks: int
    status_interval: int
    rate_hz: float
    overlap: bool = False

    @classmethod
    def of(
        cls, instrument: Instrument, *, clock_hz: int, lanes: int, can_overlap: bool = False
    ) -> CameraSettings:
        """Choose settings that give an instrument's period, exposure and frame rate.

        Readouts overlap exposures only where the sensor allows it and the rate needs it.

        Parameters
        ----------
        instrument : Instrument
            Instrument that states period, exposure and frame rate.
        clock_hz : int
            Frequency of the camera's clock, in hertz.
        lanes : int
            Number of pixels that the camera reads in one clock.
        can_overlap : bool
            True if the camera can read out one frame while it exposes the next.

        Returns
        -------
        CameraSettings
            The settings, with the frame rate that they give.

        Raises
        ------
        WrongDeviceError
            If the camera's clock can't give the period or the frame rate.
        """
        sensor, timing = instrument.sensor, instrument.timing
        period_ns = timing.period_ns
        if period_ns is None:
            raise WrongDeviceError(
                f"instrument {instrument.name!r} has no timing.period_ns, which the camera's "
                "trigger needs: state the period of the LED pulses"
            )
        period_clocks = round(period_ns * clock_hz * 1e-9)
        made_ns = period_clocks * 1e9 / clock_hz
        if period_clocks < 1 or abs(made_ns - period_ns) > 0.001:
            raise WrongDeviceError(
                f"timing.period_ns = {period_ns}: the camera's clock of {clock_hz} Hz makes "
                f"periods of whole clocks, the nearest is {made_ns} ns"
            )
        exposure_ns = (sensor.exposure_ms or 1.0) * 1e6
        periods = max(1, round(exposure_ns / period_ns))
        readout = -(-sensor.rows * sensor.cols // lanes)
        exposed = periods * period_clocks
        wanted = round(clock_hz / sensor.frame_rate_hz) if sensor.frame_rate_hz else 0
        overlap = can_overlap and 0 < wanted < exposed + readout
        taken = exposed if overlap else exposed + readout
        gap = max(0, wanted - taken)
        rate = clock_hz / max(taken + gap, readout)
        if sensor.frame_rate_hz is not None and rate < LEAST_RATE * sensor.frame_rate_hz:
            left_ms = 1e3 * (1 / sensor.frame_rate_hz - (not overlap) * readout / clock_hz)
            when = "during" if overlap else "after"
            raise WrongDeviceError(
                f"sensor.frame_rate_hz = {sensor.frame_rate_hz}: this camera reads out for "
                f"{1e3 * readout / clock_hz:.4g} ms {when} each exposure, so that exposures of "
                f"{exposure_ns / 1e6:.4g} ms give {rate:.0f} frames per second; lower the rate, or "
                f"sensor.exposure_ms to {max(left_ms, 0):.4g}"
            )
        return cls(period_clocks, periods, gap, max(1, round(rate)), rate, overlap)
