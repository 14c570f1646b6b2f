# SPDX-License-Identifier: Apache-2.0
"""The eight words of a frame's header."""

from __future__ import annotations

from amaranth.hdl import Array, Cat, Const, Value
from amaranth.lib import data

from hueflight_protocol.wire import FRAME_HEADER

from ..frame_format import INFO_LAYOUT, FrameFormat

HEADER_WORDS = FRAME_HEADER.size // 8


def header_words(form: FrameFormat, info: data.View, /) -> Array:
    """Return a frame header as words of 64 bits; sequence and check are filled in later.

    Parameters
    ----------
    form : FrameFormat
        What is fixed by the build.
    info : View of INFO_LAYOUT
        What changes from frame to frame.
    """
    fixed = FRAME_HEADER.unpack(form.header())
    changing = dict(INFO_LAYOUT)
    parts: list[Value] = []
    for field in FRAME_HEADER.fields:
        bits = 8 * field.size
        if field.name in changing:
            parts.append(info[field.name])
        else:
            value = 0 if field.name in ("sequence", "check") else fixed[field.name]
            parts.append(Const(value, bits))
    whole = Cat(parts)
    return Array(whole[64 * i : 64 * (i + 1)] for i in range(HEADER_WORDS))
