"""The camera: settings in, runs started and stopped, packets out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hueflight.devices.board import Board, BoardIdentity
from hueflight.devices.errors import DeviceError, WrongDeviceError
from hueflight.devices.transports.interface import Transport
from hueflight.devices.transports.stream import Stream, StreamStatistics
from hueflight.model.instrument import Instrument
from hueflight_protocol import camera_map
from hueflight_protocol.camera_map import BOARD

LEAST_RATE = 0.9  #: of the frame rate asked for; less is refused
MAX_BYTES_PER_S = 400e6  #: what USB 3 carries in practice
TRANSFER_S = 0.004  #: a transfer holds about this much of the stream
MIN_TRANSFER_BYTES, MAX_TRANSFER_BYTES = 1 << 14, 1 << 20
_GEOMETRY_ADDRESS, _GEOMETRY_WORDS = 0x010, 3

OpenStream = Callable[[int], Stream]
"""Opens the packet stream with transfers of about so many bytes."""


@dataclass(frozen=True)
class CameraSettings:
    """Clocks and periods of an exposure.

    Attributes
    ----------
    period_clocks : one LED train.
    exposure_periods : trains in an exposure.
    gap_clocks : pause between readout and next exposure; if they overlap, between exposures.
    status_interval : frames from one status packet to the next, 0 for none.
    rate_hz : frames per second that come of it; a little less than asked for, where readouts
        leave no more time.
    overlap : an exposure is on while the one before is read out.
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
        """Settings that give an instrument's period, exposure and frame rate.

        Readouts overlap exposures where the sensor allows it and the rate can't be had otherwise.

        Raises
        ------
        WrongDeviceError
            If the camera's clock can't make the period or the frame rate.
        """
        sensor, timing = instrument.sensor, instrument.timing
        period_ns = timing.period_ns
        if period_ns is None:
            raise WrongDeviceError(
                f"instrument {instrument.name!r} has no timing.period_ns, which the camera's "
                "trigger needs: state the length of one LED train"
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


@dataclass(frozen=True)
class CameraCounters:
    """What the camera has counted in this run, read from its registers."""

    frame: int
    frames_sent: int
    frames_dropped: int
    frames_aborted: int
    triggers_lost: int
    stall_clocks: int
    buffer_peak: int
    temperature_mdeg: int | None


class Camera:
    """A camera over any transport and stream, real or simulated.

    Parameters
    ----------
    transport : for control messages.
    open_stream : opens the packet stream.
    simulated : whether no photon was harmed.

    Raises
    ------
    WrongDeviceError
        If what answers is no camera, or was built from another register map.
    """

    def __init__(
        self, transport: Transport, open_stream: OpenStream, /, *, simulated: bool = False
    ) -> None:
        self.simulated = simulated
        self._open_stream = open_stream
        self._stream: Stream | None = None
        self._closed_statistics = StreamStatistics()
        # the identity block is the same in every build; the map needs the geometry first
        probe = Board(transport, camera_map())
        self.identity: BoardIdentity = probe.identify(BOARD)
        size, form, identity = probe.read_words(_GEOMETRY_ADDRESS, _GEOMETRY_WORDS)
        self.rows, self.cols = size & 0xFFFF, size >> 16
        self.code_bits, self.lanes, self.run = form & 0xFF, form >> 8 & 0xFF, form >> 16
        self.board = Board(
            transport,
            camera_map(
                rows=self.rows,
                cols=self.cols,
                code_bits=self.code_bits,
                lanes=self.lanes,
                run=self.run,
                geometry=identity,
                clock_hz=self.identity.clock_hz,
            ),
        )
        self.board.check_map()

    def require(self, instrument: Instrument) -> None:
        """Compare the sensor with an instrument's.

        Raises
        ------
        WrongDeviceError
            If the instrument describes another sensor.
        """
        sensor = instrument.sensor
        mine = (self.rows, self.cols, self.code_bits)
        if mine != (sensor.rows, sensor.cols, sensor.code_bits):
            raise WrongDeviceError(
                f"the camera at {self.identity.place} has {self.rows} × {self.cols} pixels of "
                f"{self.code_bits} bits, instrument {instrument.name!r} {sensor.rows} × "
                f"{sensor.cols} of {sensor.code_bits}: choose the instrument that describes it"
            )

    def configure(self, instrument: Instrument) -> CameraSettings:
        """Set period, exposure and frame rate as an instrument states them; no run may be on."""
        self.require(instrument)
        settings = CameraSettings.of(
            instrument,
            clock_hz=self.identity.clock_hz,
            lanes=max(1, self.lanes),
            can_overlap=bool(self.board.fields("features")["overlap"]),
        )
        self.board.write("period", value=settings.period_clocks)
        self.board.write("exposure", value=settings.exposure_periods)
        self.board.write("gap", value=settings.gap_clocks)
        self.board.write("readout", overlap=settings.overlap)
        self.board.write("status_interval", value=settings.status_interval)
        return settings

    def mask(self, pixels: NDArray[np.bool_], /) -> None:
        """Have the camera send nothing of these pixels (row, col), the hot ones; none: all."""
        if pixels.shape != (self.rows, self.cols):
            raise DeviceError(f"mask has shape {pixels.shape}: must be ({self.rows}, {self.cols})")
        bits = np.packbits(pixels.reshape(-1), bitorder="little")
        padded = np.zeros(-(-bits.size // 4) * 4, np.uint8)
        padded[: bits.size] = bits
        self.board.write_elements("pixel_mask", padded.view("<u4").tolist())
        self.board.write("filters", mask=int(pixels.any()))

    def listen(self, *, rate_hz: float = 1000.0) -> None:
        """Open the packet stream, if it is not open.

        Parameters
        ----------
        rate_hz : frames per second to expect; sets the size of transfers, for short delays.
        """
        if self._stream is not None:
            return
        frame_bytes = self.rows * self.cols * self.code_bits / 8 / 2
        wanted = int(min(frame_bytes * rate_hz, MAX_BYTES_PER_S) * TRANSFER_S)
        size = min(max(1 << wanted.bit_length(), MIN_TRANSFER_BYTES), MAX_TRANSFER_BYTES)
        self._stream = self._open_stream(size)

    def start(self, *, capture: int = 0, frame_limit: int = 0) -> None:
        """Begin a run; frame numbers and counters start at 0.

        Parameters
        ----------
        capture : label in every packet of the run.
        frame_limit : frames after which the run ends by itself, 0 for none.
        """
        self.listen()
        self.board.write("capture", value=capture)
        self.board.write("frame_limit", value=frame_limit)
        self.board.write("run", start=1)

    def stop(self, *, abort: bool = False) -> None:
        """End the run after the present frame; keep reading until the stream is empty."""
        self.board.write("run", **({"abort": 1} if abort else {"stop": 1}))

    def read(self, timeout_s: float, /) -> bytes:
        """Next bytes of the stream, ``b""`` if none came in time."""
        if self._stream is None:
            raise DeviceError("the camera's stream is not open: start a run first")
        return self._stream.read(timeout_s)

    @property
    def statistics(self) -> StreamStatistics:
        """Of the stream, since it was opened."""
        return self._stream.statistics if self._stream is not None else self._closed_statistics

    def counters(self) -> CameraCounters:
        """Counters of the present or last run."""
        board = self.board
        found = board.fields("temperature")["value"]
        return CameraCounters(
            frame=board.read("frame"),
            frames_sent=board.read("frames_sent"),
            frames_dropped=board.read("frames_dropped"),
            frames_aborted=board.read("frames_aborted"),
            triggers_lost=board.read("triggers_lost"),
            stall_clocks=board.read("stall_clocks"),
            buffer_peak=board.read("buffer_peak"),
            temperature_mdeg=None if found == -(1 << 31) else found,
        )

    def running(self) -> bool:
        """Whether a run is on."""
        return bool(self.board.fields("state")["running"])

    def close(self) -> None:
        """Give stream and control back; the run goes on if nobody stopped it."""
        if self._stream is not None:
            self._closed_statistics = self._stream.statistics
            self._stream.close()
            self._stream = None
        self.board.close()
