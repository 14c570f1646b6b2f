# SPDX-License-Identifier: Apache-2.0
"""Timing of several functions in the same process, alternately; the best of many runs counts."""

from __future__ import annotations

import json
import platform
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hueflight_protocol import encode_frame

FRAMES_PER_SECOND = 18_600
PIXELS = 192 * 128
REAL_TIME = FRAMES_PER_SECOND * PIXELS  # pixels per second of the paper's chip at full rate
ROUNDS = 9


def best_of(
    contenders: dict[str, Callable[[], object]], *, rounds: int = ROUNDS
) -> dict[str, float]:
    """Seconds that each takes at best, taken in turn so that all see the same weather."""
    best = dict.fromkeys(contenders, float("inf"))
    for _ in range(rounds):
        for name, run in contenders.items():
            start = time.perf_counter()
            run()
            best[name] = min(best[name], time.perf_counter() - start)
    return best


def limits(*, megabytes: int = 64) -> dict[str, float]:
    """Seconds that this machine takes at best to read and to copy so much memory, one thread."""
    data = np.ones(megabytes << 17)  # float64
    copy = np.empty_like(data)
    name = f"{megabytes} MB"
    return best_of(
        {f"reading {name}": data.sum, f"copying {name}": lambda: np.copyto(copy, data)}, rounds=5
    )


def save(path: Path, tables: dict[str, dict[str, float]], *, kernel: str) -> None:
    """Write the seconds of every row of every table, with what they were measured on, as JSON."""
    about = {"kernel": kernel, "machine": platform.machine(), "processor": processor()}
    record = {"format": 1, **about, "limits": limits(), "tables": tables}
    path.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")


def processor() -> str:
    """Name of the processor, as far as the system tells."""
    listed = Path("/proc/cpuinfo")
    if listed.exists():
        for line in listed.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor()


def uniform_codes(
    frames: int, rows: int, cols: int, occupancy: float, *, seed: int = 1
) -> Iterator[NDArray[np.uint16]]:
    """Frames in which a share of the pixels has a code, any with the same probability.

    Real codes crowd around the pulses; these are spread over all counters, which is harder.
    """
    rng = np.random.default_rng(seed)
    for _ in range(frames):
        codes = rng.integers(1, 499, (rows, cols)).astype(np.uint16)
        codes[rng.random((rows, cols)) >= occupancy] = 0
        yield codes


def packets_of(codes: Iterator[NDArray[np.uint16]], *, code_bits: int = 9) -> bytes:
    """Packets of frames in sequence."""
    return b"".join(
        encode_frame(frame, sequence=i, frame=i, timestamp=i, code_bits=code_bits)
        for i, frame in enumerate(codes)
    )


def per_pixel(seconds: float, pixels: int) -> str:
    """Nanoseconds per pixel, and how many times real time that is."""
    return f"{seconds / pixels * 1e9:.3f} ns/px = {pixels / seconds / REAL_TIME:.2f} × RT"


def table(head: list[str], rows: list[list[str]]) -> str:
    """A Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"
