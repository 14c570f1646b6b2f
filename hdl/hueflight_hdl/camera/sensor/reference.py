# SPDX-License-Identifier: Apache-2.0
"""Reference model of the synthetic sensor in NumPy, bit for bit."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from hueflight_protocol.camera_map import SyntheticSource

from ..frame_format import FrameFormat
from .scene import BLOCK, JITTER_BITS, Scene
from .synthetic import SEEDS


def synthetic_frames(
    form: FrameFormat,
    source: SyntheticSource,
    /,
    *,
    seed: int = 1,
    occupancy: int = 0,
    delay_start: int = 0,
    delay_step: int = 0,
    scene: Scene | None = None,
) -> Iterator[NDArray[np.uint16]]:
    """Yield a capture's frames, (rows, cols), without end.

    Parameters
    ----------
    form : FrameFormat
        Geometry, code width, lanes.
    source : SyntheticSource
        Kind of codes.
    seed, occupancy, delay_start, delay_step
        As in the registers of the same names; occupancy in 1/65536.
    scene : Scene, optional
        As the gateware was built with.
    """
    codes = 1 << form.code_bits
    state = (np.uint32(seed) ^ np.array(SEEDS[: form.lanes], np.uint32)) | np.uint32(1)
    first = np.arange(form.beats) * form.lanes
    row, col = np.divmod(first, form.cols)
    frame = 0
    while True:
        states, state = _generate(state, form.beats)
        if source == SyntheticSource.COUNTER:
            values = (first[:, None] + np.arange(form.lanes) + frame) % codes
        elif source == SyntheticSource.RANDOM:
            hit = states >> 16 < occupancy
            values = np.where(hit, np.maximum(states % codes, 1), 0)
        elif scene is None:
            values = np.zeros(states.shape)
        else:
            block = row // BLOCK, col // BLOCK
            drawn = scene.outcomes[scene.material[block][:, None], states & 0xFF].astype(int)
            jitter_mask = (1 << JITTER_BITS) - 1
            jitter = (states >> 8 & jitter_mask) + (states >> 16 & jitter_mask)
            shift = scene.depth[block].astype(int) + delay_start + frame * delay_step
            moved = (drawn - shift[:, None] - jitter.astype(int)) % codes
            values = np.where(drawn == 0, 0, np.where(moved == 0, codes - 1, moved))
        yield values.reshape(-1)[: form.pixels].reshape(form.rows, form.cols).astype(np.uint16)
        frame += 1


def _generate(
    state: NDArray[np.uint32], beats: int
) -> tuple[NDArray[np.uint32], NDArray[np.uint32]]:
    """Return the states of `beats` beats, (beats, lanes), and the one after them."""
    states = np.empty((beats, state.size), np.uint32)
    for beat in range(beats):
        states[beat] = state
        state = state ^ state << np.uint32(13)
        state = state ^ state >> np.uint32(17)
        state = state ^ state << np.uint32(5)
    return states, state
