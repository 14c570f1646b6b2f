"""Boards: the camera on USB, the illuminator on a serial line, and a simulated instrument."""

from hueflight.devices.board import Board, BoardIdentity
from hueflight.devices.camera import Camera, CameraCounters, CameraSettings
from hueflight.devices.camera_model import CameraModel
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
from hueflight.devices.frame_bank import FrameBank
from hueflight.devices.lights import CaptureKind, Lights, NoLights
from hueflight.devices.rig import Connect, Rig, camera_plugged_in, hardware, simulated
from hueflight.devices.simulated import SimulatedInstrument
from hueflight.devices.streams import Stream, StreamStatistics
from hueflight.devices.transport import Transport

__all__ = [
    "Board",
    "BoardIdentity",
    "Camera",
    "CameraCounters",
    "CameraModel",
    "CameraSettings",
    "CaptureKind",
    "Connect",
    "DeviceBusyError",
    "DeviceError",
    "DeviceGoneError",
    "DeviceNotFoundError",
    "DevicePermissionError",
    "DeviceTimeoutError",
    "FrameBank",
    "Lights",
    "NoLights",
    "RequestError",
    "Rig",
    "SimulatedInstrument",
    "Stream",
    "StreamStatistics",
    "Transport",
    "WrongDeviceError",
    "camera_plugged_in",
    "hardware",
    "simulated",
]
