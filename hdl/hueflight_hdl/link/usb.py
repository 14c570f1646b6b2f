# SPDX-License-Identifier: Apache-2.0
"""USB 2 at high speed through LUNA: packets on one bulk endpoint, control messages on two.

# Ref: Universal Serial Bus Specification 2.0; ULPI 1.1; https://luna.readthedocs.io.
"""

from __future__ import annotations

import warnings
from typing import Any

from amaranth.hdl import Module
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out, connect, flipped

from ..control.messages import request_stream, response_stream
from .packet_crossing import PacketCrossing
from .packet_word import WORD_LAYOUT
from .usb_streams import PACKET_BYTES, ControlBytes, PacketBytes

with warnings.catch_warnings():  # LUNA still uses Amaranth's older records
    warnings.simplefilter("ignore", DeprecationWarning)
    from luna.usb2 import USBDevice, USBStreamInEndpoint, USBStreamOutEndpoint
    from usb_protocol.emitters import DeviceDescriptorCollection

VENDOR_ID = 0x1209
PRODUCT_ID = 0x0001
"""The number that pid.codes reserves for tests; a product needs its own."""
STREAM_ENDPOINT = 1
CONTROL_ENDPOINT = 2
QUEUE_WORDS = 512


# LUNA calls a second endpoint of one class by its address in memory, which would make every build
# another one; so each has a class.
class _StreamIn(USBStreamInEndpoint):
    pass


class _ControlIn(USBStreamInEndpoint):
    pass


class _ControlOut(USBStreamOutEndpoint):
    pass


class UsbLink(wiring.Component):
    """A USB device with two vendor-specific interfaces: 0 for control, 1 for packets.

    The domain `usb` (60 MHz, from the transceiver) has to be there.

    Parameters
    ----------
    bus : LUNA's ULPI or UTMI bus
    serial : str
        Serial number that the host sees.

    Members
    -------
    packets : In, requests : Out, responses : In
        In `sync`; see `WORD_LAYOUT` and `control.messages`.
    """

    def __init__(self, bus: Any, *, serial: str) -> None:
        self.bus = bus
        self.serial = serial
        super().__init__(
            {
                "packets": In(stream.Signature(WORD_LAYOUT)),
                "requests": Out(request_stream()),
                "responses": In(response_stream()),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.crossing = crossing = PacketCrossing(domain="usb", depth=QUEUE_WORDS)
        m.submodules.bytes = packet_bytes = PacketBytes()
        m.submodules.control = control = ControlBytes()
        connect(m, flipped(self.packets), crossing.packets)
        connect(m, crossing.words, packet_bytes.words)
        connect(m, control.requests, flipped(self.requests))
        connect(m, flipped(self.responses), control.responses)

        m.submodules.device = device = high_speed_device(self.bus)
        device.add_standard_control_endpoint(descriptors(self.serial))
        packets = _StreamIn(endpoint_number=STREAM_ENDPOINT, max_packet_size=PACKET_BYTES)
        answers = _ControlIn(endpoint_number=CONTROL_ENDPOINT, max_packet_size=PACKET_BYTES)
        asked = _ControlOut(endpoint_number=CONTROL_ENDPOINT, max_packet_size=PACKET_BYTES)
        for endpoint in (packets, answers, asked):
            device.add_endpoint(endpoint)
        for source, endpoint in ((packet_bytes.o, packets), (control.sent, answers)):
            m.d.comb += [
                endpoint.stream.payload.eq(source.payload.data),
                endpoint.stream.last.eq(source.payload.last),
                endpoint.stream.valid.eq(source.valid),
                source.ready.eq(endpoint.stream.ready),
            ]
        m.d.comb += [
            control.received.payload.data.eq(asked.stream.payload),
            control.received.payload.last.eq(asked.stream.last),
            control.received.valid.eq(asked.stream.valid),
            asked.stream.ready.eq(control.received.ready),
            device.connect.eq(1),
            device.full_speed_only.eq(0),
        ]
        return m


def high_speed_device(bus: Any, /) -> USBDevice:
    """Return a device that goes to high speed behind ULPI, and on a bare UTMI bus as well."""
    device = USBDevice(bus=bus, handle_clocking=False)
    device.always_fs = False
    device.data_clock = 60e6
    return device


def descriptors(serial: str, /) -> DeviceDescriptorCollection:
    """Return the USB descriptors of the device."""
    collection = DeviceDescriptorCollection()
    with collection.DeviceDescriptor() as device:
        device.idVendor = VENDOR_ID
        device.idProduct = PRODUCT_ID
        device.iManufacturer = "Hueflight"
        device.iProduct = "Hueflight camera"
        device.iSerialNumber = serial
        device.bNumConfigurations = 1
    with collection.ConfigurationDescriptor() as configuration:
        for number, addresses in enumerate(
            ((CONTROL_ENDPOINT, 0x80 | CONTROL_ENDPOINT), (0x80 | STREAM_ENDPOINT,))
        ):
            with configuration.InterfaceDescriptor() as interface:
                interface.bInterfaceNumber = number
                interface.bInterfaceClass = 0xFF
                for address in addresses:
                    with interface.EndpointDescriptor() as endpoint:
                        endpoint.bEndpointAddress = address
                        endpoint.wMaxPacketSize = PACKET_BYTES
    return collection
