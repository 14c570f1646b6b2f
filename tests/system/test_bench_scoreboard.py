# SPDX-License-Identifier: Apache-2.0
"""The scoreboard reads captures of two surfaces from files, and scores both depths."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.io import savemat

TOOLS = Path(__file__).resolve().parents[2] / "tools" / "bench"
WIDTH_NS, BINS, METERS_PER_NS = 0.1, 256, 0.149896229
NEAR, PHOTONS = 0.8, 400


@pytest.fixture
def two_returns(monkeypatch: pytest.MonkeyPatch):
    pytest.importorskip("phasorpy")
    for folder in (TOOLS, TOOLS / "scoreboard"):
        monkeypatch.syspath_prepend(str(folder))
    import two_returns

    return two_returns


@pytest.fixture
def pane() -> dict[str, Any]:
    """A pane before the middle of a wall that recedes from column to column."""
    time_ns = (np.arange(BINS) + 0.5) * WIDTH_NS

    def light(depth: NDArray[np.float64]) -> NDArray[np.float64]:
        since = time_ns - 2 - depth[..., None] / METERS_PER_NS
        return np.nan_to_num(np.exp(-0.5 * (since / 0.25) ** 2)) * WIDTH_NS / 0.25 / 2.5066

    near = np.full((16, 16), np.nan)
    near[4:12, 4:12] = NEAR
    far = np.broadcast_to(1.4 + 0.04 * np.arange(16), near.shape)
    mean = PHOTONS * (light(near) + light(far)) + 0.4
    pulse = 1e6 * np.exp(-0.5 * ((time_ns - 2) / 0.25) ** 2)
    counts = np.random.default_rng(1).poisson(mean)
    return {
        "counts": counts, "pulse": np.rint(pulse), "bin_width_ns": WIDTH_NS,
        "near": near, "far": far,
    }  # fmt: skip


def test_two_surfaces_of_a_file(two_returns, pane: dict[str, Any], tmp_path: Path):
    np.savez(tmp_path / "pane.npz", **pane)
    savemat(tmp_path / "pane.mat", pane)
    capture, same = (two_returns.read(tmp_path / name) for name in ("pane.npz", "pane.mat"))
    np.testing.assert_array_equal(capture.whole.counts, same.whole.counts)
    both = np.isfinite(pane["near"])
    depths = np.sort(two_returns.ours(capture.whole, method="joint", second_returns=True), axis=0)
    assert (np.isfinite(depths).all(axis=0) == both).mean() > 0.98
    for found, true in zip(depths, capture.truth, strict=True):
        error = np.abs(found - true)[both]
        assert np.nanmedian(error) < 0.01
    highest = np.sort(two_returns.two_peaks(capture.whole), axis=0)
    assert np.abs(highest - capture.truth)[:, both].max() < 0.05


def test_a_second_surface_predicts_more(two_returns, pane: dict[str, Any], tmp_path: Path):
    from data_sets import halves_of
    from score import held_out_bits

    np.savez(tmp_path / "pane.npz", **pane)
    _, unseen = halves_of(two_returns.read(tmp_path / "pane.npz").whole)
    one = np.stack([pane["far"], np.full(pane["far"].shape, np.nan)])
    both = np.stack([pane["far"], pane["near"]])
    assert held_out_bits(both, unseen) > held_out_bits(one, unseen) + 0.2
    assert held_out_bits(one, unseen) == held_out_bits(pane["far"], unseen)


@pytest.mark.parametrize("missing", ["counts", "pulse", "bin_width_ns"])
def test_a_file_without_an_array_is_refused(
    two_returns, pane: dict[str, Any], tmp_path: Path, missing: str
):
    del pane[missing]
    np.savez(tmp_path / "pane.npz", **pane)
    with pytest.raises(SystemExit, match=f"holds no {missing}"):
        two_returns.read(tmp_path / "pane.npz")
