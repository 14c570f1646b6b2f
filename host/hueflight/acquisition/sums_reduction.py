# SPDX-License-Identifier: Apache-2.0
"""Sums of a run: the tables that the camera is given, and what a recording holds of them."""

from __future__ import annotations

from math import ceil

import numpy as np

from hueflight.calibration import Calibration
from hueflight.devices.reduction import Reduction
from hueflight.errors import HueflightError
from hueflight.model.instrument import Instrument
from hueflight.reconstruction.sums.design import ENTRY_BITS, MORE_SUMS, design_sums
from hueflight.reconstruction.sums.recorded import describe_sums
from hueflight.recording.recorded_sums import ATTACHMENT, SumsDescription
from hueflight_protocol import ReductionRoom

LEAST_PHOTONS = 1000  #: that sums of a picture hold where the camera has room
LOAD = 16e6  #: bytes per second that sums may take where windows are shorter than a picture
LEAST_FRAMES = 240  #: of a window: more than a camera ends blocks, one a frame (181 on an ECP5)
PACKET_SHARE = 1.08  #: of the sums that they take with packet headers, at most


def reduction_of(
    calibration: Calibration,
    /,
    *,
    picture_frames: int,
    room: ReductionRoom | None = None,
    rate_hz: float | None = None,
) -> Reduction:
    """Return what a camera is to make of its codes, by a calibration.

    Parameters
    ----------
    calibration : Calibration
        Calibration that the tables are designed from; it also gives the offset of each pixel.
    picture_frames : int
        Frames of a picture.
    room : ReductionRoom, optional
        What the camera has room for; by default all that the protocol allows. Where sums of a
        picture would not fit it, the camera sends them more often, since sums of fewer frames are
        more precise in as many bits; they are added up to pictures.
    rate_hz : float, optional
        Frames per second, which limits how often they are sent; by default those of the instrument.

    Returns
    -------
    Reduction
        Tables that keep as much information as they can. Where the camera has room for few bits,
        sums of a surface that is bright in few bands may saturate, which is flagged.

    Raises
    ------
    HueflightError
        If the camera has room for too few sums, or for too narrow ones.
    """
    room = room or ReductionRoom()
    most_photons = max(picture_frames, LEAST_PHOTONS)
    wanted = min(calibration.templates.bands + MORE_SUMS, room.sums)
    entry_bits = min(ENTRY_BITS, room.entry_bits)
    design = design_sums(calibration, sums=wanted, entry_bits=entry_bits, most_photons=most_photons)
    widths = room.widths[:wanted]
    if any(width > most for width, most in zip(design.tables.widths, widths, strict=True)):
        sensor = calibration.instrument.sensor
        bytes_per_window = PACKET_SHARE * sensor.rows * sensor.cols * sum(widths) / 8
        least = ceil((rate_hz or sensor.usual_frame_rate_hz) * bytes_per_window / LOAD)
        picture_frames = min(picture_frames, max(LEAST_FRAMES, least))
        # a pixel reports a photon per frame at most
        if picture_frames + 2 > 1 << room.sum_bits:
            raise HueflightError(
                f"sums of {picture_frames} frames need {(picture_frames + 1).bit_length()} bits, "
                f"the camera has room for {room.sum_bits}: ask for fewer frames per second"
            )
        design = design_sums(
            calibration, sums=wanted, entry_bits=entry_bits, most_photons=picture_frames,
            most_widths=widths,
        )  # fmt: skip
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
