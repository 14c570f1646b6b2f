# SPDX-License-Identifier: Apache-2.0
"""Small recordings with known codes."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hueflight.recording import RecordingWriter
from hueflight_protocol import encode_frame

Make = Callable[..., Any]


def _fields(i: int) -> dict[str, Any]:
    return {"sequence": i, "frame": i, "timestamp": 1000 + 100 * i, "step": i % 3} | {
        "clock_hz": 10_000
    }


@pytest.fixture(scope="session")
def frames() -> Callable[..., list[bytes]]:
    """Function: packets of frames (8 × 8), each with codes of its own, three steps in turn."""

    def make(count: int, *, first: int = 0, **fields: Any) -> list[bytes]:
        rng = np.random.default_rng(first)
        codes = rng.integers(0, 512, (count, 8, 8)) * (rng.random((count, 8, 8)) < 0.5)
        return [
            encode_frame(frame, **(_fields(i) | fields)) for i, frame in enumerate(codes, first)
        ]

    return make


@pytest.fixture
def recorded(tmp_path: Path, small: Make, frames: Make) -> Callable[..., tuple[Path, list[bytes]]]:
    """Function: a finished recording and its packets; options go to the writer."""

    def make(count: int = 50, name: str = "run.mcap", **options: Any) -> tuple[Path, list[bytes]]:
        packets = frames(count)
        path = tmp_path / name
        with RecordingWriter(path, small(), **options) as writer:
            for packet in packets:
                writer.write(packet)
        return path, packets

    return make
