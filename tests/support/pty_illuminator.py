# SPDX-License-Identifier: Apache-2.0
"""An illuminator behind a pseudo terminal: real pyserial talks to the board's register file."""

from __future__ import annotations

import contextlib
import os
import pty
import select
import threading
import tty
from dataclasses import replace

from hueflight_protocol import CobsDecoder, Register, RegisterFile, illuminator_map, serial_frame
from hueflight_protocol.control import MAX_COBS_BYTES
from hueflight_protocol.illuminator_map import ARM_KEY
from hueflight_protocol.typed_registers import illuminator as registers

POLL_S = 0.02
CLOSE_S = 10


class PtyIlluminator:
    """A board without LEDs.

    Attributes
    ----------
    port : what pyserial opens.
    silent : requests are taken and never answered, as from a board that hangs.
    fed : how often the watchdog was fed.
    """

    def __init__(self, channels: int) -> None:
        self.registers = RegisterFile(illuminator_map(channels=channels), on_write=self._written)
        self.registers.store(registers.Versions(major=1))
        self.registers.store(registers.Serial(0xBEEF))
        for channel in range(channels):
            limit = registers.Limit(on_ticks=80, burst_ticks=80, duty_divisor=8)
            self.registers.store(limit, channel)
        self._master, self._slave = pty.openpty()
        tty.setraw(self._master)
        self.port = os.ttyname(self._slave)
        self.silent = False
        self.fed = 0
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    @property
    def state(self) -> registers.State:
        """What the board is doing."""
        return self.registers.load(registers.State)

    def _written(self, register: Register, _: tuple[int, ...], word: int) -> None:
        if register.name == registers.Arm.NAME:
            self.registers.store(replace(self.state, armed=int(word == ARM_KEY)))
        elif register.name == registers.WatchdogFeed.NAME:
            self.fed += 1
        elif register.name == registers.SequencerControl.NAME:
            asked = registers.SequencerControl.decode(register, word)
            if asked.start or asked.stop:
                self.registers.store(replace(self.state, sequencing=asked.start))

    def _serve(self) -> None:
        decoder = CobsDecoder(limit=MAX_COBS_BYTES)
        while not self._stop.is_set():
            ready, _, _ = select.select([self._master], [], [], POLL_S)
            if not ready:
                continue
            try:
                data = os.read(self._master, 4096)
            except OSError:
                return
            for message in decoder.feed(data):
                answer = self.registers.handle(message)
                if answer is not None and not self.silent:
                    os.write(self._master, serial_frame(answer))

    def close(self) -> None:
        """Unplug."""
        self._stop.set()
        self._thread.join(CLOSE_S)
        for end in (self._master, self._slave):
            with contextlib.suppress(OSError):
                os.close(end)
