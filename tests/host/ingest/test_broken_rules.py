# SPDX-License-Identifier: Apache-2.0
"""Packets that break one rule of the wire format, though all of their check words are right.

Checksums reveal damage; these packets come from a faulty encoder. The reference parser says what
is to be made of them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from hueflight.ingest import kernels as backends
from hueflight.ingest.kernels import ADD, STATE, STORE, SUBTRACT, TILE, Kernels, Scanned
from hueflight_protocol import (
    Frame,
    PacketHeader,
    PacketParser,
    encode_frame,
    encode_packet,
    wire,
)
from hueflight_protocol.checksum import crc32c, xor_words

BACKENDS = backends.available()
needs_c = pytest.mark.skipif("c" not in BACKENDS, reason="no compiled kernels here")
ROWS, COLS, RUN = 8, 20, 64
HEADER, TRAILER = wire.FRAME_HEADER.size, wire.FRAME_TRAILER.size
REPORTED = ("packets", "frames", "damaged", "skipped_bytes", "missing", "restarts")
Change = Callable[[bytearray], object]


def sparse_codes(rows: int = ROWS, cols: int = COLS) -> np.ndarray:
    """Codes of a frame whose last pixel is the only one of its chunk that is lit."""
    codes = np.zeros((rows, cols), np.uint16)
    codes.reshape(-1)[[3, 7, 70, -1]] = (5, 300, 511, 17)
    return codes


def frame(sequence: int, codes: Any = None, **options: Any) -> bytes:
    numbers = {"frame": sequence, "timestamp": sequence, "run": RUN} | options
    return encode_frame(sparse_codes() if codes is None else codes, sequence=sequence, **numbers)


def mended(packet: bytes, change: Change) -> bytes:
    """The packet after a change, with the check words of its header and its end made right."""
    changed = bytearray(packet)
    change(changed)
    size = int.from_bytes(changed[6:8], "little")
    changed[size - 4 : size] = xor_words(changed[: size - 4]).to_bytes(4, "little")
    changed[-4:] = crc32c(changed[:-4]).to_bytes(4, "little")
    return bytes(changed)


def put(at: int, value: int, size: int) -> Change:
    """A change that stores a number at a byte."""

    def change(packet: bytearray) -> None:
        start = at % len(packet)
        packet[start : start + size] = value.to_bytes(size, "little")

    return change


def header_field(name: str, value: int) -> Change:
    field = next(field for field in wire.FRAME_HEADER.fields if field.name == name)
    return put(wire.FRAME_HEADER.offset(name), value, np.dtype(field.dtype).itemsize)


def chunk_word(kind: int, index: int, hits: int, at: int = HEADER) -> Change:
    return put(at, kind | index << 2 | hits << 16, 4)


END, PAD, DENSE, BITMAP = (int(wire.ChunkKind[name]) for name in ("END", "PAD", "DENSE", "BITMAP"))
OTHER = encode_packet(9, b"later", PacketHeader(sequence=1))  # three bytes of padding
# a frame of `sparse_codes`: where its three chunks and its padding word begin, and its end word
FIRST, SECOND, LAST, PADDING, TAIL = 64, 80, 96, 108, 112
BROKEN: dict[str, tuple[bytes, Change]] = {
    **{
        f"{name} = {value}": (frame(1), header_field(name, value))
        for name, value in (
            *(("rows", 0), ("rows", 1025), ("cols", 0), ("cols", 1025), ("code_bits", 0)),
            *(("code_bits", 17), ("run", 0), ("run", 60), ("run", 4104), ("length", 128)),
            ("flags", 0x8000),
        )
    },
    "more chunks than the format has": (
        frame(1),
        lambda p: [change(p) for change in (header_field("rows", 1024), header_field("cols", 1024),
                                            header_field("run", 8))],
    ),
    "a chunk beyond the frame": (frame(1), chunk_word(BITMAP, 3, 1, LAST)),
    "chunks in the wrong order": (frame(1), chunk_word(BITMAP, 0, 1, SECOND)),
    "a chunk without a hit": (frame(1), chunk_word(BITMAP, 1, 0, SECOND)),
    "more hits than pixels": (frame(1), chunk_word(DENSE, 2, 33, LAST)),
    "few hits in a dense chunk": (frame(1), chunk_word(DENSE, 2, 1, LAST)),
    "many hits in a bitmap": (frame(1), chunk_word(BITMAP, 2, 32, LAST)),
    "a padding word that is not 0": (frame(1), put(PADDING, 4, 4)),
    "a padding word that is not needed": (frame(1), put(SECOND, 0, 4)),
    "two padding words": (frame(1), put(PADDING + 4, 0, 4)),
    "an end that is not aligned": (frame(1), put(PADDING, END | 3 << 16, 4)),
    "an unknown status": (frame(1), chunk_word(END, 2, 3, TAIL)),
    "another number of chunks": (frame(1), chunk_word(END, 0, 2, TAIL)),
    "another number of hits": (frame(1), put(TAIL + 4, 5, 4)),
    "another length of a frame": (frame(1), put(TAIL + 8, 31, 4)),
    "a body that is too long": (OTHER, put(8, (1 << 20) + 1, 4)),
    "padding of a body that is not 0": (OTHER, put(32 + 7, 1, 1)),
    "another length": (OTHER, put(-8, 11, 4)),
}  # fmt: skip


def through(
    kernels: Kernels, data: bytes, *, final: bool = True, limit: int = 8, room: int = 1 << 10
) -> tuple[list[Any], np.ndarray]:
    """What scanning and counting say about frames of `ROWS` × `COLS`, and their counts."""
    state = np.zeros(len(STATE), np.int64)
    state[0] = 1
    chunks, out = np.zeros(room, np.uint64), np.zeros((ROWS * COLS, 512), np.uint16)
    headers, places = np.zeros((limit, 64), np.uint8), np.zeros((limit, 2), np.uint64)
    others, said = np.zeros((2, 2), np.uint64), []
    position = 0
    while True:
        found = Scanned(
            *kernels.scan(
                data, position, final, ROWS, COLS, 9, 0, limit, 0,
                state, chunks, headers, places, others,
            )
        )  # fmt: skip
        said += [found, state.tolist(), others[: found.others].tolist()]
        if found.frames:
            count = -(-ROWS * COLS // found.run)
            done = np.zeros((count, -(-found.run // TILE)), np.uint8)
            chosen = np.arange(found.frames, dtype=np.uint32)
            said.append(
                kernels.count(
                    data, chunks, found.stride, chosen, ROWS * COLS, 9, found.run,
                    out, False, ADD, done, 0, count,
                )
            )  # fmt: skip
        position = found.position
        if found.ended:
            return said, out


def by_parser(data: bytes) -> tuple[dict[str, int], np.ndarray]:
    """What the reference parser says, and the counts of the frames that fit the sensor."""
    parser = PacketParser()
    packets = [*parser.feed(data), *parser.finish()]
    counts = np.zeros((ROWS * COLS, 512), np.uint16)
    frames = [packet.content for packet in packets if isinstance(packet.content, Frame)]
    ours = [frame.codes.reshape(-1) for frame in frames if frame.codes.shape == (ROWS, COLS)]
    for codes in ours:
        counts[np.arange(len(counts)), codes] += 1
    said = {name: getattr(parser.report, name) for name in REPORTED}
    return said | {"frames": len(ours)}, counts


def last_state(said: list[Any]) -> dict[str, int]:
    at = max(i for i, item in enumerate(said) if isinstance(item, Scanned))
    return dict(zip(STATE, said[at + 1], strict=True))


def reported(said: list[Any]) -> dict[str, int]:
    return {name: last_state(said)[name] for name in REPORTED}


@pytest.mark.parametrize("name", BROKEN)
def test_the_packet_is_refused_and_the_next_one_is_found(kernels: Kernels, name: str) -> None:
    whole, change = BROKEN[name]
    data = frame(0) + mended(whole, change) + frame(2)
    said, counts = through(kernels, data)
    expected, wanted = by_parser(data)
    assert reported(said) == expected
    assert expected["frames"] == 2
    assert expected["damaged"] == 1
    np.testing.assert_array_equal(counts, wanted)


@pytest.mark.parametrize("size", [1, (1 << 16) - 3, 1 << 16, 70_000, 140_000])
def test_long_noise_between_two_packets(kernels: Kernels, size: int) -> None:
    noise = np.random.default_rng(size).bytes(size - 1) + wire.MAGIC[:1]
    data = frame(0) + noise + frame(1)
    said, counts = through(kernels, data)
    expected, wanted = by_parser(data)
    assert reported(said) == expected
    np.testing.assert_array_equal(counts, wanted)


@needs_c
@pytest.mark.parametrize("final", [True, False])
@pytest.mark.parametrize(
    "whole",
    [
        frame(1),
        frame(1, run=512),
        OTHER,
        frame(1, np.full((64, 64), 77), run=512),
        frame(1, np.tile(sparse_codes(), (20, 1)), run=512),
    ],
    ids=["small", "one chunk", "other", "long", "long and sparse"],
)
def test_a_packet_may_end_anywhere(whole: bytes, final: bool) -> None:
    """C and NumPy say the same, also how many bytes they wait for."""
    step = 1 if len(whole) < 200 else 29
    for size in range(0, len(whole), step):
        data = frame(0) + whole[:size]
        compiled = through(BACKENDS["c"], data, final=final)
        plain = through(BACKENDS["numpy"], data, final=final)
        assert compiled[0] == plain[0]
        if final:
            assert reported(compiled[0]) == by_parser(data)[0]


@pytest.mark.parametrize("room", [3, 7, 11])
def test_a_small_table_of_chunks(kernels: Kernels, room: int) -> None:
    """It holds 1, 2 or 3 frames of three chunks: scanning stops, and goes on."""
    data = b"".join(frame(i) for i in range(5))
    said, counts = through(kernels, data, room=room)
    expected, wanted = by_parser(data)
    assert next(found.frames for found in said if isinstance(found, Scanned)) == room // 3
    assert reported(said) == expected
    np.testing.assert_array_equal(counts, wanted)


def test_frames_with_too_many_chunks_for_the_table_are_foreign(kernels: Kernels) -> None:
    data = frame(0) + frame(1, run=8) + frame(2)
    said, counts = through(kernels, data, room=12)
    assert reported(said)["frames"] == 2
    assert last_state(said)["foreign"] == 1
    np.testing.assert_array_equal(counts, by_parser(frame(0) + frame(2))[1])


def test_frames_of_other_sensors_are_foreign(kernels: Kernels) -> None:
    others = [
        frame(1, np.ones((ROWS, COLS + 1), int)),
        frame(2, np.ones((ROWS + 1, COLS), int)),
        frame(3, np.ones((ROWS, COLS), int), code_bits=8),
    ]
    said, counts = through(kernels, frame(0) + b"".join(others) + frame(4))
    state = last_state(said)
    assert (state["frames"], state["foreign"], state["damaged"]) == (2, 3, 0)
    np.testing.assert_array_equal(counts, by_parser(frame(0) + frame(4))[1])


@pytest.mark.parametrize("run", [512, 64, 24])
@pytest.mark.parametrize("ones", [-1, 1, 5])
@pytest.mark.parametrize("frames", [1, 40])
def test_bitmaps_that_contradict_the_number_of_hits(run: int, ones: int, frames: int) -> None:
    """Whatever the bitmap holds, each pixel has as many counts as there are frames."""
    rng = np.random.default_rng(run + ones)
    packets = []
    for number in range(frames):
        codes = np.zeros((ROWS, COLS), np.uint16)
        lit = rng.choice(24, 6, replace=False)
        codes.reshape(-1)[lit] = rng.integers(200, 212, 6)

        def change(packet: bytearray, lit: Any = lit) -> None:
            dark = np.setdiff1d(np.arange(24), lit)
            for pixel in lit[:1] if ones < 0 else dark[:ones]:
                packet[FIRST + 4 + pixel // 8] ^= 1 << pixel % 8

        packets.append(mended(frame(number, codes, run=run), change))
    data = b"".join(packets)
    found = [through(kernels, data, limit=64) for kernels in BACKENDS.values()]
    for said, counts in found:
        assert reported(said)["frames"] == frames
        assert (counts.sum(axis=1) == frames).all()
        np.testing.assert_array_equal(counts, found[0][1])


# -- entries of the table of chunks that do not come from a scan -----------------------------------


def entry(offset: int, hits: int, kind: int) -> int:
    return offset | hits << 32 | kind << 48


def count_one(kernels: Kernels, value: int, chosen: Any = (0,), mode: int = ADD) -> Any:
    out = np.zeros((16, 8), np.uint16)
    done = np.full(1, mode == SUBTRACT, np.uint8)
    answer = kernels.count(
        bytes(64), np.full(1, value, np.uint64), 1, np.array(chosen, np.uint32), 16, 3, 16,
        out, False, mode, done, 0, 1,
    )  # fmt: skip
    return answer, out


@pytest.mark.parametrize(
    "value",
    [
        entry(0, 17, BITMAP),
        entry(0, 3, END),
        entry(0, 0, PAD) | 1,
        entry(60, 1, BITMAP),
        entry(1 << 31, 16, DENSE),
    ],
    ids=["more hits than pixels", "no such kind", "nothing at a place", "cut", "outside"],
)
def test_entries_outside_the_data_are_refused(kernels: Kernels, value: int) -> None:
    with pytest.raises(ValueError, match="a chunk lies outside the data"):
        count_one(kernels, value)


def test_an_entry_may_say_that_there_is_no_hit(kernels: Kernels) -> None:
    answer, out = count_one(kernels, entry(0, 0, BITMAP))
    assert answer == (0, 0, 0)
    assert (out[:, 0] == 1).all()
    assert out.sum() == 16


@pytest.mark.parametrize("mode", [ADD, STORE, SUBTRACT])
def test_no_frame_may_be_chosen(kernels: Kernels, mode: int) -> None:
    answer, out = count_one(kernels, entry(0, 1, BITMAP), chosen=(), mode=mode)
    assert answer == (0, 0, 0)
    assert not out.any()


def test_too_many_frames_at_once_are_refused(kernels: Kernels) -> None:
    with pytest.raises(ValueError, match="chosen frames out of range"):
        count_one(kernels, 0, chosen=np.zeros(1 << 16, np.uint32))


@needs_c
@pytest.mark.parametrize("name", ["data", "chunks", "chosen", "out", "done"])
def test_count_refuses_what_is_no_memory(name: str) -> None:
    arguments = {
        "data": bytes(64), "chunks": np.zeros(1, np.uint64), "stride": 1,
        "chosen": np.zeros(1, np.uint32), "pixels": 16, "code_bits": 3, "run": 16,
        "out": np.zeros((16, 8), np.uint16), "wide": False, "mode": ADD,
        "done": np.zeros(1, np.uint8), "begin": 0, "end": 1,
    } | {name: None}  # fmt: skip
    with pytest.raises(TypeError, match="NoneType"):
        BACKENDS["c"].count(*arguments.values())


@needs_c
def test_a_crc_is_that_of_memory() -> None:
    compiled: Any = BACKENDS["c"]
    with pytest.raises(TypeError, match="NoneType"):
        compiled.crc32c(None)
