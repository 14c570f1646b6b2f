# SPDX-License-Identifier: Apache-2.0
"""The two checks of the wire format: CRC-32C over everything, XOR over a header.

CRC-32C is the catalogue entry CRC-32/ISCSI (Castagnoli 1993; RFC 3720 appendix B.4);
``amaranth.lib.crc.catalog.CRC32_ISCSI`` is the same function in gateware. Its check value,
over the ASCII digits ``123456789``, is ``0xE3069283``.
"""

import struct

import google_crc32c

CRC_CHECK_INPUT = b"123456789"
CRC_CHECK_VALUE = 0xE3069283


def crc32c(data: bytes | bytearray | memoryview, /) -> int:
    """Return the CRC-32C of `data`.

    Parameters
    ----------
    data : bytes-like
        Bytes to check.

    Returns
    -------
    int
        The checksum, 32 bits.
    """
    # The library refuses writable buffers, so anything but bytes is copied first.
    return google_crc32c.value(data if isinstance(data, bytes) else bytes(data))


def xor_words(data: bytes | bytearray | memoryview, /) -> int:
    """Return the exclusive or of all little-endian 32-bit words of `data`.

    Over a whole packet header, its check word included, the result is zero.

    Parameters
    ----------
    data : bytes-like
        A multiple of 4 bytes.

    Returns
    -------
    int
        The check word.
    """
    check = 0
    for (word,) in struct.iter_unpack("<I", data):
        check ^= word
    return check
