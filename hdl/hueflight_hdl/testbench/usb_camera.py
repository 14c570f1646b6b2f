# SPDX-License-Identifier: Apache-2.0
"""The camera behind its USB device, with flat ports on the side of the transceiver (UTMI)."""

from __future__ import annotations

import warnings

from amaranth.hdl import Module
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out, connect

from ..camera.camera import Camera, CameraConfig
from ..link.usb import UsbLink

with warnings.catch_warnings():  # LUNA still uses Amaranth's older records
    warnings.simplefilter("ignore", DeprecationWarning)
    from luna.gateware.interface.utmi import UTMIInterface

CLOCKS = {"sync": 3, "usb": 5}
"""100 MHz and 60 MHz, in clocks of 300 MHz."""


class UsbCameraTestbench(wiring.Component):
    """A camera and its `UsbLink` between bytes on the bus and nothing.

    Members
    -------
    rx_data, rx_valid, rx_active, line_state, tx_ready : In
    tx_data, tx_valid, high_speed, chirp : Out
        As UTMI has them, in the domain `usb`.
    """

    def __init__(self, config: CameraConfig) -> None:
        self.config = config
        super().__init__(
            {
                "rx_data": In(8),
                "rx_valid": In(1),
                "rx_active": In(1),
                "line_state": In(2),
                "tx_ready": In(1),
                "tx_data": Out(8),
                "tx_valid": Out(1),
                "high_speed": Out(1),
                "chirp": Out(1),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)
            bus = UTMIInterface()
            m.submodules.link = link = UsbLink(bus, serial="00000007")
        m.submodules.camera = camera = Camera(self.config)
        connect(m, camera.packets, link.packets)
        connect(m, link.requests, camera.requests)
        connect(m, camera.responses, link.responses)
        m.d.comb += [
            bus.rx_data.eq(self.rx_data),
            bus.rx_valid.eq(self.rx_valid),
            bus.rx_active.eq(self.rx_active),
            bus.line_state.eq(self.line_state),
            bus.tx_ready.eq(self.tx_ready),
            self.tx_data.eq(bus.tx_data),
            self.tx_valid.eq(bus.tx_valid),
            self.high_speed.eq((bus.xcvr_select == 0) & ~bus.term_select),
            self.chirp.eq(bus.op_mode == 2),
        ]
        return m
