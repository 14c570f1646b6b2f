# SPDX-License-Identifier: Apache-2.0
"""Streams of packets with known codes, and both kernels."""

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hueflight.ingest.kernels import Kernels, available
from hueflight_protocol import encode_frame

Codes = NDArray[np.uint16]
BACKENDS = available()


@pytest.fixture(params=sorted(BACKENDS))
def kernels(request: pytest.FixtureRequest) -> Kernels:
    """Each backend that is there."""
    return BACKENDS[request.param]


@pytest.fixture(scope="session")
def random_codes() -> Callable[..., Codes]:
    """Function: codes (frame, row, col), a share `occupancy` of them uniform, the others 0."""

    def make(
        rng: np.random.Generator, shape: tuple[int, int, int], *, code_bits: int, occupancy: float
    ) -> Codes:
        codes = rng.integers(1, 1 << code_bits, shape).astype(np.uint16)
        codes[rng.random(shape) >= occupancy] = 0
        return codes

    return make


@pytest.fixture(scope="session")
def stream() -> Callable[..., bytes]:
    """Function: packets of codes (frame, row, col) in sequence."""

    def encode(codes: Iterable[Codes], **fields: Any) -> bytes:
        return b"".join(
            encode_frame(frame, **({"sequence": i, "frame": i, "timestamp": 100 * i} | fields))
            for i, frame in enumerate(codes)
        )

    return encode


@pytest.fixture(scope="session")
def counted() -> Callable[[Codes, int], NDArray[np.intp]]:
    """Function: counts (row, col, code) of codes (frame, row, col), by the plainest means."""

    def count(codes: Codes, code_bits: int) -> NDArray[np.intp]:
        counts = np.zeros((*codes.shape[1:], 1 << code_bits), np.intp)
        row, col = np.indices(codes.shape[1:])
        for frame in codes:
            np.add.at(counts, (row, col, frame), 1)
        return counts

    return count
