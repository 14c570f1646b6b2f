# SPDX-License-Identifier: Apache-2.0
"""A usbfs device in Python, behind libumockdev's preload library.

Real libusb, pyusb and libusb1 run in a process of their own with ``LD_PRELOAD``; their ioctls on
the device node arrive here over umockdev's socket. The layouts are those of linux/usbdevice_fs.h
on 64-bit machines. The node is a pipe that is kept full while nothing can be reaped: libusb polls
it for writing.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import shutil
import socket
import struct
import threading
from collections import OrderedDict, deque
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from support.emulated_camera import EmulatedCamera

# umockdev's ioctl protocol: command, two arguments
MESSAGE = struct.Struct("@LLL")
IOCTL, DONE, READ_MEMORY, WRITE_MEMORY = 1, 3, 5, 6
# struct usbdevfs_urb
URB = struct.Struct("@BBxxiIPiiiiiIP")
URB_STATUS_AT, URB_ACTUAL_AT = 4, 28
URB_CONTROL = 2
REQUESTS = {
    0x8004551A: "capabilities",
    0x8004550F: "claim",
    0x80045510: "release",
    0x80085504: "set_interface",
    0x80045505: "set_configuration",
    0x80045515: "clear_halt",
    0x5514: "reset",
    0x550B: "discard",
    0x8038550A: "submit",
    0x4008550C: "reap",
    0x4008550D: "reap",
    0x41045508: "get_driver",
    0x551F: "speed",
}
CAPABILITIES = 0x01 | 0x04 | 0x08 | 0x10  # zero packet, no size limit, scatter, reap after unplug
SUPER_SPEED = 5
PIPE_BYTES = 4096
PUMP_S = 0.002
CLOSE_S = 30
AFTER_UNPLUG = ("reap", "discard", "release")


@dataclass
class Urb:
    """One transfer under way."""

    address: int
    kind: int
    endpoint: int
    buffer: int
    length: int
    status: int = 0
    actual: int = 0
    data: bytes | None = None


class Connection:
    """One open file of the device: its transfers and the interfaces it has claimed."""

    def __init__(self, sock: socket.socket) -> None:
        self.sock = sock
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4 << 20)
        self.pending: OrderedDict[int, Urb] = OrderedDict()
        self.done: deque[Urb] = deque()
        self.claimed: set[int] = set()

    def receive(self, size: int) -> bytearray:
        """Exactly so many bytes."""
        data = bytearray(size)
        view = memoryview(data)
        while len(view):
            count = self.sock.recv_into(view)
            if not count:
                raise EOFError
            view = view[count:]
        return data

    def peek(self, address: int, size: int) -> bytearray:
        """Memory of the client."""
        self.sock.sendall(MESSAGE.pack(READ_MEMORY, address, size))
        return self.receive(size)

    def poke(self, address: int, data: bytes) -> None:
        """Write memory of the client."""
        self.sock.sendall(MESSAGE.pack(WRITE_MEMORY, address, len(data)))
        self.sock.sendall(data)


class UsbfsBus:
    """A bus with one camera, in a folder that `umockdev` takes for the system's.

    Parameters
    ----------
    root : empty folder.
    camera : what is plugged in.
    """

    SYSFS = "sys/devices/pci0000:00/usb1/1-1"

    def __init__(self, root: Path, camera: EmulatedCamera) -> None:
        self.root, self.camera = root, camera
        self.number = 1
        self.plugged = False
        self.memory_limit: int | None = None
        self._lock = threading.RLock()
        self._connections: list[Connection] = []
        self._pipe = -1
        self._ready = False
        self._stop = threading.Event()
        for folder in ("sys/bus/usb/devices", "sys/class", "sys/dev/char", "dev/.node"):
            (root / folder).mkdir(parents=True)
        self._pump = threading.Thread(target=self._pump_stream, daemon=True)
        self._pump.start()

    @property
    def environment(self) -> dict[str, str]:
        """For the process that is to see this bus."""
        return {"LD_PRELOAD": "libumockdev-preload.so.0", "UMOCKDEV_DIR": str(self.root)}

    # -- plugging -----------------------------------------------------------------------------

    def plug(self) -> None:
        """The camera appears, under a new device number."""
        with self._lock:
            self.number += 1
            node = f"bus/usb/001/{self.number:03d}"
            minor = self.number - 1
            self._write_sysfs(node, minor)
            path = self.root / "dev" / node
            path.parent.mkdir(parents=True, exist_ok=True)
            (self.root / "dev/.node" / node.replace("/", "_")).symlink_to(f"189:{minor}")
            os.mkfifo(path, 0o666)
            self._pipe = os.open(path, os.O_RDWR | os.O_NONBLOCK)
            fcntl.fcntl(self._pipe, fcntl.F_SETPIPE_SZ, PIPE_BYTES)
            os.write(self._pipe, bytes(PIPE_BYTES))
            self._ready = False
            listener_path = f"{self.root}/ioctl//dev/{node}"
            Path(listener_path).parent.mkdir(parents=True, exist_ok=True)
            self._listener = socket.socket(socket.AF_UNIX)
            self._listener.bind(listener_path)
            self._listener.listen(8)
            self.plugged = True
            threading.Thread(target=self._accept, args=(self._listener,), daemon=True).start()
        self._announce("add")

    def unplug(self) -> None:
        """The camera disappears; transfers end as the kernel ends them."""
        with self._lock:
            if not self.plugged:
                return
            self.plugged = False
            for connection in self._connections:
                for urb in connection.pending.values():
                    urb.status = -errno.ESHUTDOWN
                    connection.done.append(urb)
                connection.pending.clear()
            self._signal()
            node = f"bus/usb/001/{self.number:03d}"
            shutil.rmtree(self.root / self.SYSFS)
            (self.root / "sys/bus/usb/devices/1-1").unlink()
            (self.root / f"sys/dev/char/189:{self.number - 1}").unlink()
            (self.root / "dev" / node).unlink()
            (self.root / "dev/.node" / node.replace("/", "_")).unlink()
            Path(f"{self.root}/ioctl//dev/{node}").unlink()
            self._listener.close()
        self._announce("remove")

    def close(self) -> None:
        """End of the emulation."""
        self._stop.set()
        self._pump.join(CLOSE_S)
        assert not self._pump.is_alive(), f"the emulated bus still works after {CLOSE_S} s"
        self.unplug()

    def _write_sysfs(self, node: str, minor: int) -> None:
        folder = self.root / self.SYSFS
        folder.mkdir(parents=True)
        device = self.camera.descriptors()
        vendor, product = struct.unpack_from("<HH", device, 8)
        uevent = (
            f"MAJOR=189\nMINOR={minor}\nDEVNAME={node}\nDEVTYPE=usb_device\nDRIVER=usb\n"
            f"PRODUCT={vendor:x}/{product:x}/100\nTYPE=0/0/0\nBUSNUM=001\n"
            f"DEVNUM={self.number:03d}\n"
        )
        files: dict[str, Any] = {
            "uevent": uevent, "busnum": "1", "devnum": self.number, "speed": 5000,
            "bConfigurationValue": 1, "idVendor": f"{vendor:04x}", "idProduct": f"{product:04x}",
            "serial": self.camera.serial, "dev": f"189:{minor}", "devpath": 1,
        }  # fmt: skip
        for name, content in files.items():
            (folder / name).write_text(f"{content}\n")
        (folder / "descriptors").write_bytes(device)
        (folder / "subsystem").symlink_to("../../../../bus/usb")
        (self.root / "sys/bus/usb/devices/1-1").symlink_to("../../../devices/pci0000:00/usb1/1-1")
        (self.root / f"sys/dev/char/189:{minor}").symlink_to("../../devices/pci0000:00/usb1/1-1")

    def _announce(self, action: str) -> None:
        """Send libudev's monitors the event that udev would send (libudev-monitor.c)."""
        device = self.camera.descriptors()
        vendor, product = struct.unpack_from("<HH", device, 8)
        properties = [
            f"ACTION={action}", "DEVPATH=/devices/pci0000:00/usb1/1-1", "SUBSYSTEM=usb",
            f"SEQNUM={self.number}", "DEVTYPE=usb_device",
            f"DEVNAME=/dev/bus/usb/001/{self.number:03d}", "MAJOR=189",
            f"MINOR={self.number - 1}", "BUSNUM=001", f"DEVNUM={self.number:03d}",
            f"PRODUCT={vendor:x}/{product:x}/100",
        ]  # fmt: skip
        body = b"".join(text.encode() + b"\0" for text in properties)
        header = b"libudev\0" + struct.pack(">I", 0xFEEDCAFE)
        header += struct.pack("@III", 40, 40, len(body))
        header += struct.pack(">IIII", murmur_hash2(b"usb"), murmur_hash2(b"usb_device"), 0, 0)
        for path in self.root.glob("event*"):
            with (
                socket.socket(socket.AF_UNIX, socket.SOCK_RAW) as sock,
                contextlib.suppress(OSError),
            ):
                sock.connect(str(path))
                sock.send(header + body, socket.MSG_DONTWAIT)

    # -- ioctls -------------------------------------------------------------------------------

    def _accept(self, listener: socket.socket) -> None:
        while True:
            try:
                sock, _ = listener.accept()
            except OSError:
                return
            connection = Connection(sock)
            with self._lock:
                self._connections.append(connection)
            threading.Thread(target=self._serve, args=(connection,), daemon=True).start()

    def _serve(self, connection: Connection) -> None:
        number = self.number
        try:
            while True:
                _, request, argument = MESSAGE.unpack(connection.receive(MESSAGE.size))
                name = REQUESTS.get(request & 0xFFFFFFFF, "")
                here = self.plugged and number == self.number
                result, error = 0, 0
                try:
                    if not here and name not in AFTER_UNPLUG:
                        raise OSError(errno.ENODEV, "unplugged")
                    handler = getattr(self, f"_{name}", None)
                    if handler is None:
                        raise OSError(errno.ENOTTY, "not emulated")
                    result = handler(connection, argument) or 0
                except OSError as failure:
                    result, error = (1 << 64) - 1, failure.errno or errno.EIO
                connection.sock.sendall(MESSAGE.pack(DONE, result, error))
        except (EOFError, OSError):
            with self._lock:
                if connection in self._connections:
                    self._connections.remove(connection)
                self._signal()
            connection.sock.close()

    def _capabilities(self, connection: Connection, argument: int) -> None:
        connection.poke(argument, struct.pack("@I", CAPABILITIES))

    def _claim(self, connection: Connection, argument: int) -> None:
        (interface,) = struct.unpack("@I", connection.peek(argument, 4))
        with self._lock:
            if any(interface in c.claimed for c in self._connections if c is not connection):
                raise OSError(errno.EBUSY, "claimed")
            connection.claimed.add(interface)

    def _release(self, connection: Connection, argument: int) -> None:
        (interface,) = struct.unpack("@I", connection.peek(argument, 4))
        connection.claimed.discard(interface)

    def _set_interface(self, connection: Connection, argument: int) -> None:
        pass

    _set_configuration = _reset = _set_interface

    def _get_driver(self, connection: Connection, argument: int) -> None:
        raise OSError(errno.ENODATA, "no driver")

    def _speed(self, connection: Connection, argument: int) -> int:
        return SUPER_SPEED

    def _clear_halt(self, connection: Connection, argument: int) -> None:
        (endpoint,) = struct.unpack("@I", connection.peek(argument, 4))
        self.camera.stalled.discard(endpoint)

    def _submit(self, connection: Connection, argument: int) -> None:
        fields = URB.unpack(connection.peek(argument, URB.size))
        urb = Urb(argument, fields[0], fields[1], fields[4], fields[5])
        if urb.kind == URB_CONTROL:
            self._control(connection, urb)
        elif urb.endpoint & 0x80:
            with self._lock:
                flying = sum(u.length for c in self._connections for u in c.pending.values())
                if self.memory_limit is not None and flying + urb.length > self.memory_limit:
                    raise OSError(errno.ENOMEM, "usbfs_memory_mb")
                connection.pending[argument] = urb
            self._kick()
            return
        elif urb.endpoint in self.camera.stalled:
            urb.status = -errno.EPIPE
        else:
            data = connection.peek(urb.buffer, urb.length) if urb.length else b""
            urb.actual = self.camera.out(urb.endpoint, bytes(data))
        with self._lock:
            connection.done.append(urb)
        self._kick()

    def _control(self, connection: Connection, urb: Urb) -> None:
        setup = bytes(connection.peek(urb.buffer, 8))
        kind, request, value, _, length = struct.unpack("<BBHHH", setup)
        answer = self.camera.setup(kind, request, value, length)
        if answer is None:
            urb.status = -errno.EPIPE
        else:
            urb.data, urb.actual = answer, len(answer)

    def _discard(self, connection: Connection, argument: int) -> None:
        with self._lock:
            urb = connection.pending.pop(argument, None)
            if urb is None:
                raise OSError(errno.EINVAL, "not under way")
            urb.status = -errno.ENOENT
            connection.done.append(urb)
            self._signal()

    def _reap(self, connection: Connection, argument: int) -> None:
        with self._lock:
            if not connection.done:
                raise OSError(errno.EAGAIN if self.plugged else errno.ENODEV, "nothing done")
            urb = connection.done.popleft()
            self._signal()
        if urb.data:
            offset = 8 if urb.kind == URB_CONTROL else 0
            connection.poke(urb.buffer + offset, urb.data)
        connection.poke(urb.address + URB_STATUS_AT, struct.pack("@i", urb.status))
        connection.poke(urb.address + URB_ACTUAL_AT, struct.pack("@i", urb.actual))
        connection.poke(argument, struct.pack("@P", urb.address))

    # -- data ---------------------------------------------------------------------------------

    def _pump_stream(self) -> None:
        while not self._stop.wait(PUMP_S):
            self.camera.model.advance()
            self._kick()

    def _kick(self) -> None:
        """Complete transfers for which the camera has data."""
        with self._lock:
            if self.plugged:
                for connection in self._connections:
                    for address, urb in list(connection.pending.items()):
                        if self._complete(urb):
                            del connection.pending[address]
                            connection.done.append(urb)
            self._signal()

    def _complete(self, urb: Urb) -> bool:
        if urb.endpoint in self.camera.stalled:
            urb.status = -errno.EPIPE
            return True
        data = self.camera.pull(urb.endpoint, urb.length)
        if data is None:
            return False
        if len(data) > urb.length:
            urb.status = -errno.EOVERFLOW
            data = data[: urb.length]
        urb.data, urb.actual = data, len(data)
        return True

    def _signal(self) -> None:
        """Make the node writable exactly while something can be reaped."""
        if self._pipe < 0:
            return
        ready = not self.plugged or any(c.done for c in self._connections)
        if ready and not self._ready:
            with contextlib.suppress(BlockingIOError):
                os.read(self._pipe, PIPE_BYTES)
        elif not ready and self._ready:
            with contextlib.suppress(BlockingIOError):
                os.write(self._pipe, bytes(PIPE_BYTES))
        self._ready = ready


def murmur_hash2(data: bytes) -> int:
    """MurmurHash2 with seed 0, by which libudev filters subsystems."""
    multiplier, mask = 0x5BD1E995, 0xFFFFFFFF
    value = len(data)
    while len(data) >= 4:
        word = int.from_bytes(data[:4], "little") * multiplier & mask
        word = (word ^ word >> 24) * multiplier & mask
        value = value * multiplier & mask ^ word
        data = data[4:]
    if data:
        value = (value ^ int.from_bytes(data, "little")) * multiplier & mask
    value = (value ^ value >> 13) * multiplier & mask
    return value ^ value >> 15
