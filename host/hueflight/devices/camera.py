# SPDX-License-Identifier: Apache-2.0
"""The camera: settings go in, runs start and stop, packets come out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import product

import numpy as np
from numpy.typing import NDArray

from hueflight.devices import clock_choice
from hueflight.devices.board import Board, BoardIdentity
from hueflight.devices.camera_controls import CameraControls, CameraTiming
from hueflight.devices.camera_settings import CameraSettings
from hueflight.devices.errors import DeviceError, WrongDeviceError
from hueflight.devices.reduction import load_reduction, stop_reduction
from hueflight.devices.simulation import Simulation
from hueflight.devices.transports.interface import Transport
from hueflight.devices.transports.stream import Stream, StreamStatistics
from hueflight.model.instrument import Instrument
from hueflight_protocol import ReductionRoom, RegisterMap, camera_map
from hueflight_protocol.camera_map import BOARD
from hueflight_protocol.links import LINKS
from hueflight_protocol.typed_registers import camera as registers
from hueflight_protocol.wire import TEMPERATURE_UNKNOWN

MAX_BYTES_PER_S = LINKS["FT601"]  #: what USB 3 carries in practice
TRANSFER_S = 0.004  #: a transfer holds about this much of the stream
MIN_TRANSFER_BYTES, MAX_TRANSFER_BYTES = 1 << 14, 1 << 20

DEFAULT_CONTROLS = CameraControls()

OpenStream = Callable[[int], Stream]
"""Opens the packet stream with transfers of about so many bytes."""


@dataclass(frozen=True)
class CameraCounters:
    """What the camera has counted in this run, read from its registers.

    Attributes
    ----------
    frame : int
        Number of the present frame.
    frames_sent, frames_dropped, frames_aborted : int
        Frames that were sent whole, dropped whole, and broken off.
    triggers_lost : int
        Triggers that the illuminator missed.
    stall_clocks : int
        Clocks in which the link took no data.
    buffer_peak : int
        Most bytes that waited for the link.
    temperature_mdeg : int or None
        Temperature in millidegrees Celsius, None where it is not measured.
    """

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
    transport : Transport
        Carries control messages.
    open_stream : callable
        Opens the packet stream, given the bytes of a transfer.
    simulated : bool
        True if the photons are simulated.
    simulation : Simulation, optional
        Other side of a simulated camera.
    link : str, optional
        What the packet stream goes over, one of `hueflight_protocol.links.LINKS`; empty where that
        is not known, or sets no limit.

    Attributes
    ----------
    identity : BoardIdentity
        What the board says it is.
    rows, cols, code_bits, lanes, run : int
        Geometry, width of a code, codes per clock at the sensor port, and pixels per chunk.
    board : Board
        Its registers.
    link : str
        What the packet stream goes over.

    Raises
    ------
    WrongDeviceError
        If what answers is no camera, or was built from another register map.
    """

    def __init__(
        self,
        transport: Transport,
        open_stream: OpenStream,
        /,
        *,
        simulated: bool = False,
        simulation: Simulation | None = None,
        link: str = "",
    ) -> None:
        self.simulated, self.link = simulated, link
        self.simulation = simulation
        self._open_stream = open_stream
        self._stream: Stream | None = None
        self._closed_statistics = StreamStatistics()
        # the identity block is the same in every build; the map needs the geometry first
        probe = Board(transport, camera_map())
        self.identity: BoardIdentity = probe.identify(BOARD)
        geometry, form, number = probe.read_together(
            registers.Geometry, registers.Format, registers.GeometryId
        )
        self.rows, self.cols = geometry.rows, geometry.cols
        self.code_bits, self.lanes, self.run = form.code_bits, form.lanes, form.run
        self.board = Board(transport, self._map(probe, number.value))
        self.board.check_map()

    def _map(self, probe: Board, geometry: int) -> RegisterMap:
        """Register map of the build: with what a build can have besides, if the board says so."""
        build = partial(
            camera_map, rows=self.rows, cols=self.cols, code_bits=self.code_bits,
            lanes=self.lanes, run=self.run, geometry=geometry, clock_hz=self.identity.clock_hz,
        )  # fmt: skip
        told = probe.read(registers.Map).value
        builds = [
            build(reduction=reduction, external_clock=external_clock)
            for reduction, external_clock in product((None, ReductionRoom()), (False, True))
        ]
        return next((made for made in builds if made.fingerprint == told), builds[0])

    @property
    def can_reduce(self) -> bool:
        """Whether the camera can reduce codes to sums."""
        return registers.Reduction.ADDRESS in self.board.registers

    @property
    def reduction_room(self) -> ReductionRoom | None:
        """What the camera has room for to reduce codes to sums; None if it can't."""
        if not self.can_reduce:
            return None
        room = self.board.read(registers.ReductionRoom)
        narrow = self.board.read(registers.ReductionNarrow).value
        return ReductionRoom(room.sums, room.entry_bits, room.sum_bits, room.group, narrow)

    def require(self, instrument: Instrument) -> None:
        """Compare the sensor with an instrument's.

        Parameters
        ----------
        instrument : Instrument
            Instrument that should describe this camera.

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

    @property
    def timing(self) -> CameraTiming:
        """What the camera's build says about its frame rates."""
        return CameraTiming(
            clock_hz=self.identity.clock_hz,
            lanes=max(1, self.lanes),
            can_overlap=bool(self.board.read(registers.Features).overlap),
        )

    def configure(
        self, instrument: Instrument, controls: CameraControls = DEFAULT_CONTROLS, /
    ) -> CameraSettings:
        """Set period, exposure and frame rate as an instrument states them, before a run.

        Parameters
        ----------
        instrument : Instrument
            Instrument that describes this camera.
        controls : CameraControls, optional
            Frame rate, pixels and codes if they are not those of the instrument.

        Returns
        -------
        CameraSettings
            What was set.

        Raises
        ------
        WrongDeviceError
            If the instrument describes another sensor, or asks for what the camera can't do.
        DeviceError
            If sums are asked for and the camera has no room for them.
        """
        self.require(instrument)
        settings = self.timing.settings(controls.instrument(instrument))
        self.board.write(registers.Period(settings.period_clocks))
        self.board.write(registers.Exposure(settings.exposure_periods))
        self.board.write(registers.Gap(settings.gap_clocks))
        self.board.write(registers.Readout(settings.overlap))
        self.board.write(registers.StatusInterval(settings.status_interval))
        self._leave_out(instrument, controls)
        if controls.reduction is None:
            stop_reduction(self.board)
        else:
            load_reduction(self.board, controls.reduction, pixels=self.rows * self.cols)
        return settings

    def _leave_out(self, instrument: Instrument, controls: CameraControls) -> None:
        """Set mask, region and time gate."""
        if controls.masked:
            self.mask(controls.mask(instrument.sensor))
        write = self.board.write
        rows, cols = controls.rows or (0, self.rows - 1), controls.cols or (0, self.cols - 1)
        gate = controls.gate or (0, instrument.sensor.codes - 1)
        write(registers.RoiRows(first=rows[0], last=rows[1]))
        write(registers.RoiCols(first=cols[0], last=cols[1]))
        write(registers.Gate(first=gate[0], last=gate[1]))
        write(
            registers.Filters(
                mask=int(bool(controls.masked)),
                roi=int(bool(controls.rows or controls.cols)),
                gate=int(bool(controls.gate)),
            )
        )

    def mask(self, pixels: NDArray[np.bool_], /) -> None:
        """Choose the pixels of which the camera sends nothing, such as hot ones.

        Parameters
        ----------
        pixels : ndarray of bool, shape (row, col)
            True for pixels to leave out; with none of them the camera sends all.

        Raises
        ------
        DeviceError
            If the array does not have the sensor's shape.
        """
        if pixels.shape != (self.rows, self.cols):
            raise DeviceError(f"mask has shape {pixels.shape}: must be ({self.rows}, {self.cols})")
        bits = np.packbits(pixels.reshape(-1), bitorder="little")
        padded = np.zeros(-(-bits.size // 4) * 4, np.uint8)
        padded[: bits.size] = bits
        self.board.write_elements(registers.PixelMask, padded.view("<u4").tolist())
        self.board.write(registers.Filters(mask=int(pixels.any())))

    def listen(self, *, rate_hz: float = 1000.0) -> None:
        """Open the packet stream, if it is not open.

        Parameters
        ----------
        rate_hz : float
            Frames per second to expect; sets the size of transfers so that delays are short.
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
        capture : int
            Label in every packet of the run.
        frame_limit : int
            Number of frames after which the camera ends the run, 0 for no limit.
        """
        self.listen()
        self.board.write(registers.Capture(capture))
        self.board.write(registers.FrameLimit(frame_limit))
        self.board.write(registers.Run(start=1))

    def stop(self, *, abort: bool = False) -> None:
        """End the run; what it has sent is still to be read from the stream.

        Parameters
        ----------
        abort : bool
            True to break the present frame off instead of finishing it.
        """
        self.board.write(registers.Run(abort=1) if abort else registers.Run(stop=1))

    def read(self, timeout_s: float, /) -> bytes:
        """Return the next bytes of the stream.

        Parameters
        ----------
        timeout_s : float
            Longest time to wait, in seconds.

        Returns
        -------
        bytes
            Part of the stream, empty if nothing came in time.

        Raises
        ------
        DeviceError
            If the stream is not open, or the camera is gone.
        """
        if self._stream is None:
            raise DeviceError("the camera's stream is not open: start a run first")
        return self._stream.read(timeout_s)

    @property
    def statistics(self) -> StreamStatistics:
        """Totals of the stream since it was opened."""
        return self._stream.statistics if self._stream is not None else self._closed_statistics

    def counters(self) -> CameraCounters:
        """Read the counters of the present or last run.

        Returns
        -------
        CameraCounters
            The counters, and the temperature.
        """
        read = self.board.read
        temperature = read(registers.Temperature).value
        return CameraCounters(
            frame=read(registers.Frame).value,
            frames_sent=read(registers.FramesSent).value,
            frames_dropped=read(registers.FramesDropped).value,
            frames_aborted=read(registers.FramesAborted).value,
            triggers_lost=read(registers.TriggersLost).value,
            stall_clocks=read(registers.StallClocks).value,
            buffer_peak=read(registers.BufferPeak).value,
            temperature_mdeg=None if temperature == TEMPERATURE_UNKNOWN else temperature,
        )

    def run_label(self) -> int:
        """Read the label of the present or last run.

        Returns
        -------
        int
            The label given to `start`, or 0 after a reset.
        """
        return self.board.read(registers.Capture).value

    def running(self) -> bool:
        """Read whether a run is on.

        Returns
        -------
        bool
            True if the camera is in a run.
        """
        return bool(self.board.read(registers.State).running)

    def clock(self) -> clock_choice.ClockState:
        """Read which clock the camera runs from.

        Returns
        -------
        ClockState
            The clock in use, and whether there is an external one.
        """
        return clock_choice.read_clock(self.board)

    def choose_clock(
        self, source: clock_choice.ClockName, /, *, timeout_s: float = 0.5
    ) -> clock_choice.ClockState:
        """Run from the board's oscillator or from an external clock, between two runs.

        A change stops the camera for some milliseconds, and ends a common time. Afterwards the
        fault ``clock_failed``, which such a change sets, is cleared.

        Parameters
        ----------
        source : {"internal", "external"}
            The clock.
        timeout_s : float
            Longest time for the change, in seconds.

        Returns
        -------
        ClockState
            State after the change.

        Raises
        ------
        DeviceError
            If a run is on, the board has no external clock, none of the right frequency is there,
            or it fails during the change.
        """
        if self.running():
            raise DeviceError(
                f"the camera at {self.identity.place} is in a run, which a change of the clock "
                "would end: stop it first"
            )
        fault = registers.Faults(clock_failed=1)
        return clock_choice.choose_clock(self.board, source, fault, timeout_s=timeout_s)

    def close(self) -> None:
        """Release stream and control; the run goes on if nobody stopped it."""
        if self._stream is not None:
            self._closed_statistics = self._stream.statistics
            self._stream.close()
            self._stream = None
        self.board.close()
