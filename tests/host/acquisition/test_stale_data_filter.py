# SPDX-License-Identifier: Apache-2.0
"""A stream is cut at the first packet of its run, however it comes in pieces."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from hueflight.acquisition.stale_data_filter import StaleDataFilter
from hueflight_protocol import Event, EventCode, PacketHeader, encode_event, encode_frame

CODES = np.zeros((2, 8), np.uint16)


def packets(label: int, count: int, *, sequence: int = 0) -> bytes:
    started = Event(
        PacketHeader(sequence=sequence, capture=label), EventCode.RUN_STARTED, value=label
    )
    frames = [
        encode_frame(CODES, sequence=sequence + i + 1, frame=i, timestamp=i, capture=label)
        for i in range(count)
    ]
    return encode_event(started) + b"".join(frames)


@settings(max_examples=200)
@given(
    earlier=st.sampled_from([0, 1, 3, 60]),
    own=st.integers(4, 8),
    piece=st.sampled_from([1, 7, 100, 400, 20_000]),
    noise=st.binary(max_size=40),
    cut=st.integers(0, 200),
)
def test_what_comes_out_is_the_run(
    earlier: int, own: int, piece: int, noise: bytes, cut: int
) -> None:
    """Whole packets, a torn one and noise of an earlier run are left out; the rest is all there."""
    before, mine = packets(7, earlier), packets(8, own, sequence=100)
    stream = before[: max(0, len(before) - cut)] + noise + mine
    beginning = StaleDataFilter(8)
    out = b"".join(beginning.cut(stream[i : i + piece]) for i in range(0, len(stream), piece))
    assert beginning.found
    assert out == mine


def test_nothing_of_another_run_comes_out() -> None:
    beginning = StaleDataFilter(8)
    stream = packets(7, 20)
    assert not any(beginning.cut(stream[i : i + 100]) for i in range(0, len(stream), 100))
    assert not beginning.found
