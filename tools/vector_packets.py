# SPDX-License-Identifier: Apache-2.0
"""Golden vectors of the stream from camera to host, all of them intact."""

from collections.abc import Iterator
from typing import Any

import numpy as np

import hueflight_protocol as hp
from hueflight_protocol.wire import dense_from
from vector_stream import Codes, Stream, Vector, random_codes


def one_frame(name: str, about: str, codes: Codes, **options: Any) -> Vector:
    """Return the vector of a single frame."""
    stream = Stream(about)
    stream.frame(codes, **options)
    return stream.finished(name)


def chunk_forms() -> Iterator[Vector]:
    """Yield every chunk form, and the choice between them."""
    dark = np.zeros((8, 32), np.uint16)
    yield one_frame("frame-empty", "No photon: no chunk at all.", dark)
    few = dark.copy()
    few[2, 3], few[7, 31] = 511, 1
    yield one_frame("frame-bitmap", "Two bitmap chunks with one hit each.", few)
    yield one_frame("frame-dense", "All chunks dense.", random_codes(1, 8, 32, 1.0))
    mixed = dark.copy()
    mixed[0:2] = random_codes(2, 2, 32, 1.0)
    mixed[4:6] = random_codes(3, 2, 32, 0.3)
    yield one_frame("frame-mixed", "Dense, nothing, bitmap, nothing.", mixed)
    for offset, word in ((-1, "bitmap"), (0, "dense")):
        hits = dense_from(64, 9) + offset
        edge = np.zeros(64, np.uint16)
        edge[:hits] = 1 + np.arange(hits)
        about = f"{hits} hits in a run of 64: the choice falls on {word}."
        yield one_frame(f"frame-threshold-{word}", about, edge.reshape(1, 64))
    for percent in (5, 30, 100):
        codes = random_codes(100 + percent, 192, 128, percent / 100)
        about = f"The paper's sensor at the default run, {percent} % of its pixels lit."
        yield one_frame(f"frame-192x128-{percent:03d}", about, codes, run=512)


def geometries() -> Iterator[Vector]:
    """Yield edge geometries and run lengths."""
    for rows, cols, run, occupancy, about in (
        (1, 1, 512, 0.0, "The smallest frame, dark."),
        (1, 1, 512, 1.0, "The smallest frame, lit."),
        (1, 7, 8, 0.5, "A run shorter than the run length; unused bitmap bits."),
        (3, 5, 8, 0.6, "The last of two runs has seven pixels."),
        (5, 13, 16, 1.0, "Dense, the last run has one pixel."),
        (1, 1024, 512, 0.2, "One row of the largest width."),
        (1024, 1, 256, 0.2, "One column of the largest height."),
        (31, 33, 128, 0.5, "The last run has 127 pixels."),
        (16, 32, 8, 0.4, "The shortest run length."),
        (64, 80, 4096, 0.1, "The longest run length; the last run is short."),
    ):
        codes = random_codes(rows * 1031 + cols, rows, cols, occupancy)
        lit = "" if occupancy not in (0.0, 1.0) else ("-dark" if occupancy == 0.0 else "-lit")
        yield one_frame(f"geometry-{rows}x{cols}-run{run}{lit}", about, codes, run=run)
    sparse = np.zeros((1024, 1024), np.uint16)
    for pixel in (0, 1, 1023, 1024, 524_288, 1_048_575):
        sparse[divmod(pixel, 1024)] = 1 + pixel % 511
    about = "The largest geometry with the shortest run it allows; indices up to 16383."
    yield one_frame("geometry-1024x1024-sparse", about, sparse, run=64)


def code_widths() -> Iterator[Vector]:
    """Yield every code width, bitmap and dense runs in one frame."""
    for width in range(1, 17):
        codes = np.concatenate(
            [
                random_codes(200 + width, 4, 24, 0.2, code_bits=width),
                random_codes(300 + width, 4, 24, 1.0, code_bits=width),
            ]
        )
        codes[0, 0] = (1 << width) - 1
        about = f"Codes of {width} bits, sparse and dense runs, the largest code first."
        yield one_frame(f"width-{width:02d}", about, codes, run=32, code_bits=width)


def headers() -> Iterator[Vector]:
    """Yield header fields at their extremes."""
    codes = random_codes(4, 4, 16, 0.5)
    stream = Stream("Every header field at its largest value, every flag set.", (1 << 32) - 1)
    stream.frame(
        codes,
        frame=(1 << 64) - 1,
        timestamp=(1 << 64) - 1,
        periods=(1 << 32) - 1,
        dropped=(1 << 32) - 1,
        geometry=255,
        flags=sum(hp.FrameFlags),
        step=65535,
        capture=(1 << 32) - 1,
        clock_hz=(1 << 32) - 1,
    )
    yield stream.finished("header-largest", dropped_before=(1 << 32) - 1)
    for flag in hp.FrameFlags:
        name = flag.name or ""
        yield one_frame(
            f"flag-{name.lower().replace('_', '-')}", f"Flag {name}.", codes, flags=flag
        )


def other_packets() -> Iterator[Vector]:
    """Yield packets that are not frames."""
    for code in hp.EventCode:
        stream = Stream(f"Event {code.name}.")
        stream.event(code=int(code), level=int(code) % 3, count=int(code), value=-1000 * code)
        yield stream.finished(f"event-{code.name.lower().replace('_', '-')}")
    stream = Stream("An event code that version 1 does not know: delivered as a number.")
    stream.event(code=65535, level=2, count=(1 << 32) - 1, value=-(1 << 63))
    yield stream.finished("event-unknown-code")
    stream = Stream("Status, temperature measured, then not measured.")
    stream.status(frames_sent=1 << 40, frames_dropped=2, temperature_mdeg=-5250)
    stream.status(frames_aborted=3, triggers_lost=4, stall_clocks=5, buffer_peak=6)
    yield stream.finished("status")
    stream = Stream("Test packets: counter across its wrap, xorshift32, one word alone.")
    stream.test(hp.PatternKind.COUNTER, (1 << 32) - 3, 16)
    stream.test(hp.PatternKind.XORSHIFT, 1, 33)
    stream.test(hp.PatternKind.COUNTER, 0, 1)
    yield stream.finished("test-patterns")
    stream = Stream("A test packet with wrong words under a right CRC: intact, errors counted.")
    stream.test(hp.PatternKind.COUNTER, 5, 16, wrong=2)
    yield stream.finished("test-pattern-errors")
    stream = Stream("Reserved types: the first, an unknown type with a longer header, no body.")
    stream.opaque(6, bytes(range(11)))
    stream.opaque(200, b"later", header_bytes=48)
    stream.opaque(255, b"")
    yield stream.finished("opaque-types")
    stream = Stream("Sums: two packets of a picture, widths from 1 to 32 bits, saturated pixels.")
    stream.sums((3, 5), 0, 9, (1, 9, 32, 7, 12), picture=4, frames=620, photons=1 << 40)
    stream.sums((3, 5), 9, 6, (1, 9, 32, 7, 12), picture=4, frames=620, photons=1 << 40)
    stream.sums((1, 1), 0, 1, (16,), frames=1, missed=2, offsets=3, flags=hp.FrameFlags.MASKED)
    stream.sums((1024, 1024), 1_048_570, 6, (20,) * 32, code_bits=16, periods=168)
    yield stream.finished("sums")


def streams() -> Iterator[Vector]:
    """Yield streams that are whole but in which something must be counted."""
    codes = [random_codes(10 + k, 4, 32, 0.4) for k in range(4)]
    stream = Stream("All packet types one after another.")
    stream.event(code=1)
    stream.frame(codes[0])
    stream.status(frames_sent=1)
    stream.frame(codes[1], step=1)
    stream.test(hp.PatternKind.XORSHIFT, 9, 4)
    stream.opaque(6, b"counts")
    yield stream.finished("stream-all-types")
    for name, run, about in (
        ("first", 0, "A frame aborted before its first run."),
        ("middle", 1, "A frame aborted after its first run."),
        ("last", 2, "A frame aborted after its last run."),
    ):
        stream = Stream(about + " Well-formed, counted, not delivered.")
        stream.frame(codes[0])
        stream.frame(codes[1], abort_at=run)
        stream.frame(codes[2])
        yield stream.finished(f"aborted-{name}")
    stream = Stream("The camera dropped 3 frames, then 2; new captures begin at 1 and 5.")
    stream.frame(codes[0], frame=4, dropped=4)
    stream.frame(codes[1], frame=8, dropped=7)
    stream.frame(codes[2], frame=11, dropped=9)
    stream.frame(codes[3], frame=1, dropped=1, capture=8)
    stream.frame(codes[0], frame=5, dropped=5, capture=9)
    yield stream.finished("stream-dropped", dropped_before=4, dropped=3 + 2 + 1 + 5)
    stream = Stream("Packets 1 to 3 never came.")
    stream.frame(codes[0])
    stream.sequence = 4
    stream.frame(codes[1])
    yield stream.finished("stream-missing", missing=3)
    stream = Stream("The sequence number wraps: nothing is missing.", (1 << 32) - 1)
    stream.frame(codes[0])
    stream.frame(codes[1], frame=1)
    yield stream.finished("stream-wrap")
    stream = Stream("The sequence number steps back: the device was reset.", 1000)
    stream.frame(codes[0], frame=0)
    stream.sequence = 0
    stream.frame(codes[1])
    yield stream.finished("stream-restart", restarts=1)
    stream = Stream("A packet came twice: delivered once.")
    packet = stream.frame(codes[0])
    stream.data += packet
    stream.frame(codes[1])
    yield stream.finished("stream-repeated", packets=3, repeated=1)


def packet_vectors() -> Iterator[Vector]:
    """Yield all intact vectors of the stream from camera to host."""
    yield from chunk_forms()
    yield from geometries()
    yield from code_widths()
    yield from headers()
    yield from other_packets()
    yield from streams()
