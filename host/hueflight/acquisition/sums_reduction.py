# SPDX-License-Identifier: Apache-2.0
"""Sums of a run: the tables that the camera is given, and what a recording holds of them."""

from __future__ import annotations

import numpy as np

from hueflight.calibration import Calibration
from hueflight.devices.reduction import Reduction
from hueflight.model.instrument import Instrument
from hueflight.reconstruction.sums.design import design_sums
from hueflight.reconstruction.sums.recorded import describe_sums
from hueflight.recording.recorded_sums import ATTACHMENT, SumsDescription

LEAST_PHOTONS = 1000  #: that sums of a picture hold without saturation, at least


def reduction_of(calibration: Calibration, /, *, picture_frames: int) -> Reduction:
    """Return what a camera is to make of its codes, by a calibration.

    Parameters
    ----------
    calibration : Calibration
        Calibration that the tables are designed from; it also gives the offset of each pixel.
    picture_frames : int
        Frames of a picture.

    Returns
    -------
    Reduction
        Tables that keep as much information as they can, of which no sum saturates.
    """
    design = design_sums(calibration, most_photons=max(picture_frames, LEAST_PHOTONS))
    described = describe_sums(design, calibration)
    return Reduction(
        described.tables,
        picture_frames,
        described.offsets,
        middle_ns=described.middle_ns,
        reach_ns=described.reach_ns,
    )


def attachments_of(reduction: Reduction | None, instrument: Instrument, /) -> dict[str, bytes]:
    """Return what a recording of sums must hold beside them.

    Parameters
    ----------
    reduction : Reduction or None
        What the camera makes of its codes; None if it sends codes.
    instrument : Instrument
        Instrument that takes the frames.

    Returns
    -------
    dict of bytes
        Attachments by name; none for codes.
    """
    if reduction is None:
        return {}
    offsets = reduction.offsets
    if offsets is None:
        offsets = np.zeros((instrument.sensor.rows, instrument.sensor.cols), np.int64)
    described = SumsDescription(
        reduction.tables, offsets.astype(np.int64), reduction.middle_ns, reduction.reach_ns
    )
    return {ATTACHMENT: described.to_bytes()}
