# SPDX-License-Identifier: Apache-2.0
"""Where an empty sky ends: surfaces neither grow over the edge nor shrink from it."""

import numpy as np
import pytest

import hueflight as hf
from hueflight.reconstruction.pooled import empty_edges
from hueflight.reconstruction.pooled import estimate as few_photons
from hueflight.reconstruction.quality import Quality

SKY = 15.0  #: photons of background, in all pixels


@pytest.fixture(scope="module")
def instrument(small):
    return small(rows=48, cols=40)


@pytest.fixture(scope="module")
def calibration(instrument, draw):
    return hf.calibrate(draw(instrument, photons=2_000), instrument, distance=0.5)


def seen(instrument, draw, where, photons, seed):
    """Counts of a surface where the mask says so, and of sky elsewhere."""
    counts = draw(instrument, photons=1e-9, background=SKY, seed=(seed, 1))
    surface = draw(instrument, depth=0.9, photons=photons, background=SKY, seed=(seed, 2))
    return np.where(where[..., None], surface, counts)


def absent_in(counts, calibration):
    quality = hf.reconstruct(counts, calibration, method="pooled").quality.values
    return (quality & Quality.NO_RETURN) > 0


@pytest.mark.parametrize("shape", ["square", "slope"])
def test_edges_of_a_dim_surface(instrument, calibration, draw, monkeypatch, shape):
    """Fewer pixels of the sky show a surface, and no more of the surface show none."""
    row, col = np.indices(instrument.image_shape)
    square = (abs(row - 24) < 16) & (abs(col - 20) < 12)
    where = square if shape == "square" else 2 * row + 3 * col > 108
    pictures = [seen(instrument, draw, where, 6, seed) for seed in range(4)]
    decided = np.mean([errors(absent_in(one, calibration), where) for one in pictures], axis=0)
    monkeypatch.setattr(few_photons, "settled", lambda _seen, _pools, absent, *_: absent)
    detected = np.mean([errors(absent_in(one, calibration), where) for one in pictures], axis=0)
    print(f"{shape}: sky {decided[0]:.2%}, was {detected[0]:.2%}; "
          f"surface {decided[1]:.2%}, was {detected[1]:.2%}")  # fmt: skip
    assert decided[0] < 0.004
    assert decided[0] < 0.5 * detected[0]
    assert decided[1] < detected[1]


def errors(absent, where):
    """Shares of the sky with a surface and of the surface without one."""
    return float((~absent)[~where].mean()), float(absent[where].mean())


def test_thin_surfaces_stay(instrument, calibration, draw):
    """Bars of three pixels beside a wide one, and a dim border of a bright surface."""
    where = np.zeros(instrument.image_shape, bool)
    where[8:40, 4:16] = where[8:40, 22:25] = where[8:40, 32:35] = True
    counts = seen(instrument, draw, where, 25, 1)
    assert absent_in(counts, calibration)[where].mean() < 0.01
    dim = np.zeros_like(where)
    dim[:, 20:23] = True
    where[:] = False
    where[:, :23] = True
    counts = np.where(
        dim[..., None], seen(instrument, draw, dim, 12, 2), seen(instrument, draw, where, 40, 3)
    )
    assert absent_in(counts, calibration)[where].mean() < 0.02


def test_log_odds_are_those_of_the_arrival_times(instrument, calibration, draw):
    """Against the densities of the calibration, photon by photon."""
    counts = draw(instrument, depth=0.7, photons=8, background=4, seed=5)
    search_ns = (-3.0, 10.0)
    tables = few_photons.tables_for(calibration, search_ns)
    photons = few_photons.photons_of(counts, calibration, tables)
    pilot = np.full(instrument.image_shape, 1.4, np.float32)
    pools = few_photons.grown(photons, pilot, calibration.usable, tables, search_ns, 1000.0, 1)
    pixels, pool_of = np.array([3, 700, 1400]), np.array([80, 700, 900])
    found = empty_edges._log_odds(photons, pixels, pools, pool_of, tables)
    for value, pixel, of in zip(found, pixels, pool_of, strict=True):
        windows = pools.windows.reshape(10, -1)[:, of].astype(float)
        share = np.maximum(tables.unmixing.astype(float) @ windows, 0)
        share[-1] = max(share[-1], 0.02 * windows.sum())
        share /= share.sum()
        part = slice(photons.starts[pixel], photons.starts[pixel + 1])
        times_ns = photons.times_ns[part] - pools.delays_ns.ravel()[of]
        density = calibration.templates.density(times_ns % tables.period_ns)
        likely = share[:-1] @ density * tables.period_ns + share[-1]
        assert value == pytest.approx(photons.weights[part] @ np.log(likely), abs=0.15)


def test_nothing_to_decide(instrument, calibration, draw):
    """No surface, no empty region, or surfaces too small to know what they look like."""
    search_ns = (-3.0, 10.0)
    counts = draw(instrument, depth=0.7, photons=8, background=4, seed=5)
    tables = few_photons.tables_for(calibration, search_ns)
    photons = few_photons.photons_of(counts, calibration, tables)
    pilot = np.full(instrument.image_shape, 1.4, np.float32)
    pools = few_photons.grown(photons, pilot, calibration.usable, tables, search_ns, 1000.0, 1)
    everywhere = np.ones(instrument.image_shape, bool)
    speck = everywhere.copy()
    speck[10:12, 10:12] = False
    for absent in (everywhere, ~everywhere, speck):
        decided = empty_edges.settled(photons, pools, absent, calibration.usable, tables)
        np.testing.assert_array_equal(decided, absent)
