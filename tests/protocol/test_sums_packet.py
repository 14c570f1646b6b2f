# SPDX-License-Identifier: Apache-2.0
"""Packets of sums: what can't be sent, what is refused, and pictures from their parts."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hueflight_protocol as hp
from hueflight_protocol.sums_packet import unpack_sums

HEADER = hp.PacketHeader(sequence=3, timestamp=4, capture=5)


def part(first: int, pixels: int, **options) -> hp.Sums:
    widths = (4, 11, 20)
    values = np.random.default_rng(first).integers(0, 15, (pixels, 3)).astype(np.uint32)
    given = {"picture": 1, "rows": 4, "cols": 6, "frames": 9, "tables": 7} | options
    return hp.Sums(header=HEADER, values=values, widths=widths, first_pixel=first, **given)


@settings(max_examples=40)
@given(data=st.data())
def test_sums_come_back(data):
    widths = tuple(data.draw(st.lists(st.integers(1, 32), min_size=1, max_size=32)))
    pixels = data.draw(st.integers(1, 20))
    rows = [[data.draw(st.integers(0, 2**w - 1)) for w in widths] for _ in range(min(pixels, 3))]
    values = np.array([rows[p % len(rows)] for p in range(pixels)], np.uint32)
    sums = hp.Sums(header=HEADER, values=values, widths=widths, picture=8, first_pixel=1,
                   rows=3, cols=7, frames=620, photons=1 << 60, tables=9)  # fmt: skip
    found = hp.decode_packet(hp.encode_sums(sums))
    assert isinstance(found, hp.Sums)
    assert (found.values == values).all()
    for field in dataclasses.fields(hp.Sums):
        if field.name != "values":
            assert getattr(found, field.name) == getattr(sums, field.name)


@pytest.mark.parametrize(
    ("at", "value", "rule"),
    [(12, 0, "U2"), (8, 30, "U2"), (48, 17, "U2"), (49, 0, "U2"), (49, 4, "U3"), (51, 1, "U2"),
     (52, 1, "U2"), (56, 0, "U3"), (57, 33, "U3"), (59, 1, "U3"), (32, 1, "U4"), (-1, 128, "U3")],
)  # fmt: skip
def test_a_body_that_breaks_a_rule_is_refused(at: int, value: int, rule: str):
    body = bytearray(hp.encode_sums(part(0, 6))[32:-8])
    body = body[: 56 + 8 + -(-6 * 35 // 8)]
    unpack_sums(bytes(body), HEADER, 32)
    body[at] = value
    with pytest.raises(hp.PacketError) as caught:
        unpack_sums(bytes(body), HEADER, 32)
    assert caught.value.rule == rule


def test_a_cut_body_is_refused():
    body = hp.encode_sums(part(0, 6))[32:-8]
    with pytest.raises(hp.PacketError, match="sums body has 40 bytes"):
        unpack_sums(body[:40], HEADER, 32)


def test_what_does_not_fit_can_not_be_sent():
    with pytest.raises(hp.ProtocolError, match="sum 0 reaches 16: does not fit 4 bits"):
        hp.encode_sums(dataclasses.replace(part(0, 1), values=np.array([[16, 0, 0]])))
    with pytest.raises(hp.ProtocolError, match=r"can't be sent.*pixels 20 \+ 6 of 24"):
        hp.encode_sums(part(20, 6))
    for values in (np.zeros((6, 2), int), np.zeros((6, 3))):
        with pytest.raises(hp.ProtocolError, match=r"must be whole numbers \(6, 3\)"):
            hp.encode_sums(dataclasses.replace(part(0, 6), values=values))


def test_parts_become_pictures():
    assembler = hp.PictureAssembler()
    assert assembler.feed(part(0, 10)) is None
    picture = assembler.feed(part(10, 14))
    assert picture is not None
    assert picture.complete
    assert (picture.values.reshape(24, 3)[10:] == part(10, 14).values).all()
    assert assembler.finish() is None


def test_a_missing_part_leaves_its_pixels_unknown():
    assembler = hp.PictureAssembler()
    assembler.feed(part(0, 6))
    picture = assembler.feed(part(12, 12))
    assert picture is not None
    assert picture.present.sum() == 18
    assert not picture.present.reshape(-1)[6:12].any()
    # a last part that is lost: the next picture ends the one before
    assembler.feed(part(0, 10))
    picture = assembler.feed(part(0, 10, picture=2))
    assert picture is not None
    assert picture.first.picture == 1
    assert picture.present.sum() == 10


def test_each_part_of_a_picture_has_frames_of_its_own():
    assembler = hp.PictureAssembler()
    assembler.feed(part(0, 10, frames=7, missed=2, photons=5))
    assembler.feed(part(10, 2, frames=8, flags=hp.FrameFlags.GATED, periods=3))
    picture = assembler.feed(part(18, 6, frames=0, missed=4))
    assert picture is not None
    frames, missed = picture.frames.reshape(-1), picture.missed.reshape(-1)
    assert frames.tolist() == [7] * 10 + [8] * 2 + [0] * 12
    assert missed.tolist() == [2] * 10 + [0] * 8 + [4] * 6
