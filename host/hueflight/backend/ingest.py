# SPDX-License-Identifier: Apache-2.0
"""Interface of the kernels that turn packets into histograms."""

from hueflight.backend.interface import Constant, Field, Interface, Record, ScalarFunction
from hueflight_protocol import wire

TILE = 64  #: pixels that are added to a histogram together or not at all
SCENE_TILE = 4  #: pixels on a side of a tile in which changes of the scene are looked for
SMOOTHINGS = 4  #: of counts, each with both halves of neighbors: weights 1, 4, 6, 4, 1
MOST_FRAMES = 65535  #: frames of one call, which the 16-bit counters of a tile can hold
HITS_SHIFT, KIND_SHIFT = 32, 48  #: in an entry of the table of chunks: offset, hits, kind
ADD, STORE, SATURATE, SUBTRACT = range(4)  #: what a call of count does with its counts

STATE = Record(
    "State",
    "What scanning carries from one piece of the stream to the next, and its totals.",
    tuple(
        Field(name, "int64")
        for name in (
            *("in_step", "has_sequence", "sequence", "has_dropped", "capture", "last_dropped"),
            *("packets", "frames", "aborted", "repeated", "foreign", "damaged", "skipped_bytes"),
            *("missing", "restarts", "dropped", "dropped_before", "hits"),
            *("foreign_rows", "foreign_cols", "foreign_bits"),
            *("masked", "roi", "gated", "saturated", "test_pattern", "simulated", "trigger_lost"),
        )
    ),
)

SCAN = ScalarFunction(
    "scan",
    "position, frames, others, run, stride, needed, ended",
    (
        *(("data", "O"), ("start", "n"), ("final", "p"), ("rows", "i"), ("cols", "i")),
        *(("code_bits", "i"), ("frames", "n"), ("limit", "n"), ("run", "i"), ("state", "O")),
        *(("chunks", "O"), ("headers", "O"), ("places", "O"), ("others", "O")),
    ),
)
COUNT = ScalarFunction(
    "count",
    "photons, clipped, pending",
    (
        *(("data", "O"), ("chunks", "O"), ("stride", "n"), ("chosen", "O"), ("pixels", "i")),
        *(("code_bits", "i"), ("run", "i"), ("out", "O"), ("wide", "p"), ("mode", "i")),
        *(("done", "O"), ("begin", "n"), ("end", "n")),
    ),
)
GROUP_COUNTS = ScalarFunction(
    "group_counts",
    "None",
    (
        *(("histogram", "O"), ("wide", "p"), ("rows", "n"), ("cols", "n"), ("codes", "n")),
        *(("group", "n"), ("leave_first", "p"), ("out", "O")),
    ),
)
GATHER = ScalarFunction(
    "gather",
    "None",
    (
        *(("total", "O"), ("total_wide", "p"), ("histogram", "O"), ("histogram_wide", "p")),
        *(("anew", "O"), ("rows", "n"), ("cols", "n"), ("codes", "n"), ("out", "O")),
        ("out_wide", "p"),
    ),
)
SIGNIFICANCE = ScalarFunction(
    "significance",
    "None",
    (
        *(("newest", "O"), ("earlier", "O"), ("ratio", "O"), ("rows", "n"), ("cols", "n")),
        *(("groups", "n"), ("size", "n"), ("window", "n"), ("brightness_tolerance", "d")),
        *(("shift_tolerance", "d"), ("out", "O")),
    ),
)

_HEADER_FIELDS = (
    *("type", "header_bytes", "length", "sequence", "timestamp", "frame", "dropped"),
    *("rows", "cols", "run", "code_bits", "flags", "step", "capture"),
)


def _wire_constants() -> dict[str, int]:
    """Return the numbers of the wire format, from the declarations of the protocol."""
    frame = wire.FRAME_HEADER
    return {f"AT_{name.upper()}": frame.offset(name) for name in _HEADER_FIELDS} | {
        "MAGIC": int.from_bytes(wire.MAGIC, "little"),
        "VERSION": wire.VERSION,
        "FRAME": int(wire.PacketType.FRAME),
        "LAST_KNOWN_TYPE": int(max(wire.PacketType)),
        "FRAME_HEADER": frame.size,
        "FRAME_TRAILER": wire.FRAME_TRAILER.size,
        "OTHER_HEADER": wire.PACKET_HEADER.size,
        "OTHER_TRAILER": wire.PACKET_TRAILER.size,
        "MAX_HEADER": wire.MAX_HEADER_BYTES,
        "MAX_BODY": wire.MAX_BODY_BYTES,
        "MAX_SIDE": max(wire.MAX_ROWS, wire.MAX_COLS),
        "MAX_BITS": wire.MAX_CODE_BITS,
        "MIN_RUN": wire.MIN_RUN,
        "MAX_RUN": wire.MAX_RUN,
        "MAX_CHUNKS": wire.MAX_CHUNKS,
        "KNOWN_FLAGS": int(sum(wire.FrameFlags)),
        "PAD": int(wire.ChunkKind.PAD),
        "BITMAP": int(wire.ChunkKind.BITMAP),
        "DENSE": int(wire.ChunkKind.DENSE),
        "END": int(wire.ChunkKind.END),
    }


INTERFACE = Interface(
    "ingest",
    (
        *(Constant(name, value) for name, value in _wire_constants().items()),
        Constant("TILE", TILE, "pixels that are added to a histogram together or not at all"),
        Constant("SCENE_TILE", SCENE_TILE, "pixels on a side of a tile of the scene"),
        Constant("SMOOTHINGS", SMOOTHINGS, "of counts, with both halves of neighbors"),
        Constant("MOST_FRAMES", MOST_FRAMES, "that the counters of a tile can hold"),
        Constant(
            "HITS_SHIFT", HITS_SHIFT, "in an entry of the table of chunks: offset, hits, kind"
        ),
        Constant("KIND_SHIFT", KIND_SHIFT),
        Constant("ADD", ADD),
        Constant("STORE", STORE),
        Constant("SATURATE", SATURATE),
        Constant("SUBTRACT", SUBTRACT),
    ),
    (STATE,),
    (SCAN, COUNT, GROUP_COUNTS, GATHER, SIGNIFICANCE),
)
