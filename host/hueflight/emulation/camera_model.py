# SPDX-License-Identifier: Apache-2.0
"""A model of the camera as seen from its endpoints, on which every emulation is built.

Requests are answered by the same register file that the gateware is verified against. Frames become
due as time passes; frames that the link does not fetch in time are dropped whole, and counted.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace

from hueflight.emulation.frame_bank import FrameSource
from hueflight.emulation.frame_filter import FrameFilter
from hueflight.model.instrument import Sensor
from hueflight_protocol import (
    Event,
    EventCode,
    PacketHeader,
    Register,
    RegisterFile,
    RegisterValue,
    Status,
    camera_map,
    encode_event,
    encode_status,
    encode_test_pattern,
)
from hueflight_protocol.typed_registers import camera as registers
from hueflight_protocol.wire import PatternKind

CLOCK_HZ = 100_000_000
LANES = 64  #: a readout takes little time, so that every preset's frame rate is nearly reached
BUFFER_BYTES = 8 << 20  #: a software clock is late by milliseconds, so it needs more than a board


@dataclass(frozen=True)
class Sent:
    """What the model did, for comparison with what a host has counted.

    Attributes
    ----------
    frames : int
        Number of frames of all runs, including those dropped.
    dropped : int
        Number of frames dropped because the buffer was full.
    packets : int
        Number of packets handed to the link, or waiting for it.
    """

    frames: int = 0
    dropped: int = 0
    packets: int = 0


class CameraModel:
    """A camera in software.

    Parameters
    ----------
    sensor : Sensor
        Geometry and code width.
    bank : FrameSource
        What the sensor sees.
    serial : int
        Serial number of the board.
    buffer_bytes : int
        Most bytes of packets that wait for the link.
    now_s : callable
        Clock in seconds; tests pass their own.

    Attributes
    ----------
    registers : RegisterFile
        Registers of the board.
    sent : Sent
        What the model did.
    """

    def __init__(
        self,
        sensor: Sensor,
        bank: FrameSource,
        /,
        *,
        serial: int = 1,
        buffer_bytes: int = BUFFER_BYTES,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self.bank = bank
        self.registers = RegisterFile(
            camera_map(
                rows=sensor.rows, cols=sensor.cols, code_bits=sensor.code_bits, lanes=LANES,
                clock_hz=CLOCK_HZ,
            ),
            on_write=self._written,
        )  # fmt: skip
        self.registers.store(registers.Serial(serial))
        self.registers.store(registers.Versions(major=1))
        self.registers.store(registers.Features(overlap=1))
        self._readout_clocks = -(-sensor.rows * sensor.cols // LANES)
        self._buffer_bytes = buffer_bytes
        self._now_s = now_s
        self._lock = threading.RLock()
        self._answers: deque[bytes] = deque()
        self._waiting: deque[bytes] = deque()
        self._waiting_bytes = 0
        self._powered_s = now_s()
        self._started_s = 0.0
        self._frame = self._dropped = self._sent_whole = self._peak = self._sequence = 0
        self._running = False
        self._filter: FrameFilter | None = None
        self._last_size = 0
        self.sent = Sent()

    # -- control ------------------------------------------------------------------------------

    def handle(self, message: bytes, /) -> bytes | None:
        """Answer a control message as the board does.

        Parameters
        ----------
        message : bytes
            The message.

        Returns
        -------
        bytes or None
            The answer, None if there is none.
        """
        with self._lock:
            self.advance()
            self._publish()
            return self.registers.handle(message)

    def _publish(self) -> None:
        """Copy the counters to the registers."""
        clock = int((self._now_s() - self._powered_s) * CLOCK_HZ)
        for value in (
            registers.Uptime(clock),
            registers.Timestamp(clock),
            registers.Frame(max(0, self._frame - 1)),
            registers.FramesSent(self._sent_whole),
            registers.FramesDropped(min(self._dropped, registers.FramesDropped.VALUE_MAX)),
            registers.BufferPeak(min(self._peak, registers.BufferPeak.VALUE_MAX)),
            registers.Sequence(self._sequence),
            registers.State(running=int(self._running)),
        ):
            self.registers.store(value)
        if self._dropped:
            faults = self.registers.load(registers.Faults)
            self.registers.store(replace(faults, dropped=1))

    def _written(self, register: Register, _: tuple[int, ...], word: int) -> None:
        if register.name == registers.Run.NAME:
            asked = registers.Run.decode(register, word)
            if asked.start:
                self._start()
            if asked.stop or asked.abort:
                self._stop()
        elif register.name == registers.TestSend.NAME:
            self._send_test()

    def _start(self) -> None:
        if self._running:
            self._stop()
        self._running = True
        self._filter = FrameFilter.of(self.registers)
        self._started_s = self._now_s()
        self._frame = self._dropped = self._sent_whole = self._peak = 0
        self._event(EventCode.RUN_STARTED, self._capture)

    def _stop(self) -> None:
        if self._running:
            self._running = False
            self._event(EventCode.RUN_STOPPED, self._frame)

    def _send_test(self) -> None:
        asked = self.registers.load(registers.TestPacket)
        self._put(
            encode_test_pattern(
                self._header(),
                pattern=PatternKind(asked.pattern),
                seed=self._value(registers.TestSeed),
                words=asked.words,
            )
        )

    def _value(self, register: type[RegisterValue]) -> int:
        """Return a register as one number; cheap, because every frame needs some."""
        return self.registers.get(register.NAME)

    # -- stream -------------------------------------------------------------------------------

    @property
    def frame_s(self) -> float:
        """Time from one frame to the next in seconds, as the registers set it."""
        value = self._value
        exposed = value(registers.Period) * value(registers.Exposure) + value(registers.Gap)
        if value(registers.Readout):
            return max(exposed, self._readout_clocks) / CLOCK_HZ
        return (exposed + self._readout_clocks) / CLOCK_HZ

    def advance(self) -> None:
        """Put every frame that is due by now into the buffer, or drop it."""
        with self._lock:
            if not self._running:
                return
            frame_s = self.frame_s
            due = int((self._now_s() - self._started_s) / frame_s)
            limit = self._value(registers.FrameLimit)
            if limit:
                due = min(due, limit)
            while self._frame < due:
                self._expose(frame_s)
            if limit and self._frame >= limit:
                self._stop()

    def _expose(self, frame_s: float) -> None:
        template = None
        if self._waiting_bytes + self._last_size <= self._buffer_bytes:
            template = self.bank.template(self._frame)
            if self._filter is not None:
                template = self._filter.apply(template)
            self._last_size = len(template)
        # what does not fit need not be drawn, which a camera that was away for long would have to
        if template is None or self._waiting_bytes + len(template) > self._buffer_bytes:
            self._dropped += 1
            self.sent = Sent(self.sent.frames + 1, self.sent.dropped + 1, self.sent.packets)
        else:
            packet = template.stamp(
                sequence=self._sequence,
                timestamp=int(self._frame * frame_s * CLOCK_HZ),
                frame=self._frame,
                dropped=min(self._dropped, registers.FramesDropped.VALUE_MAX),
                capture=self._capture,
                clock_hz=CLOCK_HZ,
            )
            self._sent_whole += 1
            self.sent = Sent(self.sent.frames + 1, self.sent.dropped, self.sent.packets)
            self._put(packet)
        self._frame += 1
        interval = self._value(registers.StatusInterval)
        if interval and self._frame % interval == 0:
            self._put(encode_status(self._status()))

    def pull(self, limit: int, /) -> bytes:
        """Return the bytes of one transfer.

        Parameters
        ----------
        limit : int
            Most bytes of the transfer.

        Returns
        -------
        bytes
            What waits for the link, empty if nothing does.
        """
        with self._lock:
            self.advance()
            parts: list[bytes] = []
            room = limit
            while self._waiting and room:
                packet = self._waiting.popleft()
                if len(packet) > room:
                    self._waiting.appendleft(packet[room:])
                    packet = packet[:room]
                parts.append(packet)
                room -= len(packet)
            self._waiting_bytes -= limit - room
            return b"".join(parts)

    @property
    def waiting_bytes(self) -> int:
        """Number of bytes that the link has not fetched yet."""
        return self._waiting_bytes

    def reset(self) -> None:
        """Lose power and get it back: registers, counters and buffer as after configuration."""
        with self._lock:
            self._running = False
            self._waiting.clear()
            self._waiting_bytes = 0
            self._frame = self._dropped = self._sent_whole = self._peak = self._sequence = 0
            self._powered_s = self._now_s()
            for register in self.registers.registers:
                if register.access.writable and not register.count:
                    self.registers.set(register.name, **register.decode(register.reset))

    @property
    def _capture(self) -> int:
        return self._value(registers.Capture)

    def _header(self) -> PacketHeader:
        return PacketHeader(
            sequence=self._sequence,
            timestamp=int((self._now_s() - self._powered_s) * CLOCK_HZ),
            capture=self._capture,
        )

    def _event(self, code: EventCode, value: int) -> None:
        self._put(encode_event(Event(self._header(), code, value=value)))

    def _status(self) -> Status:
        return Status(
            self._header(),
            frames_sent=self._sent_whole,
            frames_dropped=min(self._dropped, registers.FramesDropped.VALUE_MAX),
            buffer_peak=min(self._peak, registers.BufferPeak.VALUE_MAX),
        )

    def _put(self, packet: bytes) -> None:
        self._sequence = self._sequence + 1 & registers.Sequence.VALUE_MAX
        self._waiting.append(packet)
        self._waiting_bytes += len(packet)
        self._peak = max(self._peak, self._waiting_bytes)
        self.sent = Sent(self.sent.frames, self.sent.dropped, self.sent.packets + 1)
