# SPDX-License-Identifier: Apache-2.0
"""The emulated camera served over usbredir to QEMU's xHCI controller: a real kernel drives it.

Message layouts are those of usbredirproto.h (version 0.7), integers little-endian; of the
capabilities, 64-bit ids, 32-bit bulk lengths and device versions are used.
"""

from __future__ import annotations

import socket
import struct
import threading
from collections import OrderedDict
from enum import IntEnum

from hueflight.devices.transports.usb_identity import PRODUCT_ID, VENDOR_ID
from support.emulated_camera import EmulatedCamera

SUPER_SPEED = 3
BULK_ENDPOINT, NO_ENDPOINT = 2, 255
MAX_PACKET = 1024
CONNECT_VERSION, EP_MAX_PACKET, IDS_64, BULK_32 = (1 << bit for bit in (1, 4, 5, 6))
CAPABILITIES = CONNECT_VERSION | EP_MAX_PACKET | IDS_64 | BULK_32
PUMP_S = 0.002
STOP_S = 10


class Message(IntEnum):
    """Types that are used."""

    HELLO = 0
    CONNECT = 1
    DISCONNECT = 2
    RESET = 3
    INTERFACES = 4
    ENDPOINTS = 5
    SET_CONFIGURATION = 6
    GET_CONFIGURATION = 7
    CONFIGURATION = 8
    SET_SETTING = 9
    GET_SETTING = 10
    SETTING = 11
    CANCEL = 21
    CONTROL = 100
    BULK = 101


class Status(IntEnum):
    """How a transfer ended."""

    SUCCESS = 0
    CANCELLED = 1
    STALL = 4
    BABBLE = 6


class UsbRedir:
    """Serves one camera on a connected socket until the other side leaves.

    Parameters
    ----------
    camera : what is plugged in.
    sock : to QEMU's usb-redir device.
    """

    def __init__(self, camera: EmulatedCamera, sock: socket.socket) -> None:
        self._camera, self._sock = camera, sock
        self._wide = False  # ids of 64 bits, once both sides have said so
        self._lock = threading.RLock()
        self._pending: OrderedDict[int, tuple[int, int, int]] = OrderedDict()
        self._stop = threading.Event()
        self._threads = [
            threading.Thread(target=work, daemon=True) for work in (self._serve, self._pump)
        ]
        for thread in self._threads:
            thread.start()

    def unplug(self) -> None:
        """Pull the cable."""
        with self._lock:
            self._pending.clear()
            self._send(Message.DISCONNECT, 0)

    def close(self) -> None:
        """End both threads."""
        self._stop.set()
        self._sock.shutdown(socket.SHUT_RDWR)
        for thread in self._threads:
            thread.join(STOP_S)
        self._sock.close()

    # -- messages -----------------------------------------------------------------------------

    def _send(self, kind: Message, number: int, body: bytes = b"") -> None:
        head = struct.pack("<IIQ" if self._wide else "<III", kind, len(body), number)
        with self._lock:
            self._sock.sendall(head + body)

    def _receive(self, size: int) -> bytes:
        data = bytearray()
        while len(data) < size:
            part = self._sock.recv(size - len(data))
            if not part:
                raise EOFError
            data += part
        return bytes(data)

    def _serve(self) -> None:
        hello = b"hueflight".ljust(64, b"\0") + struct.pack("<I", CAPABILITIES)
        try:
            self._send(Message.HELLO, 0, hello)
            while True:
                if self._wide:
                    kind, size, number = struct.unpack("<IIQ", self._receive(16))
                else:
                    kind, size, number = struct.unpack("<III", self._receive(12))
                self._handle(kind, number, self._receive(size))
        except (EOFError, OSError):
            self._stop.set()

    def _handle(self, kind: int, number: int, body: bytes) -> None:
        if kind == Message.HELLO:
            (theirs,) = struct.unpack_from("<I", body, 64)
            missing = CAPABILITIES & ~theirs
            assert not missing, f"QEMU's usb-redir lacks capabilities {missing:#x}"
            self._wide = True
            self._connect()
        elif kind == Message.SET_CONFIGURATION:
            self._send(Message.CONFIGURATION, number, bytes([Status.SUCCESS, body[0]]))
        elif kind == Message.GET_CONFIGURATION:
            self._send(Message.CONFIGURATION, number, bytes([Status.SUCCESS, 1]))
        elif kind == Message.SET_SETTING:
            self._send(Message.SETTING, number, bytes([Status.SUCCESS, body[0], body[1]]))
        elif kind == Message.GET_SETTING:
            self._send(Message.SETTING, number, bytes([Status.SUCCESS, body[0], 0]))
        elif kind == Message.CONTROL:
            self._control(number, body)
        elif kind == Message.BULK:
            self._bulk(number, body)
        elif kind == Message.CANCEL:
            with self._lock:
                if pending := self._pending.pop(number, None):
                    self._bulk_done(number, pending[0], Status.CANCELLED, pending[2])

    def _connect(self) -> None:
        """Say what is plugged in: interfaces, endpoints, the device."""
        faces = sorted({face for face, _ in self._camera.endpoints})
        vendor = bytes(0xFF if place < len(faces) else 0 for place in range(32))
        numbers = bytes(faces).ljust(32, b"\0")
        self._send(
            Message.INTERFACES, 0, struct.pack("<I", len(faces)) + numbers + vendor + bytes(64)
        )
        kinds, places, sizes = [NO_ENDPOINT] * 32, [0] * 32, [0] * 32
        for at in (0, 16):
            kinds[at], sizes[at] = 0, 512
        for face, end in self._camera.endpoints:
            at = (end & 0x80) >> 3 | end & 0x0F
            kinds[at], places[at], sizes[at] = BULK_ENDPOINT, face, MAX_PACKET
        ends = bytes(kinds) + bytes(32) + bytes(places) + struct.pack("<32H", *sizes)
        self._send(Message.ENDPOINTS, 0, ends)
        device = struct.pack("<BBBBHHH", SUPER_SPEED, 0, 0, 0, VENDOR_ID, PRODUCT_ID, 0x0100)
        self._send(Message.CONNECT, 0, device)

    # -- transfers ----------------------------------------------------------------------------

    def _control(self, number: int, body: bytes) -> None:
        end, request, kind, _, value, index, length = struct.unpack_from("<BBBBHHH", body)
        answer: bytes | None
        if kind == 2 and request == 1:  # CLEAR_FEATURE(ENDPOINT_HALT)
            self._camera.stalled.discard(index & 0xFF)
            answer = b""
        elif request == 0 and kind & 0x80:  # GET_STATUS
            answer = bytes(2)[:length]
        elif kind < 3:  # SET_FEATURE, SET_SEL, SET_ISOCH_DELAY: nothing to do
            answer = b""
        else:
            answer = self._camera.setup(kind, request, value, length)
        status = Status.STALL if answer is None else Status.SUCCESS
        done = len(answer or b"") if kind & 0x80 else length
        head = struct.pack(
            "<BBBBHHH", end, request, kind, status, value, index, 0 if answer is None else done
        )
        self._send(Message.CONTROL, number, head + (answer or b""))

    def _bulk(self, number: int, body: bytes) -> None:
        end, _, low, stream, high = struct.unpack_from("<BBHIH", body)
        if end & 0x80:
            with self._lock:
                self._pending[number] = (end, low | high << 16, stream)
            self._kick()
        elif end in self._camera.stalled:
            self._bulk_done(number, end, Status.STALL, stream)
        else:
            taken = self._camera.out(end, body[10:])
            self._bulk_done(number, end, Status.SUCCESS, stream, length=taken)
            self._kick()

    def _bulk_done(
        self,
        number: int,
        end: int,
        status: Status,
        stream: int,
        data: bytes = b"",
        length: int | None = None,
    ) -> None:
        size = len(data) if length is None else length
        head = struct.pack("<BBHIH", end, status, size & 0xFFFF, stream, size >> 16)
        self._send(Message.BULK, number, head + data)

    def _pump(self) -> None:
        while not self._stop.wait(PUMP_S):
            self._camera.model.advance()
            try:
                self._kick()
            except OSError:
                return

    def _kick(self) -> None:
        """Complete transfers for which the camera has data, those of an endpoint in order."""
        with self._lock:
            dry: set[int] = set()
            for number, (end, size, stream) in list(self._pending.items()):
                if end in dry:
                    continue
                if end in self._camera.stalled:
                    del self._pending[number]
                    self._bulk_done(number, end, Status.STALL, stream)
                    continue
                data = self._camera.pull(end, size)
                if data is None:
                    dry.add(end)
                    continue
                del self._pending[number]
                status = Status.BABBLE if len(data) > size else Status.SUCCESS
                self._bulk_done(number, end, status, stream, data[:size])
