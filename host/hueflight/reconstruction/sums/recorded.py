# SPDX-License-Identifier: Apache-2.0
"""Images of recorded sums, and what a camera is given to record them."""

from __future__ import annotations

import numpy as np
import xarray as xr

from hueflight.calibration import Calibration
from hueflight.errors import HistogramError
from hueflight.reconstruction.options import Region
from hueflight.reconstruction.sums.delay_tables import code_offsets
from hueflight.reconstruction.sums.design import SumsDesign
from hueflight.reconstruction.sums.method import reconstruct_sums
from hueflight.recording.recorded_sums import RecordedSums, SumsDescription


def describe_sums(design: SumsDesign, calibration: Calibration, /) -> SumsDescription:
    """Return what a recording of sums must hold beside them.

    Parameters
    ----------
    design : SumsDesign
        Tables, and the delays that they are for.
    calibration : Calibration
        The calibration that they were designed from; it also gives the offset of each pixel.

    Returns
    -------
    SumsDescription
        Tables and offsets.
    """
    offsets = code_offsets(calibration).astype(np.int64)
    return SumsDescription(design.tables, offsets, design.middle_ns, design.reach_ns)


def reconstruct_recorded_sums(
    recorded: RecordedSums,
    calibration: Calibration,
    /,
    *,
    range_correction: bool | None = None,
    pileup_correction: bool = True,
    region: Region | None = None,
) -> xr.Dataset:
    """Reconstruct depth and reflectance in every band from the sums of a recording.

    Parameters
    ----------
    recorded : RecordedSums
        Totals, as `hueflight.recording.read_sums` gives them.
    calibration : Calibration
        Calibration of the same instrument.
    range_correction : bool, optional
        Correct reflectance for the distance; see `reconstruct_sums`.
    pileup_correction : bool
        Undo the loss of later photons of an exposure.
    region : tuple of two slices, or array of bool with shape (row, col), optional
        Rows and columns, or a mask; see `reconstruct_sums`.

    Returns
    -------
    Dataset
        Image as `hueflight.reconstruct` gives it.

    Raises
    ------
    HistogramError
        If there is no whole part of a picture, or the sums do not fit the calibration.
    """
    if not recorded.pictures:
        raise HistogramError("the recording holds not one picture of sums: the capture was empty")
    made = recorded.description
    return reconstruct_sums(
        recorded.values,
        SumsDesign(made.tables, made.middle_ns, made.reach_ns),
        calibration,
        offsets=made.offsets,
        frames=np.maximum(recorded.frames, 1),  # pixels without any have no photon either
        range_correction=range_correction,
        pileup_correction=pileup_correction,
        region=region,
    )
