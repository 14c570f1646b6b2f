# SPDX-License-Identifier: Apache-2.0
"""The checks against published values, and against the properties claimed for them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import hueflight_protocol as hp
from hueflight_protocol.checksum import CRC_CHECK_INPUT, CRC_CHECK_VALUE


@pytest.mark.parametrize(
    ("data", "crc"),
    [
        (CRC_CHECK_INPUT, CRC_CHECK_VALUE),  # catalogue of parametrised CRC algorithms
        # RFC 3720 (iSCSI), appendix B.4; printed there as bytes, lowest first.
        (bytes(32), 0x8A9136AA),
        (b"\xff" * 32, 0x62A8AB43),
        (bytes(range(32)), 0x46DD794E),
        (bytes(reversed(range(32))), 0x113FDB5C),
    ],
)
def test_crc_of_published_data(data: bytes, crc: int):
    assert hp.crc32c(data) == crc
    assert hp.crc32c(memoryview(bytearray(data))) == crc


@given(st.lists(st.integers(0, 2**32 - 1), max_size=20))
def test_exclusive_or_of_words(words: list[int]):
    folded = 0
    for word in words:
        folded ^= word
    data = np.array(words, "<u4").tobytes()
    assert hp.xor_words(data) == folded
    assert hp.xor_words(data + folded.to_bytes(4, "little")) == 0
