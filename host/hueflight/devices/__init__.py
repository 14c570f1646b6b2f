# SPDX-License-Identifier: Apache-2.0
"""Boards: the camera on USB, the illuminator on a serial line."""

from hueflight.devices.board import Board, BoardIdentity
from hueflight.devices.built_in_rigs import camera_plugged_in, choose_rig
from hueflight.devices.camera import Camera, CameraCounters
from hueflight.devices.camera_settings import CameraSettings
from hueflight.devices.errors import (
    DeviceBusyError,
    DeviceError,
    DeviceGoneError,
    DeviceNotFoundError,
    DevicePermissionError,
    DeviceTimeoutError,
    RequestError,
    WrongDeviceError,
)
from hueflight.devices.illumination import (
    CaptureKind,
    Illumination,
    NoIllumination,
    ScheduledIllumination,
)
from hueflight.devices.rig import (
    Connect,
    Rig,
    RigAddress,
    RigAddressError,
    RigOpener,
    RigPart,
    register_rig,
    rig_from_uri,
    rig_schemes,
)
from hueflight.devices.transports.interface import Transport
from hueflight.devices.transports.stream import Stream, StreamStatistics

__all__ = [
    "Board",
    "BoardIdentity",
    "Camera",
    "CameraCounters",
    "CameraSettings",
    "CaptureKind",
    "Connect",
    "DeviceBusyError",
    "DeviceError",
    "DeviceGoneError",
    "DeviceNotFoundError",
    "DevicePermissionError",
    "DeviceTimeoutError",
    "Illumination",
    "NoIllumination",
    "RequestError",
    "Rig",
    "RigAddress",
    "RigAddressError",
    "RigOpener",
    "RigPart",
    "ScheduledIllumination",
    "Stream",
    "StreamStatistics",
    "Transport",
    "WrongDeviceError",
    "camera_plugged_in",
    "choose_rig",
    "register_rig",
    "rig_from_uri",
    "rig_schemes",
]
