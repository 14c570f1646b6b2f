# SPDX-License-Identifier: Apache-2.0
"""Work that calls every function of every kernel, on a small instrument."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np

import hueflight as hf
from hueflight.backend import KERNELS, compiled
from hueflight.ingest import accumulate
from hueflight.ingest.gathered_sum import GatheredSum
from hueflight.reconstruction.bounds import expected_shares
from hueflight.reconstruction.edges import find_edges
from hueflight.reconstruction.video import Video
from hueflight_protocol import encode_frame

ROWS, COLS = 16, 12
PIXEL_ANGLE = 1e-3


def small_instrument() -> hf.Instrument:
    """Return the published instrument with few pixels."""
    paper = hf.Instrument.load("paper")
    sensor = msgspec.structs.replace(paper.sensor, rows=ROWS, cols=COLS)
    return paper.replace(sensor=sensor, lens=None)


def draw(
    instrument: hf.Instrument,
    photons: float,
    *,
    depth: float,
    seed: int,
    background: float | None = None,
) -> Any:
    """Draw counts of a plane; the background is by default a tenth of its light."""
    shares, _, widths = expected_shares(instrument, depth)
    brightness = instrument.band_brightness()
    stray = 0.1 * photons if background is None else background
    mean = brightness / brightness.sum() * photons @ shares + stray * widths
    bins = instrument.time_bins()
    counts = np.zeros(instrument.histogram_shape, np.uint32)
    shape = (*instrument.image_shape, bins.count)
    counts[..., bins.codes] = np.random.default_rng(seed).poisson(mean, shape)
    counts[..., 0] = 100_000
    return counts


def work(*, threads: int) -> None:
    """Count packets, use every method that has kernels, follow a change, and gather."""
    instrument = small_instrument()
    calibration = hf.calibrate(
        draw(instrument, 20_000, depth=0.5, seed=1), instrument, distance=0.5
    )
    rng = np.random.default_rng(2)
    codes = rng.integers(0, 512, (40, ROWS, COLS))
    codes[10:] *= rng.random(codes[10:].shape) < 0.1
    packets = b"".join(
        encode_frame(frame, sequence=i, frame=i, timestamp=i, run=64)
        for i, frame in enumerate(codes)
    )
    accumulate(packets, instrument, threads=threads)
    ingest = compiled("ingest", "c")
    assert ingest is not None
    ingest.crc32c(packets)
    plenty, few = (draw(instrument, photons, depth=0.9, seed=3) for photons in (600, 12))
    nothing = draw(instrument, 0, depth=0.9, seed=6, background=12)
    few[:, COLS // 2 :] = nothing[:, COLS // 2 :]
    for method in ("joint", "paper", "sums"):
        image = hf.reconstruct(plenty, calibration, method=method, threads=threads)
        find_edges(image["depth"].values, image["depth_std"].values, PIXEL_ANGLE)
    hf.reconstruct(few, calibration, method="pooled", threads=threads)
    video = Video(calibration, threads=threads)
    for seed in (4, 5):
        video.next(draw(instrument, 600, depth=0.9, seed=seed))
    gathered = GatheredSum()
    for seed in (4, 5):
        gathered.add(draw(instrument, 600, depth=0.9, seed=seed), 100_000)


@dataclass(frozen=True)
class Call:
    """A call of a kernel.

    Attributes
    ----------
    module, function : str
        What was called.
    arguments : tuple
        With arrays as they were before the call.
    """

    module: str
    function: str
    arguments: tuple[Any, ...]


@contextmanager
def recorded_calls(keep: int = 2) -> Iterator[list[Call]]:
    """Record the first calls of each function of the kernels in a block."""
    calls: list[Call] = []
    undo: list[Callable[[], None]] = []
    for name in KERNELS:
        module = compiled(name, "c")
        assert module is not None
        for function, plain in list(vars(module).items()):
            if callable(plain) and function not in ("processor", "ABI"):
                recorder = _recorder(calls, module.__name__, function, plain, keep)
                setattr(module, function, recorder)
                undo.append(lambda m=module, f=function, p=plain: setattr(m, f, p))
    try:
        yield calls
    finally:
        for restore in undo:
            restore()


def _recorder(
    calls: list[Call], module: str, function: str, plain: Callable[..., Any], keep: int
) -> Callable[..., Any]:
    def called(*arguments: Any) -> Any:
        if sum((c.module, c.function) == (module, function) for c in calls) < keep:
            copies = tuple(
                np.array(a) if isinstance(a, np.ndarray | memoryview) else a for a in arguments
            )
            calls.append(Call(module, function, copies))
        return plain(*arguments)

    return called
