# SPDX-License-Identifier: Apache-2.0
"""Cameras on USB: discovery, and control messages over bulk endpoints (pyusb)."""

from __future__ import annotations

import errno
from dataclasses import dataclass
from typing import Any, NoReturn

import usb.backend.libusb1
import usb.core
import usb.util

from hueflight.devices.camera import Camera
from hueflight.devices.errors import (
    DeviceBusyError,
    DeviceError,
    DeviceGoneError,
    DeviceNotFoundError,
    DevicePermissionError,
    WrongDeviceError,
)
from hueflight.devices.transports.usb_identity import (
    CONTROL_IN,
    CONTROL_INTERFACE,
    CONTROL_OUT,
    CONTROL_READ_BYTES,
    PRODUCT_ID,
    PRODUCT_PREFIX,
    STREAM_IN,
    STREAM_INTERFACE,
    VENDOR_ID,
)
from hueflight.devices.transports.usb_stream import UsbStream

GONE = (errno.ENODEV, errno.ESHUTDOWN, errno.ENOENT)
_SEND_TIMEOUT_MS = 1000
#: boards on SuperSpeed have an FT601
LINK_OF_SPEED = {usb.util.SPEED_HIGH: "USB 2", usb.util.SPEED_SUPER: "FT601"}


@dataclass(frozen=True)
class UsbPlace:
    """A camera that is plugged in.

    Attributes
    ----------
    serial : str or None
        Serial number, None where this user may not read it.
    bus, address : int
        Where the camera is now; the address changes whenever it is plugged in.
    """

    serial: str | None
    bus: int
    address: int

    @property
    def name(self) -> str:
        """The place for people."""
        return f"USB {self.bus:03d}:{self.address:03d}"


def find_cameras() -> list[UsbPlace]:
    """Return every camera on USB, whether it can be opened or not.

    Returns
    -------
    list of UsbPlace
        The cameras, by bus and address.

    Raises
    ------
    DeviceError
        If libusb is not installed.
    """
    found: list[UsbPlace] = []
    for device in _devices():
        try:
            serial = device.serial_number
            product = device.product or ""
        except (usb.core.USBError, ValueError):
            serial, product = None, PRODUCT_PREFIX  # may not be opened: `open_camera` says why
        if product.startswith(PRODUCT_PREFIX):
            found.append(UsbPlace(serial, device.bus, device.address))
        usb.util.dispose_resources(device)
    return sorted(found, key=lambda place: (place.bus, place.address))


def open_camera(serial: str | None = None) -> Camera:
    """Open the camera with a serial number, or the only one there is.

    Parameters
    ----------
    serial : str, optional
        Serial number of the camera.

    Returns
    -------
    Camera
        The camera.

    Raises
    ------
    DeviceNotFoundError
        If there is none, or several and no serial number was given.
    DevicePermissionError, DeviceBusyError
        If it may not be opened now.
    WrongDeviceError
        If what answers is no camera that this host can work with.
    """
    place = _choose(find_cameras(), serial)
    transport = UsbTransport(place)
    try:
        return Camera(
            transport,
            lambda size: UsbStream(place.bus, place.address, size),
            link=transport.link,
        )
    except BaseException:
        transport.close()
        raise


class UsbTransport:
    """Control messages of one camera; the interface stays claimed until `close`.

    Attributes
    ----------
    link : str
        What the camera is plugged into, one of `hueflight_protocol.links.LINKS`; empty if the
        system does not know.
    """

    def __init__(self, place: UsbPlace) -> None:
        self.name = place.name
        self._device = next(
            (d for d in _devices() if (d.bus, d.address) == (place.bus, place.address)), None
        )
        if self._device is None:
            raise DeviceGoneError(f"{self.name}: the camera was unplugged")
        self.link = LINK_OF_SPEED.get(self._device.speed, "")
        try:
            self._check_endpoints(self._device)
            usb.util.claim_interface(self._device, CONTROL_INTERFACE)
        except usb.core.USBError as error:
            self.close()
            _raise(error, self.name)

    def _check_endpoints(self, device: Any) -> None:
        """Refuse a device whose descriptors are not those of a camera."""
        try:
            configuration = device.get_active_configuration()
            there = {
                (interface.bInterfaceNumber, endpoint.bEndpointAddress)
                for interface in configuration
                for endpoint in interface
                if endpoint.bmAttributes & 3 == usb.util.ENDPOINT_TYPE_BULK
            }
        except (usb.core.USBError, ValueError, TypeError, NotImplementedError) as error:
            code = getattr(error, "errno", None)
            if code in (errno.EACCES, errno.EBUSY, *GONE):
                raise
            there = set()
        wanted = {
            (CONTROL_INTERFACE, CONTROL_OUT),
            (CONTROL_INTERFACE, CONTROL_IN),
            (STREAM_INTERFACE, STREAM_IN),
        }
        if missing := wanted - there:
            self.close()
            listed = ", ".join(f"{end:#04x} of interface {face}" for face, end in sorted(missing))
            raise WrongDeviceError(
                f"{self.name} calls itself a camera but has no bulk endpoint {listed}: its "
                "gateware is of another version; load the one that belongs to this host"
            )

    def send(self, message: bytes, /) -> None:
        """Send one message as one transfer."""
        device = self._open()
        try:
            device.write(CONTROL_OUT, message, _SEND_TIMEOUT_MS)
        except usb.core.USBTimeoutError:
            return  # the answer that does not come is reported by who waits for it
        except usb.core.USBError as error:
            self._recover(error, CONTROL_OUT)

    def receive(self, timeout_s: float, /) -> bytes | None:
        """Next message from the camera."""
        device = self._open()
        try:
            data = device.read(CONTROL_IN, CONTROL_READ_BYTES, max(1, round(timeout_s * 1e3)))
        except usb.core.USBTimeoutError:
            return None
        except usb.core.USBError as error:
            self._recover(error, CONTROL_IN)
            return None
        return bytes(data)

    def close(self) -> None:
        """Release the interface and the device."""
        device, self._device = self._device, None
        if device is not None:
            usb.util.dispose_resources(device)

    def _open(self) -> Any:
        if self._device is None:
            raise DeviceGoneError(f"{self.name}: the camera was closed")
        return self._device

    def _recover(self, error: usb.core.USBError, endpoint: int) -> None:
        """A stalled endpoint is cleared and the request asked again; anything else is an end."""
        if error.errno not in (errno.EPIPE, errno.EOVERFLOW):
            _raise(error, self.name)
        if error.errno == errno.EPIPE:
            try:
                self._open().clear_halt(endpoint)
            except usb.core.USBError as second:
                _raise(second, self.name)


def _devices() -> list[Any]:
    backend = usb.backend.libusb1.get_backend()
    if backend is None:
        raise DeviceError(
            "libusb-1.0 is not installed: without it no camera can be found (Debian: apt install "
            "libusb-1.0-0)"
        )
    found = usb.core.find(find_all=True, idVendor=VENDOR_ID, idProduct=PRODUCT_ID, backend=backend)
    return list(found or ())


def _choose(places: list[UsbPlace], serial: str | None) -> UsbPlace:
    if serial is None and len(places) == 1:
        return places[0]
    if not places:
        raise DeviceNotFoundError(
            "no camera on USB"
            + ("" if serial is None else f", so none with serial number {serial!r}")
            + ": is it plugged in and powered? (--simulate works without)"
        )
    listed = ", ".join(f"{place.serial or 'not readable'} at {place.name}" for place in places)
    if serial is None:
        raise DeviceNotFoundError(f"{len(places)} cameras ({listed}): say which by serial number")
    for place in places:
        if place.serial == serial:
            return place
    locked = [place for place in places if place.serial is None]
    if locked:
        raise _permission(locked[0].name)
    raise DeviceNotFoundError(f"no camera with serial number {serial!r}; there are {listed}")


def _permission(name: str) -> DevicePermissionError:
    return DevicePermissionError(
        f"{name}: this user may not open the camera: install the udev rule 60-hueflight.rules "
        "(host/udev) in /etc/udev/rules.d, then unplug and plug it again"
    )


def _raise(error: usb.core.USBError, name: str) -> NoReturn:
    if error.errno in (errno.EACCES, errno.EPERM):
        raise _permission(name) from None
    if error.errno == errno.EBUSY:
        raise DeviceBusyError(
            f"{name}: another program holds the camera: is a daemon running? End it or use its API"
        ) from None
    if error.errno in GONE:
        raise DeviceGoneError(f"{name}: the camera was unplugged") from None
    raise DeviceGoneError(f"{name}: the camera does not answer any more: {error}") from None
