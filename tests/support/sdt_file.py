# SPDX-License-Identifier: Apache-2.0
"""SDT files after the structures of the format."""

import io
import struct
import zipfile
from pathlib import Path
from typing import Any

from numpy.typing import NDArray


def write_sdt(
    path: Path,
    blocks: list[NDArray[Any]],
    bin_width_s: float,
    *,
    kind: int = 0x01,
    routed: int = 1,
) -> None:
    """A minimal "SPC Setup & Data File", after SPC_data_file_structure.h of Becker & Hickl.

    Byte layout: file header, information text, one measurement description (its first part,
    up to the scan sizes), then data blocks with their headers. Bits of `kind` are the creation,
    content, data type and compression of the blocks; `routed` channels are in each block.
    """
    rows, cols, bins = blocks[0].shape[-3:]
    info = b"*IDENTIFICATION\r\n  ID        : SPC Setup & Data File\r\n*END\r\n\r\n"
    measure = b"".join((
        struct.pack("<9s11s16sh", b"12:00:00", b"2024-01-01", b"3D0001", 9),
        struct.pack("<4f", 0, 0, 0, 0),  # cfd
        struct.pack("<fhf", 0, 1, 0),  # syn
        struct.pack("<fh3f", bin_width_s * bins, 1, 0, 0, 0),  # tac_r, tac_g, …
        struct.pack("<hhhhHff", bins, 0, 1, 1, 1, 1.0, 1.0),  # adc_re, …
        struct.pack("<hBhHfhhh16sf", 0, 0, 0, 0, 0, 0, 0, 0, b"SPC-150", 0),
        struct.pack("<6h4if2h", 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0),
        struct.pack("<4i", cols, rows, routed, 1),  # scan_x, scan_y, scan_rx, scan_ry
    ))  # fmt: skip
    header_size, block_size = 42, 22
    info_at = header_size
    measure_at = info_at + len(info)
    data_at = measure_at + len(measure)
    revision = (0x28 << 4) | 15  # SPC-150
    header = struct.pack(
        "<hihiHihIihhHIHH", revision, info_at, len(info), 0, 0, data_at, len(blocks),
        blocks[0].nbytes, measure_at, 1, len(measure), 0x5555, 0, 0, 0x55AA,
    )  # fmt: skip
    assert len(header) == header_size
    content, offset = [header, info, measure], data_at
    for number, block in enumerate(blocks):
        stored = block.tobytes()
        if kind & 0x1000:
            packed = io.BytesIO()
            with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
                archive.writestr("data_block", stored)
            stored = packed.getvalue()
        following = offset + block_size + len(stored)
        content.append(
            struct.pack(
                "<BBIIHhII", 0, 0, offset + block_size, following, kind, 0, number, block.nbytes
            )
        )
        content.append(stored)
        offset = following
    path.write_bytes(b"".join(content))
