# SPDX-License-Identifier: Apache-2.0
"""Byte streams between a link and the control engine."""

from __future__ import annotations

from amaranth.lib import data, stream

REQUEST_BYTE = data.StructLayout({"data": 8, "end": 1, "bad": 1})
"""A byte of a request. With `end` there is no byte: the request ends, and `bad` marks an error."""

RESPONSE_BYTE = data.StructLayout({"data": 8, "last": 1})
"""A byte of a response."""


def request_stream() -> stream.Signature:
    """Return the stream from a link; it is always ready, because a serial line cannot wait."""
    return stream.Signature(REQUEST_BYTE, always_ready=True)


def response_stream() -> stream.Signature:
    """Return the stream to a link."""
    return stream.Signature(RESPONSE_BYTE)
