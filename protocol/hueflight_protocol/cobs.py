# SPDX-License-Identifier: Apache-2.0
"""Consistent Overhead Byte Stuffing: messages on a serial line, told apart by zero bytes.

# Ref: S. Cheshire, M. Baker, Consistent Overhead Byte Stuffing, IEEE/ACM Transactions on
# Networking 7(2), 1999.

The encoder emits no trailing code byte after a last block of exactly 254 bytes, as the
paper's own listing does; both forms decode to the same message.
"""

from .errors import MessageError

_BLOCK = 254


def cobs_encode(message: bytes, /) -> bytes:
    """Encode a message so that it has no zero byte.

    Parameters
    ----------
    message : bytes
        Any bytes.

    Returns
    -------
    bytes
        The encoded message, without a delimiter.
    """
    out = bytearray()
    parts = message.split(b"\0")
    for number, part in enumerate(parts):
        last = number == len(parts) - 1
        while len(part) > _BLOCK or (len(part) == _BLOCK and not last):
            out.append(_BLOCK + 1)
            out += part[:_BLOCK]
            part = part[_BLOCK:]
        if len(part) == _BLOCK:
            out.append(_BLOCK + 1)
            out += part
        else:
            out.append(len(part) + 1)
            out += part
    return bytes(out)


def cobs_decode(encoded: bytes, /) -> bytes:
    """Return the message in `encoded`, which holds no delimiter.

    Parameters
    ----------
    encoded : bytes
        One encoded message.

    Returns
    -------
    bytes
        The message.

    Raises
    ------
    MessageError
        If there is a zero byte, or a code byte points beyond the end.
    """
    if not encoded:
        raise MessageError("empty COBS frame", rule="B2")
    out = bytearray()
    at = 0
    while at < len(encoded):
        code = encoded[at]
        block = encoded[at + 1 : at + code]
        if code == 0 or 0 in block:
            raise MessageError(f"zero byte inside a COBS frame of {len(encoded)} bytes", rule="B2")
        if len(block) != code - 1:
            raise MessageError(
                f"COBS code {code} at byte {at} points beyond the end of {len(encoded)} bytes",
                rule="B2",
            )
        out += block
        at += code
        if code <= _BLOCK and at < len(encoded):
            out.append(0)
    return bytes(out)


class CobsDecoder:
    """Splits a byte stream at its zero bytes, with bounded memory.

    Parameters
    ----------
    limit : int
        Longest encoded frame that is kept, delimiter not counted; a longer one is dropped
        up to the next delimiter.

    Attributes
    ----------
    damaged : int
        Frames that were no valid COBS.
    overlong : int
        Frames longer than `limit`.
    """

    def __init__(self, *, limit: int) -> None:
        self.limit = limit
        self.damaged = 0
        self.overlong = 0
        self._pending = bytearray()
        self._skipping = False

    def feed(self, data: bytes, /) -> list[bytes]:
        """Take bytes in pieces of any size.

        Parameters
        ----------
        data : bytes
            Next bytes of the line.

        Returns
        -------
        list of bytes
            The messages that they complete.
        """
        messages: list[bytes] = []
        *ends, rest = data.split(b"\0")
        for piece in ends:
            self._append(piece)
            self._finish(messages)
        self._append(rest)
        return messages

    def _append(self, piece: bytes) -> None:
        if self._skipping or len(self._pending) + len(piece) > self.limit:
            self._skipping = True
            self._pending.clear()
        else:
            self._pending += piece

    def _finish(self, messages: list[bytes]) -> None:
        if self._skipping:
            self.overlong += 1
        elif self._pending:  # empty frames are idle delimiters, not damage
            try:
                messages.append(cobs_decode(bytes(self._pending)))
            except MessageError:
                self.damaged += 1
        self._pending.clear()
        self._skipping = False
