# SPDX-License-Identifier: Apache-2.0
"""What libusb reports, in words that say what to do."""

from __future__ import annotations

import errno

import pytest

pytest.importorskip("usb", reason="pyusb is not installed (extra devices)")

import usb.core

from hueflight.devices import (
    DeviceBusyError,
    DeviceGoneError,
    DeviceNotFoundError,
    DevicePermissionError,
)
from hueflight.devices.transports.usb import UsbPlace, _choose, _raise


@pytest.mark.parametrize(
    ("number", "kind", "words"),
    [
        (errno.EACCES, DevicePermissionError, "60-hueflight.rules"),
        (errno.EPERM, DevicePermissionError, "60-hueflight.rules"),
        (errno.EBUSY, DeviceBusyError, "is a daemon running"),
        (errno.ENODEV, DeviceGoneError, "was unplugged"),
        (errno.EIO, DeviceGoneError, "does not answer any more"),
    ],
)
def test_errors_say_what_to_do(number: int, kind: type[Exception], words: str) -> None:
    with pytest.raises(kind, match=words):
        _raise(usb.core.USBError("from libusb", -1, number), "USB 001:002")


def test_choosing_among_several() -> None:
    places = [UsbPlace("A", 1, 2), UsbPlace("B", 1, 3)]
    assert _choose(places, "B") is places[1]
    assert _choose(places[:1], None) is places[0]
    with pytest.raises(DeviceNotFoundError, match=r"2 cameras \(A at USB 001:002, B at"):
        _choose(places, None)
    with pytest.raises(DeviceNotFoundError, match="with serial number 'C'; there are A"):
        _choose(places, "C")
    with pytest.raises(DevicePermissionError, match="udev rule"):
        _choose([UsbPlace(None, 1, 2)], "C")
