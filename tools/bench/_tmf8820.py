# SPDX-License-Identifier: Apache-2.0
"""Real photons whose depth is known: a plane that a robot arm moves before an ams TMF8820.

The measurements lie beside the project and are no part of it. Each capture carries the pulse that
the sensor itself has measured, and the distances by the sensor's own firmware.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from _real_photons import REAL_DATA
from numpy.typing import NDArray

import hueflight as hf

Floats = NDArray[np.float64]
FILE = REAL_DATA / "tmf8820" / "plane_distances.json"
DESCRIPTION = Path(__file__).parents[2] / "tests" / "host" / "data" / "tmf8820.toml"
NEAREST_M = 0.05  #: nearer, the light of the plane overlaps with that of the cover glass
ZONES = (3, 3)


@dataclass(frozen=True)
class Capture:
    """What the sensor reported with the plane at one distance.

    Attributes
    ----------
    distance_m : float
        Distance of the plane by the robot, m.
    counts : ndarray of int, shape (row, col, code)
        Photons of each zone.
    calibration : Calibration
        Calibration by the capture's own reference pulse.
    firmware_m : ndarray of float, shape (zone,)
        Distances by the sensor's firmware, m.
    """

    distance_m: float
    counts: NDArray[np.uint32]
    calibration: hf.Calibration
    firmware_m: Floats


def captures(*, step: int = 1) -> list[Capture]:
    """Return every `step`-th capture beyond `NEAREST_M`."""
    instrument = hf.Instrument.load(DESCRIPTION)
    entries = json.loads(FILE.read_text(encoding="utf-8"))
    far = [entry for entry in entries if entry["dist_to_plane"] > NEAREST_M]
    return [
        Capture(
            entry["dist_to_plane"],
            np.array(entry["hists"], np.uint32).reshape(*ZONES, -1),
            hf.calibrate(
                np.tile(np.array(entry["reference_hist"]), (*ZONES, 1)), instrument, distance=0.0
            ),
            np.array(entry["distances"][0]["depths_1"]) / 1000,
        )
        for entry in far[::step]
    ]


def off_line(truth: Floats, found: Floats) -> tuple[Floats, Floats]:
    """Compare depths with a straight line for each zone.

    Parameters
    ----------
    truth : ndarray, shape (capture,)
        Distances by the robot, m.
    found : ndarray, shape (capture, zone)
        Depths, m.

    Returns
    -------
    errors : ndarray, shape (capture, zone)
        Depths less the line, m of the sensor's.
    slopes : ndarray, shape (zone,)
        Meters of the sensor's for each meter of the robot's.
    """
    slopes, offsets = np.polyfit(truth, found, 1)
    return found - (truth[:, None] * slopes + offsets), slopes
