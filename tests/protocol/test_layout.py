# SPDX-License-Identifier: Apache-2.0
"""What derives from a declaration agrees with construct's own parser."""

import construct
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import hueflight_protocol as hp
from hueflight_protocol import control, wire
from hueflight_protocol.layout import Layout

LAYOUTS = {
    "FRAME_HEADER": wire.FRAME_HEADER,
    "FRAME_TRAILER": wire.FRAME_TRAILER,
    "PACKET_HEADER": wire.PACKET_HEADER,
    "PACKET_TRAILER": wire.PACKET_TRAILER,
    "EVENT_BODY": wire.EVENT_BODY,
    "STATUS_BODY": wire.STATUS_BODY,
    "TEST_BODY": wire.TEST_BODY,
    "CONTROL_HEADER": control.CONTROL_HEADER,
}
WORDS = {"CHUNK_WORD": wire.CHUNK_WORD, "END_WORD": wire.END_WORD}


@given(st.data())
def test_layouts(data: st.DataObject):
    layout = data.draw(st.sampled_from(list(LAYOUTS.values())))
    values = {}
    for field in layout.fields:
        info = np.iinfo(field.dtype)
        values[field.name] = data.draw(st.integers(int(info.min), int(info.max)))
        if field.constant is not None:
            values[field.name] = field.constant
    packed = layout.pack(values)
    assert packed == layout.declaration.build(values)
    assert layout.unpack(b"xyz" + packed, 3) == values
    view = np.frombuffer(packed, layout.dtype)[0]
    assert {name: int(view[name]) for name in view.dtype.names or ()} == values


@given(st.data())
def test_bit_layouts(data: st.DataObject):
    layout = data.draw(st.sampled_from(list(WORDS.values())))
    values = {f.name: data.draw(st.integers(0, f.mask)) for f in layout.fields}
    word = layout.pack(**values)
    assert word.to_bytes(4, "little") == layout.declaration.build(values)
    assert layout.unpack(word) == values


@pytest.mark.parametrize("layout", LAYOUTS.values(), ids=LAYOUTS)
def test_fields_lie_side_by_side_and_are_explained(layout: Layout):
    end = 0
    for field in layout.fields:
        assert field.offset == end == layout.offset(field.name)
        assert field.offset % field.size == 0, f"{field.name} is not aligned"
        assert field.doc
        end += field.size
    assert end == layout.size == layout.dtype.itemsize


def test_sizes_that_the_wire_promises():
    assert wire.FRAME_HEADER.size == 64
    assert wire.PACKET_HEADER.size == 32
    assert wire.FRAME_TRAILER.size % 8 == wire.PACKET_TRAILER.size % 8 == 0


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: wire.TEST_BODY.pack({"pattern": 0}), "no value for field 'seed'"),
        (lambda: wire.TEST_BODY.pack({"pattern": 0, "seed": -1}), "seed = -1: must be an integer"),
        (lambda: wire.TEST_BODY.pack({"pattern": 0, "seed": 0.5}), "seed = 0.5: must be"),
        (lambda: wire.CHUNK_WORD.pack(kind=4), "kind = 4: must be from 0 to 3"),
        (
            lambda: Layout(construct.Struct("x" / construct.Bytes(3))),
            "field 'x' is a Bytes, not an integer",
        ),
        (
            lambda: Layout(construct.Struct("x" / construct.Int16ub)),
            "field 'x' is not little-endian",
        ),
    ],
)
def test_what_is_refused(make, message: str):
    with pytest.raises(hp.ProtocolError, match=message):
        make()
