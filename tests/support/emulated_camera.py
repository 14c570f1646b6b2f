# SPDX-License-Identifier: Apache-2.0
"""The camera model with USB around it: descriptors, endpoints, and faults on demand.

One device for both emulations, the fake usbfs below libusb and the usbredir server below QEMU.
"""

from __future__ import annotations

import random
import struct
import threading
from collections import deque

from hueflight.devices.transports.usb_identity import (
    CONTROL_IN,
    CONTROL_INTERFACE,
    CONTROL_OUT,
    PRODUCT_ID,
    PRODUCT_PREFIX,
    STREAM_IN,
    STREAM_INTERFACE,
    VENDOR_ID,
)
from hueflight.emulation.camera_model import CameraModel

DEVICE, CONFIGURATION, STRING, BOS = 1, 2, 3, 15
MAX_PACKET = 1024
# USB 3.2 chapter 9.6.2: USB 2.0 extension and SuperSpeed capability
BOS_DESCRIPTOR = bytes.fromhex("050f160002 07100200000000 0a1003000e00010aff07".replace(" ", ""))


class EmulatedCamera:
    """What a host controller sees.

    Attributes
    ----------
    stalled : endpoints that answer with a stall until the host clears it.
    overflows : transfers still to come in which the camera sends more than was asked.
    zero_length : transfers still to come that are answered with nothing.
    most : most bytes per transfer, for short packets; None for as many as fit.
    deaf : control messages are taken and never answered.
    damage : share of the transfers of the stream in which one bit is wrong.
    """

    def __init__(
        self,
        model: CameraModel,
        *,
        serial: str = "HF0001",
        endpoints: tuple[tuple[int, int], ...] = (
            (CONTROL_INTERFACE, CONTROL_OUT),
            (CONTROL_INTERFACE, CONTROL_IN),
            (STREAM_INTERFACE, STREAM_IN),
        ),
        product: str = f"{PRODUCT_PREFIX} 1",
    ) -> None:
        self.model = model
        self.serial = serial
        self.endpoints = endpoints
        self.strings = {1: "Hueflight", 2: product, 3: serial}
        self.stalled: set[int] = set()
        self.overflows = 0
        self.zero_length = 0
        self.most: int | None = None
        self.deaf = False
        self.damage = 0.0
        self._rng = random.Random(1)
        self.delivered_bytes = 0
        self._answers: deque[bytes] = deque()
        self._lock = threading.Lock()

    # -- descriptors --------------------------------------------------------------------------

    def descriptors(self) -> bytes:
        """Device and configuration descriptors, as sysfs has them."""
        return self._device() + self._configuration()

    def _device(self) -> bytes:
        return struct.pack(
            "<BBHBBBBHHHBBBB", 18, DEVICE, 0x0300, 0, 0, 0, 9, VENDOR_ID, PRODUCT_ID, 0x0100,
            1, 2, 3, 1,
        )  # fmt: skip

    def _configuration(self) -> bytes:
        body = b""
        for interface in sorted({face for face, _ in self.endpoints}):
            ends = [end for face, end in self.endpoints if face == interface]
            body += struct.pack("<9B", 9, 4, interface, 0, len(ends), 0xFF, 0, 0, 0)
            for end in ends:
                body += struct.pack("<BBBBHB", 7, 5, end, 2, MAX_PACKET, 0)
                body += struct.pack("<BBBBH", 6, 0x30, 15, 0, 0)
        faces = len({face for face, _ in self.endpoints})
        return struct.pack("<BBHBBBBB", 9, 2, 9 + len(body), faces, 1, 0, 0x80, 112) + body

    def setup(self, kind: int, request: int, value: int, length: int) -> bytes | None:
        """Answer a standard request on endpoint 0; None stalls."""
        if (kind, request) != (0x80, 6):
            return None
        what, index = value >> 8, value & 0xFF
        if what == DEVICE:
            return self._device()[:length]
        if what == CONFIGURATION:
            return self._configuration()[:length]
        if what == BOS:
            return BOS_DESCRIPTOR[:length]
        if what == STRING and index == 0:
            return b"\x04\x03\x09\x04"[:length]
        if what == STRING and index in self.strings:
            text = self.strings[index].encode("utf-16le")
            return (bytes([len(text) + 2, STRING]) + text)[:length]
        return None

    # -- endpoints ----------------------------------------------------------------------------

    def out(self, endpoint: int, data: bytes) -> int:
        """Take a transfer from the host."""
        if endpoint == CONTROL_OUT and not self.deaf:
            answer = self.model.handle(bytes(data))
            if answer is not None:
                with self._lock:
                    self._answers.append(answer)
        return len(data)

    def pull(self, endpoint: int, size: int) -> bytes | None:
        """Data for a transfer to the host, None if there is nothing yet (NAK)."""
        if endpoint == CONTROL_IN:
            with self._lock:
                return self._answers.popleft() if self._answers else None
        if endpoint != STREAM_IN:
            return None
        if self.zero_length:
            self.zero_length -= 1
            return b""
        if self.overflows:
            self.overflows -= 1
            data = self.model.pull(size)
            return data + bytes(size + 1 - len(data))
        data = self.model.pull(size if self.most is None else min(size, self.most))
        self.delivered_bytes += len(data)
        if data and self._rng.random() < self.damage:
            spoiled = bytearray(data)
            spoiled[self._rng.randrange(len(spoiled))] ^= 1 << self._rng.randrange(8)
            data = bytes(spoiled)
        return data or None
