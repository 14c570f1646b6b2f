# SPDX-License-Identifier: Apache-2.0
"""The packet stream over USB: several transfers always under way, memory bounded.

While the reader keeps up, a finished transfer is copied into the queue and submitted again at
once. When the queue is full, transfers rest until there is room: the camera then drops whole
frames and counts them, which is better than a stream with holes that nobody counted.
"""

# libusb1 makes its constants and errors at run time, out of a checker's sight
# pyright: reportAttributeAccessIssue=false, reportArgumentType=false

from __future__ import annotations

import contextlib
import threading
import time
from collections import deque
from pathlib import Path
from typing import Any

import usb1

from hueflight.devices.errors import (
    DeviceBusyError,
    DeviceError,
    DeviceGoneError,
    DevicePermissionError,
)
from hueflight.devices.transports.stream import StreamStatistics
from hueflight.devices.transports.usb_identity import STREAM_IN, STREAM_INTERFACE

TRANSFERS = 64  #: of some 4 ms each: a quarter of a second, where the kernel grants as much
QUEUE_BYTES = 64 << 20
MAX_FAILED_ROUNDS = 4  #: in a row, of all transfers, after which the link is given up
USBFS_LIMIT = Path("/sys/module/usbcore/parameters/usbfs_memory_mb")
_DEFAULT_USBFS_MB = 16
_POLL_S = 0.1
_CANCEL_S = 2.0


def in_flight_limit() -> int:
    """Return the most bytes of transfers under way: half of what the kernel grants all programs.

    Returns
    -------
    int
        Number of bytes.
    """
    try:
        megabytes = int(USBFS_LIMIT.read_text())
    except (OSError, ValueError):
        megabytes = _DEFAULT_USBFS_MB
    return (megabytes or 1 << 10) * (1 << 20) // 2  # 0 means no limit


class UsbStream:
    """Reads the stream endpoint of one camera in a thread of its own.

    Parameters
    ----------
    bus, address : int
        Where the camera is.
    transfer_bytes : int
        Size of a transfer in bytes, rounded to a multiple of 1024 so that nothing overflows.
    transfers : int
        Most transfers under way at once; fewer if memory is short.
    queue_bytes : int
        Most bytes that wait for the reader.
    """

    def __init__(
        self,
        bus: int,
        address: int,
        transfer_bytes: int,
        /,
        *,
        transfers: int = TRANSFERS,
        queue_bytes: int = QUEUE_BYTES,
    ) -> None:
        self._name = f"USB {bus:03d}:{address:03d}"
        self._size = max(1, transfer_bytes // 1024) * 1024
        self._queue_bytes = max(queue_bytes, 2 * self._size)
        self._queue: deque[bytes] = deque()
        self._queued = self._received = self._stalls = self._errors = 0
        self._failed_rounds = 0.0  # since data came last
        self._stalled_s = 0.0
        self._stalled_since: float | None = None
        self._all: list[Any] = []
        self._resting: list[Any] = []
        self._under_way = 0
        self._halted = self._closing = False
        self._failure: DeviceError | None = None
        self._changed = threading.Condition()

        self._context = usb1.USBContext()
        self._handle = self._open(bus, address)
        wanted = min(transfers, max(2, in_flight_limit() // self._size))
        self._begin(wanted)
        self._thread = threading.Thread(target=self._run, name="usb-stream", daemon=True)
        self._thread.start()

    def _open(self, bus: int, address: int) -> Any:
        try:
            for device in self._context.getDeviceIterator(skip_on_error=True):
                if (device.getBusNumber(), device.getDeviceAddress()) == (bus, address):
                    handle = device.open()
                    handle.claimInterface(STREAM_INTERFACE)
                    return handle
        except usb1.USBErrorAccess:
            self._context.close()
            raise DevicePermissionError(
                f"{self._name}: this user may not open the camera: install the udev rule "
                "60-hueflight.rules (host/udev), then unplug and plug it again"
            ) from None
        except usb1.USBErrorBusy:
            self._context.close()
            raise DeviceBusyError(
                f"{self._name}: another program reads the camera's stream"
            ) from None
        except usb1.USBError as error:
            self._context.close()
            raise DeviceGoneError(f"{self._name}: can't open the stream: {error}") from None
        self._context.close()
        raise DeviceGoneError(f"{self._name}: the camera was unplugged")

    def _begin(self, wanted: int) -> None:
        """Submit as many transfers as memory allows."""
        for _ in range(wanted):
            transfer = self._handle.getTransfer()
            transfer.setBulk(STREAM_IN, self._size, callback=self._arrived, timeout=0)
            self._all.append(transfer)
            try:
                transfer.submit()
            except usb1.USBErrorNoMem:
                if self._under_way > 2:
                    self._leave_room()
                    return
                self._abandon()
                raise DeviceError(
                    f"{self._name}: the kernel grants too little memory for USB transfers: raise "
                    f"{USBFS_LIMIT} (now used by other programs)"
                ) from None
            except usb1.USBError as error:
                self._abandon()
                raise DeviceGoneError(f"{self._name}: can't start the stream: {error}") from None
            self._under_way += 1

    def _leave_room(self) -> None:
        """Give up one transfer: messages to the camera take of the same memory."""
        before = self._under_way
        with contextlib.suppress(usb1.USBError):  # gone: the event thread will say so
            self._all[-2].cancel()  # the last one was refused
        deadline = time.monotonic() + _CANCEL_S
        while self._under_way == before and time.monotonic() < deadline:
            self._context.handleEventsTimeout(_POLL_S)

    def _abandon(self) -> None:
        self._handle.close()
        self._context.close()

    # -- the reader's side --------------------------------------------------------------------

    def read(self, timeout_s: float, /) -> bytes:
        """Next piece of the stream; ``b""`` if none came in time."""
        with self._changed:
            if not self._queue and self._failure is None:
                self._changed.wait(timeout_s)
            if not self._queue:
                if self._failure is not None:
                    raise self._failure
                return b""
            data = self._queue.popleft()
            self._queued -= len(data)
            if self._resting and self._queued <= self._queue_bytes // 2:
                self._resume()
            return data

    @property
    def statistics(self) -> StreamStatistics:
        """Totals so far."""
        with self._changed:
            stalled_s = self._stalled_s
            if self._stalled_since is not None:
                stalled_s += time.monotonic() - self._stalled_since
            return StreamStatistics(
                self._received, self._queued, self._queue_bytes, self._stalls, stalled_s,
                self._errors,
            )  # fmt: skip

    def close(self) -> None:
        """Cancel what is under way, wait for the thread, give the interface back."""
        with self._changed:
            self._closing = True
        self._context.interruptEventHandler()
        self._thread.join(timeout=10)

    # -- the event thread's side --------------------------------------------------------------

    def _run(self) -> None:
        cancelled = False
        while True:
            with self._changed:
                closing, halted, under_way = self._closing, self._halted, self._under_way
                failed = self._failure is not None
            if (closing or failed) and not cancelled:
                cancelled = True
                self._cancel_all()
            if (closing or failed) and not under_way:
                break
            if halted and not under_way and not closing:
                self._clear_halt()
            self._context.handleEventsTimeout(_POLL_S)
        if not self._closing:
            return self._wait_for_close()
        return self._release()

    def _wait_for_close(self) -> None:
        """The stream has failed; keep the handle until whoever reads it lets go."""
        while not self._closing:
            time.sleep(_POLL_S)
        self._release()

    def _release(self) -> None:
        with contextlib.suppress(usb1.USBError):  # if it is gone, nothing is left to release
            self._handle.releaseInterface(STREAM_INTERFACE)
        self._resting.clear()
        self._all.clear()
        self._handle.close()
        self._context.close()

    def _cancel_all(self) -> None:
        for transfer in self._all:
            if transfer.isSubmitted():
                with contextlib.suppress(usb1.USBError):  # just finished: its callback comes anyway
                    transfer.cancel()

    def _arrived(self, transfer: Any) -> None:
        """Take the data of a finished transfer and submit it again; libusb calls this."""
        status, size = transfer.getStatus(), transfer.getActualLength()
        with self._changed:
            self._under_way -= 1
            if size:
                # what came before a fault is good data: packets carry their own checksums
                self._queue.append(bytes(transfer.getBuffer()[:size]))
                self._queued += size
                self._received += size
                self._failed_rounds = 0.0
            self._judge(status, transfer)
            self._changed.notify_all()

    def _judge(self, status: int, transfer: Any) -> None:
        if status == usb1.TRANSFER_NO_DEVICE:
            self._fail(DeviceGoneError(f"{self._name}: the camera was unplugged"))
        elif status == usb1.TRANSFER_CANCELLED:
            if self._halted and not self._closing:
                self._resting.append(transfer)
        elif status == usb1.TRANSFER_STALL:
            if not self._halted:  # one halt fails whatever is under way
                self._count_error(rounds=1)
            self._halted = True
            self._resting.append(transfer)
            # after a halt nothing moves until it is cleared, which needs an idle endpoint
            self._cancel_all()
        elif self._failure is None and not self._closing:
            if status not in (usb1.TRANSFER_COMPLETED, usb1.TRANSFER_TIMED_OUT):
                self._count_error(rounds=1 / len(self._all))
            if self._halted:
                self._resting.append(transfer)
            elif self._queued < self._queue_bytes:
                self._submit(transfer)
            else:
                self._rest(transfer)

    def _count_error(self, *, rounds: float) -> None:
        self._errors += 1
        self._failed_rounds += rounds
        if self._failed_rounds >= MAX_FAILED_ROUNDS:
            self._fail(
                DeviceGoneError(
                    f"{self._name}: all transfers failed {MAX_FAILED_ROUNDS} times in a row: check "
                    "the cable and the port, then plug the camera again"
                )
            )

    def _fail(self, error: DeviceError) -> None:
        if self._failure is None:
            self._failure = error

    def _rest(self, transfer: Any) -> None:
        if self._stalled_since is None:
            self._stalled_since = time.monotonic()
            self._stalls += 1
        self._resting.append(transfer)

    def _resume(self) -> None:
        """Submit what rests; the caller holds the lock."""
        if self._halted or self._closing or self._failure is not None:
            return
        if self._stalled_since is not None:
            self._stalled_s += time.monotonic() - self._stalled_since
            self._stalled_since = None
        resting, self._resting = self._resting, []
        for transfer in resting:
            self._submit(transfer)

    def _submit(self, transfer: Any) -> None:
        if self._failure is not None:
            return
        try:
            transfer.submit()
            self._under_way += 1
        except usb1.USBErrorNoDevice:
            self._fail(DeviceGoneError(f"{self._name}: the camera was unplugged"))
        except usb1.USBError as error:
            self._fail(DeviceGoneError(f"{self._name}: the stream broke off: {error}"))

    def _clear_halt(self) -> None:
        try:
            self._handle.clearHalt(STREAM_IN)
        except usb1.USBError as error:
            gone = error.value in (usb1.ERROR_NO_DEVICE, usb1.ERROR_NOT_FOUND)
            what = "was unplugged" if gone else f"can't clear a halted stream: {error}"
            with self._changed:
                self._fail(DeviceGoneError(f"{self._name}: the camera {what}"))
                self._changed.notify_all()
            return
        with self._changed:
            self._halted = False
            self._resume()
