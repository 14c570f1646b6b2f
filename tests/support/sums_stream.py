# SPDX-License-Identifier: Apache-2.0
"""Packets of sums as a camera sends them, from counts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from hueflight.devices.reduction import Reduction
from hueflight_protocol import PacketHeader, Sums, encode_sums
from hueflight_protocol.reduction import offsets_hash, reduce_histogram


def packets_of_sums(
    counts: Sequence[NDArray[np.integer]],
    reduction: Reduction,
    *,
    lost: tuple[tuple[int, int], ...] = (),
    capture: int = 1,
    ticks: int = 250_000,
) -> Iterator[bytes]:
    """Each array (row, col, code) of counts as a picture, a row in a packet, `ticks` apart.

    Of a picture and row in `lost` there is no packet.
    """
    tables, offsets = reduction.tables, reduction.offsets
    assert offsets is not None
    for picture, histogram in enumerate(counts):
        rows, cols, codes = histogram.shape
        sums = reduce_histogram(histogram.reshape(-1, codes), tables, offsets=offsets.ravel())
        for row, values in enumerate(sums.reshape(rows, cols, -1).astype(np.uint32)):
            if (picture, row) in lost:
                continue
            sequence, timestamp = picture * rows + row, picture * ticks
            header = PacketHeader(sequence=sequence, timestamp=timestamp, capture=capture)
            part = Sums(
                header=header, values=values, widths=tables.widths, picture=picture,
                first_pixel=row * cols, rows=rows, cols=cols, frames=reduction.frames,
                tables=tables.hash, offsets=offsets_hash(offsets.ravel()),
            )  # fmt: skip
            yield encode_sums(part)
