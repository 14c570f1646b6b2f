# SPDX-License-Identifier: Apache-2.0
"""The compiled kernels refuse arguments that do not fit one another, and change nothing."""

from typing import Any

import numpy as np
import pytest

from hueflight.ingest import kernels as backends
from hueflight.ingest.kernels import ADD, MOST_FRAMES, STATE

BACKENDS = backends.available()
pytestmark = pytest.mark.skipif("c" not in BACKENDS, reason="no compiled kernels here")

ROWS, COLS, BITS, RUN, LIMIT = 4, 8, 3, 16, 5
CHUNKS = ROWS * COLS // RUN


def scan_arguments() -> dict[str, Any]:
    return {
        "data": bytes(64),
        "start": 0,
        "final": True,
        "rows": ROWS,
        "cols": COLS,
        "code_bits": BITS,
        "frames": 0,
        "limit": LIMIT,
        "run": 0,
        "state": np.zeros(len(STATE), np.int64),
        "chunks": np.zeros(CHUNKS * LIMIT, np.uint64),
        "headers": np.zeros((LIMIT, 64), np.uint8),
        "places": np.zeros((LIMIT, 2), np.uint64),
        "others": np.zeros((3, 2), np.uint64),
    }


def count_arguments() -> dict[str, Any]:
    return {
        "data": bytes(64),
        "chunks": np.zeros(CHUNKS * LIMIT, np.uint64),
        "stride": LIMIT,
        "chosen": np.zeros(1, np.uint32),
        "pixels": ROWS * COLS,
        "code_bits": BITS,
        "run": RUN,
        "out": np.zeros((ROWS * COLS, 1 << BITS), np.uint16),
        "wide": False,
        "mode": ADD,
        "done": np.zeros(CHUNKS, np.uint8),
        "begin": 0,
        "end": CHUNKS,
    }


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        *(("start", value, "range|needs") for value in (-1, 65)),
        *(("rows", value, "range") for value in (0, 1025)),
        *(("cols", value, "range") for value in (0, 1025)),
        *(("code_bits", value, "range") for value in (0, 17)),
        *(("frames", value, "range") for value in (-1, LIMIT + 1)),
        *(("limit", value, "range") for value in (0, MOST_FRAMES + 1)),
        *(("run", value, "range") for value in (-8, 12, 1 << 20)),
        *(
            (name, np.zeros(0, np.uint8), "fewer")
            for name in ("state", "chunks", "headers", "places", "others")
        ),
    ],
)
def test_scan_refuses(name: str, value: Any, said: str) -> None:
    arguments = scan_arguments() | {name: value}
    with pytest.raises(ValueError, match=said):
        BACKENDS["c"].scan(*arguments.values())


def test_scan_refuses_more_frames_than_the_table_of_chunks_holds() -> None:
    arguments = scan_arguments() | {"run": 8, "frames": LIMIT}
    with pytest.raises(ValueError, match="more frames than the table"):
        BACKENDS["c"].scan(*arguments.values())


@pytest.mark.parametrize("name", ["data", "state", "chunks", "headers", "places", "others"])
def test_scan_refuses_what_is_no_memory(name: str) -> None:
    arguments = scan_arguments() | {name: None}
    with pytest.raises(TypeError):
        BACKENDS["c"].scan(*arguments.values())


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        *(("stride", value, "range") for value in (0, 1 << 31)),
        *(("pixels", value, "range") for value in (0, 1024 * 1024 + 1)),
        *(("code_bits", value, "range") for value in (0, 17)),
        *(("run", value, "range") for value in (0, 12, 1 << 20)),
        *(("mode", value, "range") for value in (-1, 99)),
        *(("begin", value, "range") for value in (-1, CHUNKS + 1)),
        ("end", CHUNKS + 1, "range"),
        *((name, np.zeros(0, np.uint8), "fewer") for name in ("chunks", "out", "done")),
        ("chosen", np.full(1, LIMIT, np.uint32), "chosen frames"),
        ("chosen", np.zeros(MOST_FRAMES + 1, np.uint32), "chosen frames"),
    ],
)
def test_count_refuses(name: str, value: Any, said: str) -> None:
    arguments = count_arguments() | {name: value}
    counts = arguments["out"]
    with pytest.raises(ValueError, match=said):
        BACKENDS["c"].count(*arguments.values())
    assert not counts.any()


def test_count_refuses_a_chunk_outside_the_data() -> None:
    arguments = count_arguments()
    arguments["chunks"][:] = np.uint64(0xFFFF_FFFF_FFFF_FFFF)
    with pytest.raises(ValueError, match="outside the data"):
        BACKENDS["c"].count(*arguments.values())


@pytest.mark.parametrize("function", ["scan", "count"])
def test_a_call_without_arguments_is_refused(function: str) -> None:
    with pytest.raises(TypeError):
        getattr(BACKENDS["c"], function)()
