# SPDX-License-Identifier: Apache-2.0
"""A message of planes: a JSON header, and arrays that a reader uses as they lie in memory.

A message is, in this order: four bytes, little-endian, with the size of the header; the header,
padded with spaces so that the planes begin on a multiple of 8 bytes; the planes, at the offsets
that the header states, each on a multiple of 8 bytes, padded with zeros.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from hueflight.errors import HueflightError
from hueflight.live.protocol import VERSION

#: types of planes, all little-endian; each is a typed array of JavaScript
TYPES = ("uint8", "uint16", "uint32", "float32", "float64")
_ALIGNMENT = 8


class MessageError(HueflightError, ValueError):
    """A message that can't be read."""


class VersionError(MessageError):
    """A message of another version of the format."""


@dataclass(frozen=True, eq=False)
class Plane:
    """One array of a message.

    Attributes
    ----------
    name : str
        Name of the array.
    values : array
        Its values, of one of the types `TYPES`.
    dims : tuple of str
        Names of its dimensions.
    attrs : mapping
        Attributes such as its unit, which JSON can hold.
    coordinate : bool
        True if the array is a coordinate of the others.
    """

    name: str
    values: NDArray[Any]
    dims: tuple[str, ...]
    attrs: Mapping[str, Any] = field(default_factory=dict)
    coordinate: bool = False


@dataclass(frozen=True, eq=False)
class Message:
    """A message that was read.

    Attributes
    ----------
    header : dict
        Everything in the header besides the list of planes.
    planes : dict of Plane
        The planes by name. Their values are views into the message.
    """

    header: dict[str, Any]
    planes: dict[str, Plane]


class _Entry(msgspec.Struct, frozen=True):
    """A plane in the header."""

    name: str
    type: str
    shape: list[int]
    offset: int
    dims: list[str]
    attrs: dict[str, Any] = {}
    coordinate: bool = False


def encode_message(header: Mapping[str, Any], planes: Iterable[Plane], /) -> bytes:
    """Return a message.

    Parameters
    ----------
    header : mapping
        What the header holds besides the version and the list of planes.
    planes : iterable of Plane
        The planes in their order.

    Returns
    -------
    bytes
        The message.

    Raises
    ------
    MessageError
        If a plane has a type that messages do not hold.
    """
    entries: list[dict[str, Any]] = []
    parts: list[bytes | memoryview] = []
    offset = 0
    for plane in planes:
        values = plane.values
        if values.dtype.name not in TYPES:
            raise MessageError(
                f"plane {plane.name!r} has type {values.dtype}: convert it to one of "
                f"{', '.join(TYPES)}"
            )
        data = np.ascontiguousarray(values, values.dtype.newbyteorder("<"))
        entries.append(
            {
                "name": plane.name,
                "type": values.dtype.name,
                "shape": list(values.shape),
                "offset": offset,
                "dims": list(plane.dims),
                "attrs": dict(plane.attrs),
                "coordinate": plane.coordinate,
            }
        )
        padding = -data.nbytes % _ALIGNMENT
        parts += [data.reshape(-1).view(np.uint8).data, bytes(padding)]
        offset += data.nbytes + padding
    content = {"version": VERSION, **header, "planes": entries}
    text = msgspec.json.encode(content, enc_hook=_plain)
    text += b" " * (-(4 + len(text)) % _ALIGNMENT)
    return b"".join([struct.pack("<I", len(text)), text, *parts])


def decode_message(message: bytes, /) -> Message:
    """Return the content of a message.

    Parameters
    ----------
    message : bytes
        The message.

    Returns
    -------
    Message
        Header and planes; nothing is copied.

    Raises
    ------
    VersionError
        If the message has another version than this software reads.
    MessageError
        If the message is cut short or contradicts itself.
    """
    if len(message) < 4:
        raise MessageError(f"the message has {len(message)} bytes: it was cut short")
    start = 4 + int.from_bytes(message[:4], "little")
    if start > len(message):
        raise MessageError(f"the header ends at byte {start} of {len(message)}: cut short")
    try:
        header = msgspec.json.decode(message[4:start], type=dict[str, Any])
        version = header.pop("version", None)
        if version != VERSION:
            raise VersionError(
                f"the message has version {version!r}, this software reads version {VERSION}: "
                "install the same version of hueflight on both sides"
            )
        entries = msgspec.convert(header.pop("planes", None), list[_Entry])
    except (msgspec.DecodeError, msgspec.ValidationError, UnicodeDecodeError) as error:
        raise MessageError(f"the header can't be read: {error}") from None
    return Message(header, {entry.name: _plane(message, start, entry) for entry in entries})


def _plane(message: bytes, start: int, entry: _Entry) -> Plane:
    if (
        entry.type not in TYPES
        or len(entry.dims) != len(entry.shape)
        or min(entry.shape, default=0) < 0
    ):
        raise MessageError(
            f"plane {entry.name!r} has type {entry.type!r}, shape {entry.shape} and dimensions "
            f"{entry.dims}, which do not fit together"
        )
    dtype = np.dtype(entry.type).newbyteorder("<")
    count = math.prod(entry.shape)
    begin = start + entry.offset
    if entry.offset < 0 or begin + count * dtype.itemsize > len(message):
        raise MessageError(f"plane {entry.name!r} reaches beyond the end of the message")
    values = np.frombuffer(message, dtype, count, begin).reshape(entry.shape)
    return Plane(entry.name, values, tuple(entry.dims), entry.attrs, entry.coordinate)


def _plain(value: Any) -> Any:
    """NumPy numbers as Python's, for JSON."""
    if isinstance(value, np.generic):
        return value.item()
    # what msgspec asks of such a hook for a type that it does not know
    raise NotImplementedError(f"JSON does not hold a {type(value).__name__}")
