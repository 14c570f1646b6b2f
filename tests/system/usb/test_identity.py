# SPDX-License-Identifier: Apache-2.0
"""On USB, gateware and emulation say of themselves what the driver looks for."""

from __future__ import annotations

import struct

import pytest

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
from hueflight.emulation import CameraModel
from support.emulated_camera import EmulatedCamera

DEVICE, CONFIGURATION, STRING, INTERFACE, ENDPOINT = 1, 2, 3, 4, 5
BULK = 2


def endpoints(configuration: bytes) -> set[tuple[int, int]]:
    """(interface, address) of the bulk endpoints of a configuration descriptor (USB 2.0, 9.6)."""
    found, interface, at = set(), -1, 0
    while at < len(configuration):
        size, kind = configuration[at : at + 2]
        if kind == INTERFACE:
            interface = configuration[at + 2]
        elif kind == ENDPOINT:
            assert configuration[at + 3] & 3 == BULK
            found.add((interface, configuration[at + 2]))
        at += size
    return found


def test_gateware_emulation_and_driver_agree(model: CameraModel) -> None:
    pytest.importorskip("luna", reason="LUNA is not installed (extra bitstream)")
    from hueflight_hdl.link.usb import descriptors

    texts, device, configuration = [], b"", b""
    for kind, _, raw in descriptors("HF0001"):
        if kind == DEVICE:
            device = bytes(raw)
        elif kind == CONFIGURATION:
            configuration = bytes(raw)
        elif kind == STRING:
            texts.append(bytes(raw)[2:].decode("utf-16le", "replace"))
    assert struct.unpack_from("<HH", device, 8) == (VENDOR_ID, PRODUCT_ID)
    assert any(text.startswith(PRODUCT_PREFIX) for text in texts)
    assert "HF0001" in texts
    wanted = {
        (CONTROL_INTERFACE, CONTROL_OUT), (CONTROL_INTERFACE, CONTROL_IN),
        (STREAM_INTERFACE, STREAM_IN),
    }  # fmt: skip
    assert endpoints(configuration) == wanted
    emulated = EmulatedCamera(model).setup(0x80, 6, CONFIGURATION << 8, 512)
    assert emulated is not None
    assert endpoints(emulated) == wanted
