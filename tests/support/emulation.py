# SPDX-License-Identifier: Apache-2.0
"""Whether the emulated bus can be had on this machine."""

from __future__ import annotations

import ctypes
import ctypes.util

import pytest

PRELOAD = "libumockdev-preload.so.0"


def missing_packages() -> list[str]:
    """Debian packages without which the emulation can't be."""
    found = []
    try:
        ctypes.CDLL(PRELOAD)
    except OSError:
        found.append("umockdev")
    if ctypes.util.find_library("usb-1.0") is None:
        found.append("libusb-1.0-0")
    return found


def require_packages() -> None:
    """Skip, saying so, where they are not installed."""
    if missing := missing_packages():
        pytest.skip(f"USB emulation needs the Debian packages {' '.join(missing)}")
