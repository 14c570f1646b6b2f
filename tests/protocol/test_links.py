# SPDX-License-Identifier: Apache-2.0
"""The mean size of a packet, where it can be worked out by hand."""

from hueflight_protocol.links import packet_bytes

EMPTY = 64 + 16  #: header and trailer
CHUNKS, RUN = 4, 512
WORD = 4  #: bytes in front of a chunk's bitmap or codes


def test_frames_that_are_all_empty_or_all_full():
    assert packet_bytes(32, 64, 0.0, code_bits=9, run=RUN) == EMPTY
    full = EMPTY + CHUNKS * (WORD + RUN * 9 // 8)
    assert packet_bytes(32, 64, 1.0, code_bits=9, run=RUN) == full


def test_a_tenth_of_the_pixels_costs_their_codes_and_bitmaps():
    expected = EMPTY + CHUNKS * (WORD + RUN / 8 + 0.1 * RUN * 9 / 8)
    found = packet_bytes(32, 64, 0.1, code_bits=9, run=RUN)
    assert abs(found - expected) < 0.05 * expected  # of 8 frames, padded
