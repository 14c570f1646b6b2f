# SPDX-License-Identifier: Apache-2.0
"""A word of a packet stream, as the camera sends it to every link."""

from __future__ import annotations

from amaranth.lib import data

WORD_LAYOUT = data.StructLayout({"data": 64, "last": 1})
"""Eight bytes of a packet, the first in the low bits; the last word of a packet is marked."""
