# SPDX-License-Identifier: Apache-2.0
"""Tables and offsets for the reduction of a simulated camera, and the pictures that it sends."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from hueflight_protocol import PacketParser, PictureAssembler, ReductionMode, Sums, SumsPicture
from hueflight_protocol.reduction import ReductionTables, offsets_hash

from .camera import SimulatedCamera


def load_tables(camera: SimulatedCamera, tables: ReductionTables, /) -> None:
    """Store tables in a camera, with the range of their codes and the widths of their sums.

    Parameters
    ----------
    camera : SimulatedCamera
        A camera with a reduction.
    tables : ReductionTables
        Of as many sums as the camera has room for, at most.
    """
    entries = np.zeros((tables.sums + tables.sums % 2, tables.entries.shape[1]), np.uint32)
    entries[: tables.sums] = tables.entries
    words = (entries[::2] | entries[1::2] << 16).T
    for code, some in enumerate(words.tolist()):
        camera.write_words("reduction_entries", some)
        camera.write("reduction_store", value=code)
    camera.write_words("reduction_width", list(tables.widths))
    camera.write("reduction_codes", first=tables.first, last=tables.last)
    camera.write("reduction_tables", value=tables.hash)


def load_offsets(camera: SimulatedCamera, offsets: NDArray[np.integer], /) -> None:
    """Store the offsets of all pixels.

    Parameters
    ----------
    camera : SimulatedCamera
        A camera with a reduction.
    offsets : ndarray of int, shape (pixel,)
        Offset of each pixel, codes.
    """
    group = camera.read("reduction_room")["group"]
    words = offsets.astype(np.int8).view("<u4").reshape(-1, group // 4)
    for number, some in enumerate(words.tolist()):
        camera.write_words("reduction_offsets", some)
        camera.write("reduction_move", value=number)
    camera.write("reduction_moved", value=offsets_hash(offsets))


def choose_sums(
    camera: SimulatedCamera, tables: ReductionTables, /, *, frames: int, with_codes: bool = False
) -> None:
    """Have a camera send sums in its next capture.

    Parameters
    ----------
    camera : SimulatedCamera
        A camera that `load_tables` was called for.
    tables : ReductionTables
        The same tables.
    frames : int
        Frames of a picture.
    with_codes : bool
        Whether codes are sent as well.
    """
    camera.write("reduction_frames", value=frames)
    mode = ReductionMode.BOTH if with_codes else ReductionMode.SUMS
    camera.write("reduction", mode=mode, sums=tables.sums)


def packets_of(data: bytes, /) -> list:
    """Return the contents of the packets in the bytes of a link.

    Parameters
    ----------
    data : bytes
        Whole packets.

    Returns
    -------
    list
        Contents, in order.
    """
    parser = PacketParser()
    return [packet.content for packet in (*parser.feed(data), *parser.finish())]


def pictures_of(contents: Iterable, /) -> Iterator[SumsPicture]:
    """Yield the pictures among the contents of packets.

    Parameters
    ----------
    contents : iterable
        Contents, in order.

    Yields
    ------
    SumsPicture
        A picture.
    """
    assembler = PictureAssembler()
    for content in contents:
        if isinstance(content, Sums):
            picture = assembler.feed(content)
            if picture is not None:
                yield picture
