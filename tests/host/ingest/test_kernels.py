# SPDX-License-Identifier: Apache-2.0
"""The kernels against the reference parser, and the compiled ones against those in NumPy."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hueflight.errors import KernelError
from hueflight.ingest import kernels as backends
from hueflight.ingest.kernels import ADD, STATE, TILE, Kernels, Scanned
from hueflight_protocol import (
    Event,
    Frame,
    PacketHeader,
    PacketParser,
    crc32c,
    encode_event,
    encode_frame,
)

BACKENDS = backends.available()
needs_c = pytest.mark.skipif("c" not in BACKENDS, reason="no compiled kernels here")
REPORTED = (
    *("packets", "frames", "aborted", "repeated", "damaged", "skipped_bytes"),
    *("missing", "restarts", "dropped", "dropped_before"),
)

geometries = st.tuples(st.integers(1, 24), st.integers(1, 24), st.integers(1, 12))
edits = st.lists(
    st.tuples(
        st.sampled_from(["flip", "cut", "insert", "truncate", "repeat"]),
        st.integers(0, 1 << 30),
        st.binary(min_size=1, max_size=40),
    ),
    max_size=4,
)


def through(
    kernels: Kernels, data: bytes, rows: int, cols: int, code_bits: int, *, final: bool, limit: int
) -> tuple[list[Any], np.ndarray]:
    """All that scanning and counting say about `data`, and the counts (pixel, code)."""
    state = np.zeros(len(STATE), np.int64)
    state[0] = 1
    chunks = np.zeros(1 << 14, np.uint64)
    headers, places = np.zeros((limit, 64), np.uint8), np.zeros((limit, 2), np.uint64)
    others = np.zeros((2, 2), np.uint64)
    out = np.zeros((rows * cols, 1 << code_bits), np.uint16)
    said: list[Any] = []
    position = 0
    while True:
        found = Scanned(
            *kernels.scan(
                data, position, final, rows, cols, code_bits, 0, limit, 0,
                state, chunks, headers, places, others,
            )
        )  # fmt: skip
        said += [found, state.tolist(), others[: found.others].tolist()]
        if found.frames:
            count = -(-rows * cols // found.run)
            table = chunks[: count * found.stride].reshape(count, found.stride)
            said += [table[:, : found.frames].tolist(), places[: found.frames].tolist()]
            said.append(headers[: found.frames].tobytes())
            done = np.zeros((count, -(-found.run // TILE)), np.uint8)
            chosen = np.arange(found.frames, dtype=np.uint32)
            counted = kernels.count(
                data, chunks, found.stride, chosen, rows * cols, code_bits, found.run,
                out, False, ADD, done, 0, count,
            )  # fmt: skip
            said += [counted, done.tolist()]
        position = found.position
        if found.ended:
            return said, out


def damaged(data: bytes, changes: list[tuple[str, int, bytes]]) -> bytes:
    """The stream with some of it changed."""
    for change, at, other in changes:
        at %= max(len(data), 1)
        if change == "flip":
            data = data[:at] + bytes([data[at] ^ other[0]]) + data[at + 1 :] if data else data
        elif change == "cut":
            data = data[:at] + data[at + len(other) :]
        elif change == "insert":
            data = data[:at] + other + data[at:]
        elif change == "repeat":
            data = data + data[at:]
        else:
            data = data[:at]
    return data


@needs_c
@settings(max_examples=150)
@given(
    geometry=geometries,
    run=st.sampled_from([8, 64, 72, 128, 512]),
    seed=st.integers(0, 1 << 32),
    occupancy=st.sampled_from([0.0, 0.05, 0.5, 0.95, 1.0]),
    changes=edits,
    final=st.booleans(),
    limit=st.integers(1, 5),
)
def test_compiled_and_numpy_say_the_same(
    geometry: tuple[int, int, int],
    run: int,
    seed: int,
    occupancy: float,
    changes: list[tuple[str, int, bytes]],
    final: bool,
    limit: int,
) -> None:
    data, _ = random_stream(geometry, run, seed, occupancy)
    data = damaged(data, changes)
    compiled = through(BACKENDS["c"], data, *geometry, final=final, limit=limit)
    numpy = through(BACKENDS["numpy"], data, *geometry, final=final, limit=limit)
    assert compiled[0] == numpy[0]
    np.testing.assert_array_equal(compiled[1], numpy[1])


@needs_c
@settings(max_examples=40)
@given(
    geometry=st.tuples(st.integers(1, 6), st.integers(1, 24), st.integers(1, 12)),
    seed=st.integers(0, 1 << 32),
    changes=edits,
    limit=st.sampled_from([1, 30, 100]),
)
def test_long_streams_are_scanned_the_same(
    geometry: tuple[int, int, int],
    seed: int,
    changes: list[tuple[str, int, bytes]],
    limit: int,
) -> None:
    """The NumPy backend scans many frames at once and must notice everything unusual among them."""
    rows, cols, code_bits = geometry
    rng = np.random.default_rng(seed)
    packets: list[bytes] = []
    for i in range(60):
        codes = rng.integers(1, 1 << code_bits, (rows, cols)).astype(np.uint16)
        codes[rng.random(codes.shape) >= rng.choice([0.0, 0.3, 1.0])] = 0
        odd = int(rng.integers(30))
        packets.append(
            encode_frame(
                codes,
                sequence=i + (5 if odd == 1 else 0),
                frame=i,
                timestamp=i,
                code_bits=code_bits,
                run=16 if odd == 2 else 64,
                dropped=i // 7,
                capture=i // 40,
                abort_at=0 if odd == 3 else None,
            )
        )
        if odd == 4:
            packets.append(packets[-1])
        if odd == 5:
            packets.append(encode_event(Event(PacketHeader(sequence=i + 1), code=5)))
    data = damaged(b"".join(packets), changes)
    compiled = through(BACKENDS["c"], data, *geometry, final=True, limit=limit)
    numpy = through(BACKENDS["numpy"], data, *geometry, final=True, limit=limit)
    assert compiled[0] == numpy[0]
    np.testing.assert_array_equal(compiled[1], numpy[1])


@settings(max_examples=100)
@given(
    geometry=geometries,
    run=st.sampled_from([8, 64, 72, 512]),
    seed=st.integers(0, 1 << 32),
    occupancy=st.sampled_from([0.0, 0.05, 0.5, 0.95, 1.0]),
    changes=edits,
)
@pytest.mark.parametrize("name", sorted(BACKENDS))
def test_same_packets_as_the_reference_parser(
    name: str,
    geometry: tuple[int, int, int],
    run: int,
    seed: int,
    occupancy: float,
    changes: list[tuple[str, int, bytes]],
) -> None:
    data, _ = random_stream(geometry, run, seed, occupancy)
    data = damaged(data, changes)
    said, counts = through(BACKENDS[name], data, *geometry, final=True, limit=100)
    state = dict(zip(STATE, last_state(said), strict=True))
    parser = PacketParser()
    packets = [*parser.feed(data), *parser.finish()]
    expected = np.zeros_like(counts)
    for packet in packets:
        if isinstance(packet.content, Frame):
            expected[np.arange(len(expected)), packet.content.codes.reshape(-1)] += 1
    assert {key: state[key] for key in REPORTED} == {
        key: getattr(parser.report, key) for key in REPORTED
    }
    np.testing.assert_array_equal(counts, expected)


def last_state(said: list[Any]) -> list[int]:
    """The state after the last call of `scan` in what `through` returns."""
    at = max(i for i, item in enumerate(said) if isinstance(item, Scanned))
    return said[at + 1]


def random_stream(
    geometry: tuple[int, int, int], run: int, seed: int, occupancy: float
) -> tuple[bytes, np.ndarray]:
    """A few frames of one geometry as packets, and their codes."""
    rows, cols, code_bits = geometry
    rng = np.random.default_rng(seed)
    codes = rng.integers(1, 1 << code_bits, (4, rows, cols)).astype(np.uint16)
    codes[rng.random(codes.shape) >= occupancy] = 0
    packets = [
        encode_frame(
            frame,
            sequence=i,
            frame=i,
            timestamp=i,
            code_bits=code_bits,
            run=run,
            dropped=i // 2,
            abort_at=0 if i == 2 and seed % 5 == 0 else None,
        )
        for i, frame in enumerate(codes)
    ]
    return b"".join(packets), codes


def test_every_code_width(
    kernels: Kernels, random_codes: Callable[..., Any], stream: Callable[..., bytes],
    counted: Callable[..., Any],
) -> None:  # fmt: skip
    rng = np.random.default_rng(5)
    for code_bits in range(1, 17):
        for occupancy in (0.1, 0.6, 1.0):
            codes = random_codes(rng, (3, 9, 17), code_bits=code_bits, occupancy=occupancy)
            data = stream(codes, code_bits=code_bits, run=64)
            _, counts = through(kernels, data, 9, 17, code_bits, final=True, limit=9)
            expected = counted(codes, code_bits).reshape(counts.shape)
            np.testing.assert_array_equal(counts, expected)


@pytest.mark.parametrize("code_bits", range(4, 17))
def test_few_hits_with_codes_close_together(
    kernels: Kernels, stream: Callable[..., bytes], counted: Callable[..., Any], code_bits: int
) -> None:
    """Crowded into one word of the bitmap or spread over it, and many in all."""
    rng = np.random.default_rng(code_bits)
    first = int(rng.integers(1, (1 << code_bits) - 12))
    codes = np.zeros((90, 4, 128), np.uint16)
    for i, frame in enumerate(codes):
        hits = int(rng.integers(1, 32))
        pixels = rng.choice(64 if i % 2 else 512, hits, replace=False)
        frame.reshape(-1)[pixels] = rng.integers(first, first + 12, hits)
    for run in (512, 200, 48):
        data = stream(codes, code_bits=code_bits, run=run)
        _, counts = through(kernels, data, 4, 128, code_bits, final=True, limit=90)
        expected = counted(codes, code_bits).reshape(counts.shape)
        np.testing.assert_array_equal(counts, expected)


@pytest.mark.parametrize("run", [1024, 2048, 4096])
def test_few_hits_in_long_chunks(
    kernels: Kernels, stream: Callable[..., bytes], counted: Callable[..., Any], run: int
) -> None:
    rng = np.random.default_rng(run)
    codes = np.zeros((20, 64, 64), np.uint16)
    for frame in codes:
        pixels = rng.choice(frame.size, 150, replace=False)
        frame.reshape(-1)[pixels] = rng.integers(300, 312, 150)
    data = stream(codes, run=run)
    _, counts = through(kernels, data, 64, 64, 9, final=True, limit=20)
    np.testing.assert_array_equal(counts, counted(codes, 9).reshape(counts.shape))


@needs_c
def test_crc_of_every_length() -> None:
    compiled: Any = BACKENDS["c"]
    octets = np.random.default_rng(0).bytes(7000)
    for size in (*range(1100), 3071, 3072, 3073, 6999, 7000):
        assert compiled.crc32c(octets[-size or 7000 :]) == crc32c(octets[-size or 7000 :])


def test_without_a_compiler_there_is_numpy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hueflight.backend.available", lambda name: False)
    assert list(backends.available()) == ["numpy"]


def test_choosing_a_backend(monkeypatch: pytest.MonkeyPatch) -> None:
    assert backends.choose("numpy") is BACKENDS["numpy"]
    monkeypatch.setenv("HUEFLIGHT_KERNELS", "numpy")
    assert backends.choose() is BACKENDS["numpy"]
    with pytest.raises(KernelError, match="implementation = 'fortran'"):
        backends.choose("fortran")
