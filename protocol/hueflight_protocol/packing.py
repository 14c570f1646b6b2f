# SPDX-License-Identifier: Apache-2.0
"""Little-endian bit packing of codes, in groups of eight codes = `code_bits` bytes.

Code i of a run occupies bits i·w to i·w + w − 1 of its byte string, where bit k is bit
k mod 8 of byte k div 8. Eight codes of any width fill whole bytes, so both directions work
on columns of groups, with a handful of shifts instead of a loop over bits.
"""

import numpy as np
from numpy.typing import NDArray


def pack_codes(codes: NDArray[np.uint16], code_bits: int, /) -> NDArray[np.uint8]:
    """Pack codes along the last axis.

    Parameters
    ----------
    codes : ndarray of uint16, shape (..., n)
        Codes below 2**code_bits; n is a multiple of 8.
    code_bits : int
        Width of a code, 1 to 16.

    Returns
    -------
    ndarray of uint8, shape (..., n * code_bits / 8)
        Packed codes in little-endian bit order.
    """
    groups = np.ascontiguousarray(codes.reshape(-1, 8).T)
    out = np.zeros((code_bits, groups.shape[1]), np.uint8)
    for byte in range(code_bits):
        for i in range(8 * byte // code_bits, (8 * byte + 7) // code_bits + 1):
            shift = i * code_bits - 8 * byte
            part = groups[i] << shift if shift >= 0 else groups[i] >> -shift
            out[byte] |= part.astype(np.uint8)
    return np.ascontiguousarray(out.T).reshape(*codes.shape[:-1], codes.shape[-1] // 8 * code_bits)


def unpack_codes(packed: NDArray[np.uint8], code_bits: int, /) -> NDArray[np.uint16]:
    """Unpack codes along the last axis; the inverse of `pack_codes`.

    Parameters
    ----------
    packed : ndarray of uint8, shape (..., n * code_bits / 8)
        Packed codes; n is a multiple of 8.
    code_bits : int
        Width of a code, 1 to 16.

    Returns
    -------
    ndarray of uint16, shape (..., n)
        The codes.
    """
    groups = packed.reshape(-1, code_bits).T.astype(np.uint32)
    out = np.empty((groups.shape[1], 8), np.uint16)
    mask = (1 << code_bits) - 1
    for i in range(8):
        first, shift = divmod(i * code_bits, 8)
        last = (i * code_bits + code_bits - 1) // 8
        value = groups[first] >> shift
        for k in range(first + 1, last + 1):
            value |= groups[k] << (8 * (k - first) - shift)
        out[:, i] = value & mask
    return out.reshape(*packed.shape[:-1], packed.shape[-1] // code_bits * 8)
