# SPDX-License-Identifier: Apache-2.0
"""Bit packing against one big integer."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hueflight_protocol.packing import pack_codes, unpack_codes


@given(st.integers(1, 16), st.integers(0, 9), st.integers(0, 2**32 - 1))
def test_packing_is_one_little_endian_integer(code_bits: int, groups: int, seed: int):
    rng = np.random.default_rng(seed)
    codes = rng.integers(0, 1 << code_bits, 8 * groups).astype(np.uint16)
    number = sum(int(code) << code_bits * i for i, code in enumerate(codes))
    packed = pack_codes(codes, code_bits)
    assert packed.tobytes() == number.to_bytes(groups * code_bits, "little")
    np.testing.assert_array_equal(unpack_codes(packed, code_bits), codes)


def test_eight_nine_bit_codes_are_nine_bytes():
    packed = pack_codes(np.array([0x1FF, 0, 0, 0, 0, 0, 0, 0x100], np.uint16), 9)
    assert packed.tobytes() == bytes([0xFF, 0x01, 0, 0, 0, 0, 0, 0, 0x80])


@pytest.mark.parametrize("code_bits", [1, 9, 16])
def test_rows_are_packed_by_themselves(code_bits: int):
    codes = (np.arange(6 * 16).reshape(2, 3, 16) % (1 << code_bits)).astype(np.uint16)
    packed = pack_codes(codes, code_bits)
    assert packed.shape == (2, 3, 2 * code_bits)
    np.testing.assert_array_equal(packed[1, 2], pack_codes(codes[1, 2], code_bits))
    np.testing.assert_array_equal(unpack_codes(packed, code_bits), codes)
