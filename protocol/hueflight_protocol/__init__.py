# SPDX-License-Identifier: Apache-2.0
"""The contract between camera, illuminator and host: packets, control messages, registers.

The specification is ``docs/protocol.md``; what is declared here is its definition.

>>> import numpy as np
>>> codes = np.arange(16, dtype=np.uint16).reshape(2, 8)
>>> packet = encode_frame(codes, sequence=0, frame=0, timestamp=0)
>>> frame = decode_frame(packet)
>>> frame.header.rows, frame.header.cols, bool((frame.codes == codes).all())
(2, 8, True)

A stream in pieces, damaged on the way:

>>> parser = PacketParser()
>>> found = parser.feed(b"noise" + packet[:70]) + parser.feed(packet[70:])
>>> len(found), parser.report.frames, parser.report.skipped_bytes
(1, 1, 5)
"""

from .camera_map import camera_map
from .checksum import crc32c, xor_words
from .cobs import CobsDecoder, cobs_decode, cobs_encode
from .control import (
    Op,
    Request,
    Response,
    Result,
    decode_request,
    decode_response,
    encode_request,
    encode_response,
    serial_frame,
)
from .errors import (
    AbortedFrameError,
    HueflightError,
    MessageError,
    PacketError,
    ProtocolError,
    RegisterError,
)
from .frame import Frame, FrameHeader
from .frame_decoder import decode_frame
from .frame_encoder import encode_frame
from .illuminator_map import illuminator_map
from .packet_header import PacketHeader
from .packets import (
    Event,
    Opaque,
    Status,
    TestPattern,
    decode_packet,
    encode_event,
    encode_packet,
    encode_status,
    encode_sums,
    encode_test_pattern,
)
from .parser import Damage, Packet, PacketParser, ParserReport
from .reduction import ReductionTables, reduce_codes, reduce_histogram
from .reduction_registers import ReductionMode, ReductionRoom
from .register_file import RegisterFile
from .register_value import RegisterValue
from .registers import Access, Field, Place, Register, RegisterMap, Reserved
from .sums_packet import Sums
from .sums_pictures import PictureAssembler, SumsPicture
from .wire import (
    CHUNK_WORD,
    DEFAULT_RUN,
    END_WORD,
    FRAME_HEADER,
    FRAME_TRAILER,
    MAGIC,
    MAX_PACKET_BYTES,
    PACKET_HEADER,
    PACKET_TRAILER,
    VERSION,
    ChunkKind,
    EventCode,
    EventLevel,
    FrameFlags,
    PacketType,
    PatternKind,
    TrailerStatus,
)

__all__ = [
    "CHUNK_WORD",
    "DEFAULT_RUN",
    "END_WORD",
    "FRAME_HEADER",
    "FRAME_TRAILER",
    "MAGIC",
    "MAX_PACKET_BYTES",
    "PACKET_HEADER",
    "PACKET_TRAILER",
    "VERSION",
    "AbortedFrameError",
    "Access",
    "ChunkKind",
    "CobsDecoder",
    "Damage",
    "Event",
    "EventCode",
    "EventLevel",
    "Field",
    "Frame",
    "FrameFlags",
    "FrameHeader",
    "HueflightError",
    "MessageError",
    "Op",
    "Opaque",
    "Packet",
    "PacketError",
    "PacketHeader",
    "PacketParser",
    "PacketType",
    "ParserReport",
    "PatternKind",
    "PictureAssembler",
    "Place",
    "ProtocolError",
    "ReductionMode",
    "ReductionRoom",
    "ReductionTables",
    "Register",
    "RegisterError",
    "RegisterFile",
    "RegisterMap",
    "RegisterValue",
    "Request",
    "Reserved",
    "Response",
    "Result",
    "Status",
    "Sums",
    "SumsPicture",
    "TestPattern",
    "TrailerStatus",
    "camera_map",
    "cobs_decode",
    "cobs_encode",
    "crc32c",
    "decode_frame",
    "decode_packet",
    "decode_request",
    "decode_response",
    "encode_event",
    "encode_frame",
    "encode_packet",
    "encode_request",
    "encode_response",
    "encode_status",
    "encode_sums",
    "encode_test_pattern",
    "illuminator_map",
    "reduce_codes",
    "reduce_histogram",
    "serial_frame",
    "xor_words",
]
