# SPDX-License-Identifier: Apache-2.0
"""Operations of the API: one table, from which routes and OpenAPI description are generated."""

from __future__ import annotations

from hueflight.daemon.http.calibration_operations import CALIBRATION_OPERATIONS
from hueflight.daemon.http.camera_operations import CAMERA_OPERATIONS
from hueflight.daemon.http.operation import Operation
from hueflight.daemon.http.playback_operations import PLAYBACK_OPERATIONS
from hueflight.daemon.http.recording_operations import RECORDING_OPERATIONS
from hueflight.daemon.http.several_cameras_operations import SEVERAL_CAMERAS_OPERATIONS

OPERATIONS: tuple[Operation, ...] = (
    *CAMERA_OPERATIONS,
    *RECORDING_OPERATIONS,
    *PLAYBACK_OPERATIONS,
    *SEVERAL_CAMERAS_OPERATIONS,
    *CALIBRATION_OPERATIONS,
)
