# SPDX-License-Identifier: Apache-2.0
"""What can go wrong with a board, each saying what to do about it."""

from __future__ import annotations

from hueflight.errors import HueflightError


class DeviceError(HueflightError):
    """A board that can't be used as asked."""


class DeviceNotFoundError(DeviceError):
    """No such board is plugged in."""


class DevicePermissionError(DeviceError):
    """The board is there, but this user may not open it."""


class DeviceBusyError(DeviceError):
    """Another program holds the board."""


class WrongDeviceError(DeviceError):
    """Something answers, but it is not a board, version or size that this host can work with."""


class DeviceGoneError(DeviceError):
    """The board was unplugged or lost power while in use."""


class DeviceTimeoutError(DeviceError):
    """A request was sent and no answer came."""


class RequestError(DeviceError):
    """The board answered that it does not do what was asked."""
