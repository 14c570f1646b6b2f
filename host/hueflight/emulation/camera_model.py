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

import numpy as np

from hueflight.emulation.frame_bank import FrameSource
from hueflight.emulation.frame_filter import FrameFilter
from hueflight.emulation.frame_template import Template, empty_headers, stamp_all
from hueflight.emulation.picture_reduction import PictureReduction, ReductionMemory
from hueflight.model.instrument import Sensor
from hueflight_protocol import (
    Event,
    EventCode,
    PacketHeader,
    ReductionRoom,
    Register,
    RegisterFile,
    RegisterValue,
    Status,
    camera_map,
    encode_event,
    encode_packet,
    encode_status,
    encode_test_pattern,
)
from hueflight_protocol.typed_registers import camera as registers
from hueflight_protocol.wire import PacketType, PatternKind

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
    kept_pictures : int
        Whole pictures of sums that are made in each run and then sent in turn; 0 to add up each.
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
        kept_pictures: int = 0,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self.bank, self._kept_pictures = bank, kept_pictures
        self.registers = RegisterFile(
            camera_map(
                rows=sensor.rows, cols=sensor.cols, code_bits=sensor.code_bits, lanes=LANES,
                clock_hz=CLOCK_HZ, reduction=ReductionRoom(),
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
        self._waiting: deque[bytes | memoryview] = deque()  # one or more packets each
        self._waiting_bytes = 0
        self._powered_s = now_s()
        self._started_s = 0.0
        self._frame = self._dropped = self._sent_whole = self._peak = self._sequence = 0
        self._running = False
        self._filter: FrameFilter | None = None
        self._sensor, self._memory = sensor, ReductionMemory(sensor)
        self._reduction: PictureReduction | None = None
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
        elif register.name == registers.ReductionStore.NAME:
            self._memory.store_entries(self.registers, word)
        elif register.name == registers.ReductionMove.NAME:
            self._memory.store_offsets(self.registers, word)

    def _start(self) -> None:
        if self._running:
            self._stop()
        self._running = True
        self._filter = FrameFilter.of(self.registers)
        self._reduction = PictureReduction.of(
            self._sensor, self.registers, self._memory, keep=self._kept_pictures
        )
        self._started_s = self._now_s()
        self._frame = self._dropped = self._sent_whole = self._peak = 0
        self._event(EventCode.RUN_STARTED, self._capture)

    def _stop(self) -> None:
        if self._running:
            self._running = False
            self._send_picture()
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
            due, frame_s = self._due(), self.frame_s
            while self._frame < due:
                self._expose(due, frame_s)
            limit = self._value(registers.FrameLimit)
            if limit and self._frame >= limit:
                self._stop()

    def _due(self) -> int:
        """Number of frames of the run that are due by now."""
        due = int((self._now_s() - self._started_s) / self.frame_s)
        limit = self._value(registers.FrameLimit)
        return min(due, limit) if limit else due

    def _expose(self, due: int, frame_s: float) -> None:
        """Put frames into the buffer or drop them, up to the one before `due` or to a status."""
        interval = self._value(registers.StatusInterval)
        if interval:
            due = min(due, self._frame + interval - self._frame % interval)
        if self._reduction is not None:
            due = min(due, self._frame + self._reduction.frames_left)
        templates = self._fitting(due - self._frame)
        # nothing leaves the buffer meanwhile: once a frame does not fit, none that follows does
        dropped = due - self._frame - len(templates)
        if templates and self._sends_codes:
            self._put(self._stamped(templates, frame_s), len(templates))
        if self._reduction is not None:
            self._reduction.add(templates)
            self._reduction.miss(dropped)
            if not self._reduction.frames_left:
                self._send_picture()
        self._sent_whole += len(templates)
        self._dropped += dropped
        self._frame = due
        self.sent = replace(
            self.sent,
            frames=self.sent.frames + len(templates) + dropped,
            dropped=self.sent.dropped + dropped,
        )
        if interval and self._frame % interval == 0:
            self._put(encode_status(self._status()))

    def _fitting(self, most: int) -> list[Template]:
        """Draw the next frames, as far as they fit into the buffer."""
        templates: list[Template] = []
        room, draw = self._buffer_bytes - self._waiting_bytes, self.bank.template
        if self._reduction is not None:
            room -= self._reduction.bytes
        # what does not fit need not be drawn, which a camera that was away for long would have to
        while len(templates) < most and self._last_size <= room:
            template = draw(self._frame + len(templates))
            if self._filter is not None:
                template = self._filter.apply(template)
            self._last_size = template.size if self._sends_codes else 0
            room -= self._last_size
            if room < 0:
                break
            templates.append(template)
        return templates

    @property
    def _sends_codes(self) -> bool:
        return self._reduction is None or self._reduction.with_codes

    def _send_picture(self) -> None:
        """Put the picture of sums into the buffer, as far as it has come."""
        if self._reduction is not None:
            for body in self._reduction.bodies():
                self._put(encode_packet(PacketType.SUMS, body, self._header()))

    def _stamped(self, templates: list[Template], frame_s: float) -> bytes:
        """Packets of the next frames."""
        numbers = empty_headers(len(templates))
        frames = np.arange(self._frame, self._frame + len(templates))
        numbers["sequence"] = self._sequence + frames - self._frame & registers.Sequence.VALUE_MAX
        numbers["timestamp"] = frames * frame_s * CLOCK_HZ
        numbers["frame"] = frames
        numbers["dropped"] = min(self._dropped, registers.FramesDropped.VALUE_MAX)
        numbers["capture"] = self._capture
        numbers["clock_hz"] = CLOCK_HZ
        return stamp_all(templates, numbers)

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
            parts: list[bytes | memoryview] = []
            room = limit
            while self._waiting and room:
                packets = self._waiting.popleft()
                if len(packets) > room:
                    view = memoryview(packets)
                    self._waiting.appendleft(view[room:])
                    packets = view[:room]
                parts.append(packets)
                room -= len(packets)
            self._waiting_bytes -= limit - room
            return b"".join(parts)

    @property
    def ready_bytes(self) -> int:
        """About how many bytes a transfer would find now; nothing is drawn yet."""
        with self._lock:
            due = max(0, self._due() - self._frame) if self._running else 0
            return self._waiting_bytes + due * max(1, self._last_size)

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

    def _put(self, data: bytes, packets: int = 1) -> None:
        self._sequence = self._sequence + packets & registers.Sequence.VALUE_MAX
        self._waiting.append(data)
        self._waiting_bytes += len(data)
        self._peak = max(self._peak, self._waiting_bytes)
        self.sent = replace(self.sent, packets=self.sent.packets + packets)
