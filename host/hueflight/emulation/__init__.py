# SPDX-License-Identifier: Apache-2.0
"""The camera and its illumination in software, behind the interfaces of the real boards."""

from hueflight.emulation.camera_model import CameraModel
from hueflight.emulation.frame_bank import FrameBank
from hueflight.emulation.simulated_rig import SimulatedInstrument

__all__ = ["CameraModel", "FrameBank", "SimulatedInstrument"]
