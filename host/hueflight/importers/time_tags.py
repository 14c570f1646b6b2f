# SPDX-License-Identifier: Apache-2.0
"""Histograms from PTU files in T2 mode, which hold the absolute time of every event.

The time of a photon within a period is what has passed since the sync event before it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hueflight.errors import FileFormatError

PICOHARP_T2 = 0x00010203  #: type of the records of a PicoHarp 300, whose input 0 is the sync
SYNC_OF_OTHERS = 0b1000000  #: special bit set, channel 0
LATEST_PERIODS = 1000  #: after a sync event, beyond which the phase of a photon is not known


def time_tag_histograms(
    path: Path, ptu: Any, /, *, bin_width_ns: float
) -> tuple[dict[int, NDArray[np.uint32]], float]:
    """Count the photons of each channel by the time since the sync event before them.

    Parameters
    ----------
    path : pathlib.Path
        Path of the file, for messages.
    ptu : ptufile.PtuFile
        The open file, in T2 mode.
    bin_width_ns : float
        Width of a bin, ns.

    Returns
    -------
    histograms : dict of int to ndarray of uint32, shape (bin,)
        Counts of each channel that has photons. Photons before the first sync event are left out,
        and those later than `LATEST_PERIODS` periods after one, as when the sync signal paused.
    period_ns : float
        Median time between sync events, ns.

    Raises
    ------
    FileFormatError
        If the file is of an image, or has too few sync events.
    """
    if ptu.is_image:
        raise FileFormatError(
            f"{str(path)!r} holds an image in T2 mode, which is not read: measure images in T3 mode"
        )
    records, raw = ptu.decode_records(), ptu.read_records()
    tick_ns = float(ptu.global_resolution) * 1e9
    channel, times = records["channel"], records["time"].astype(np.int64)
    of_picoharp = int(ptu.record_type) == PICOHARP_T2
    is_sync = channel == 0 if of_picoharp else raw >> 25 == SYNC_OF_OTHERS
    syncs = times[is_sync]
    if syncs.size < 2:
        raise FileFormatError(
            f"{str(path)!r} was measured in T2 mode and has {syncs.size} sync events: without "
            "them, a photon has no time within a period; record the sync input, or measure in T3 "
            "mode"
        )
    period = float(np.median(np.diff(syncs)))
    is_photon = (channel >= 0) & ~is_sync & (times >= syncs[0])
    channels, arrived = channel[is_photon], times[is_photon]
    since = arrived - syncs[np.searchsorted(syncs, arrived, side="right") - 1]
    timed = since <= LATEST_PERIODS * period
    channels, since_ns = channels[timed], since[timed] * tick_ns
    bins = np.floor(since_ns / bin_width_ns + 1e-9).astype(np.int64)
    count = int(bins.max(initial=0)) + 1
    histograms = {
        int(number): np.bincount(bins[channels == number], minlength=count).astype(np.uint32)
        for number in np.unique(channels)
    }
    return histograms, period * tick_ns
