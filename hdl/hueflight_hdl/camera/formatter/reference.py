# SPDX-License-Identifier: Apache-2.0
"""Reference model of the formatter: filters in NumPy and the encoder of the protocol."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hueflight_protocol import FrameFlags, encode_frame

from ..frame_format import FrameFormat


@dataclass(frozen=True)
class SensorFrame:
    """One frame from the sensor, and what is asked of the formatter.

    Parameters
    ----------
    codes : array of uint16, (rows, cols)
        As they come from the sensor.
    info : mapping of str to int
        Fields of `INFO_LAYOUT`; 0 where not given.
    filters : mapping
        Fields of `FILTER_LAYOUT`; 0 where not given.
    abort_after : int, optional
        Beats after which the frame is given up.
    """

    codes: NDArray[np.uint16]
    info: Mapping[str, int] = field(default_factory=dict)
    filters: Mapping[str, Any] = field(default_factory=dict)
    abort_after: int | None = None


def filter_codes(
    codes: NDArray[np.uint16],
    filters: Mapping[str, Any],
    mask: NDArray[np.bool_] | None = None,
    /,
) -> tuple[NDArray[np.uint16], FrameFlags]:
    """Return the codes that the filters leave, and the flags that say so.

    Parameters
    ----------
    codes : array of uint16, (rows, cols)
    filters : mapping
        Fields of `FILTER_LAYOUT`.
    mask : array of bool, (rows, cols), optional
        Pixels that send 0 when the mask is on.
    """
    keep = np.ones(codes.shape, bool)
    flags = FrameFlags.NONE
    if filters.get("mask"):
        flags |= FrameFlags.MASKED
        if mask is not None:
            keep &= ~mask
    if filters.get("roi"):
        flags |= FrameFlags.ROI
        for place, window in zip(np.indices(codes.shape), ("rows", "cols"), strict=True):
            keep &= _within(place, filters[window])
    if filters.get("gate"):
        flags |= FrameFlags.GATED
        keep &= _within(codes, filters["codes"])
    return np.where(keep, codes, np.uint16(0)), flags


def _within(values: NDArray[Any], window: Mapping[str, int]) -> NDArray[np.bool_]:
    return (values >= window["first"]) & (values <= window["last"])


def expected_packets(
    form: FrameFormat, frames: Iterable[SensorFrame], mask: NDArray[np.bool_] | None = None, /
) -> bytes:
    """Return the packets of `frames`, numbered from 0."""
    return b"".join(
        expected_packet(form, frame, mask, sequence=number) for number, frame in enumerate(frames)
    )


def expected_packet(
    form: FrameFormat,
    frame: SensorFrame,
    mask: NDArray[np.bool_] | None = None,
    /,
    *,
    sequence: int,
) -> bytes:
    """Return the packet of one frame."""
    codes, flags = filter_codes(frame.codes, frame.filters, mask)
    info = {"frame": 0, "timestamp": 0, "periods": 0} | dict(frame.info)
    info["flags"] = FrameFlags(info.get("flags", 0)) | flags
    whole_chunks = None
    if frame.abort_after is not None:
        whole_chunks = frame.abort_after * form.lanes // form.run
    return encode_frame(
        codes,
        sequence=sequence,
        code_bits=form.code_bits,
        run=form.run,
        geometry=form.geometry,
        clock_hz=form.clock_hz,
        abort_at=whole_chunks,
        **info,
    )


def frame_beats(form: FrameFormat, codes: NDArray[np.uint16], /) -> NDArray[np.uint16]:
    """Return codes as the sensor port has them, (beats, lanes); all ones beyond the last pixel."""
    flat = codes.reshape(-1)
    beyond = np.full(form.beats * form.lanes - flat.size, (1 << form.code_bits) - 1, np.uint16)
    return np.concatenate([flat, beyond]).reshape(form.beats, form.lanes)


def pack_beats(form: FrameFormat, beats: NDArray[np.uint16], /) -> NDArray[np.uint32]:
    """Return beats as the words of a wide port, (beats, words), low bits first."""
    bits = (beats[:, :, None] >> np.arange(form.code_bits, dtype=np.uint16)) & 1
    flat = bits.astype(np.uint8).reshape(len(beats), -1)
    wide = np.pad(flat, ((0, 0), (0, -flat.shape[1] % 32)))
    return np.packbits(wide, axis=1, bitorder="little").view("<u4")
