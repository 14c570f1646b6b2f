# SPDX-License-Identifier: Apache-2.0
"""Fog, leaves, multipath, motion and warming against closed forms."""

import numpy as np
import pytest
from scipy.special import expn
from scipy.stats import beta, norm

from hueflight import Instrument
from hueflight.errors import SceneError
from hueflight.simulator import (
    EFFECTS,
    Effects,
    SimulationSettings,
    code_probabilities,
    effect_truth,
    expected_rates,
    scene,
    simulate_codes,
    simulate_histogram,
)
from hueflight.simulator.light_paths import ambient_light, scene_returns

LIGHT_M_PER_NS = 0.299792458
SIGMA_NS, PERIOD_NS, LATENCY_NS = 3.4, 200.0, 20.0

# 1 µm pixels behind a lens of 100 mm look along the axis; code n covers n - 1 to n ns
TOML = f"""
name = "test"
[sensor]
rows = 1
cols = 3
code_bits = 8
code_zero = "no photon"
bin_width_ns = 1
pixel_width_um = 1
pixel_height_um = 1
[timing]
period_ns = {PERIOD_NS}
latency_ns = {LATENCY_NS}
[lens]
focal_length_mm = 100
[[bands]]
name = "green"
wavelength_nm = 525
pulse_fwhm_ns = {SIGMA_NS * 2.3548200450309493}
[[bands]]
name = "red"
wavelength_nm = 640
delay_ns = 90
pulse_fwhm_ns = 8
"""


@pytest.fixture(scope="module")
def instrument() -> Instrument:
    return Instrument.from_toml(TOML)


def ideal(**effects: object) -> SimulationSettings:
    return SimulationSettings.ideal(pile_up=False, effects=Effects(**effects))


def light_of(name: str, seen, instrument: Instrument, settings: SimulationSettings):
    """Photons (return, band) of the middle pixel and its delays (return,) on one path."""
    parts = [p for p in scene_returns(seen, instrument, settings) if p.name == name]
    return np.array([p.photons[:, 0, 1] for p in parts]), np.array([
        p.delay_ns[0, 1] for p in parts
    ])  # fmt: skip


# -- fog ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("extinction", [0.05, 0.5, 3.0])
def test_fog_attenuates_both_ways_and_returns_the_integral_of_its_slabs(instrument, extinction):
    start, end, backscatter = 0.1, 2.5, 0.17
    seen = scene("plane", instrument, distance=end, surface=1.0)
    settings = ideal(fog_per_m=extinction, fog_backscatter=backscatter, fog_start=start)
    clear, _ = light_of("surface", seen, instrument, ideal())
    through, _ = light_of("surface", seen, instrument, settings)
    assert through == pytest.approx(clear * np.exp(-2 * extinction * end), rel=1e-9)
    slabs, delays = light_of("fog", seen, instrument, settings)
    # integral of exp(-2 x r)/r² from a to b by exponential integrals
    k = 2 * extinction
    integral = expn(2, k * start) / start - expn(2, k * end) / end
    at_1m = clear[0] * end**2
    assert slabs.sum(axis=0) == pytest.approx(at_1m * extinction * backscatter * integral, rel=1e-6)
    # mean delay: the integral of exp(-2 x r)/r is the difference of E1
    mean_m = (expn(1, k * start) - expn(1, k * end)) / integral
    found = slabs[:, 0] @ delays / slabs[:, 0].sum()
    assert found == pytest.approx(2 * mean_m / LIGHT_M_PER_NS, rel=1e-6)
    truth = effect_truth(seen, instrument, settings)
    assert truth.stray_photons[:, 0, 1] == pytest.approx(slabs.sum(axis=0))
    assert truth.depths[:, 0, 1] == pytest.approx([end])


def test_fog_before_an_empty_sky_returns_light_without_a_depth(instrument):
    seen = scene("empty", instrument)
    truth = effect_truth(seen, instrument, ideal(fog_per_m=0.3))
    assert truth.empty.all()
    assert np.isnan(truth.depths).all()
    white = light_of("surface", scene("plane", instrument, surface=1.0), instrument, ideal())[0][0]
    integral = expn(2, 0.06) / 0.1 - expn(2, 6.0) / 10
    assert truth.stray_photons[:, 0, 1] == pytest.approx(white * 0.3 * 0.17 * integral, rel=1e-4)


# -- leaves ---------------------------------------------------------------------------------------


def test_leaves_cover_their_share_and_give_each_pixel_its_own_depths(paper):
    share, wall = 0.4, 1.5
    settings = SimulationSettings.ideal(
        effects=Effects(foliage_share=share, foliage_depth=0.6, foliage_thickness=0.5)
    )
    seen = scene("plane", paper, distance=wall)
    truth = effect_truth(seen, paper, settings)
    clear = expected_rates(seen, paper, SimulationSettings.ideal()).photons
    free = (expected_rates(seen, paper, settings).photons / clear)[0]
    # the product of three free shares; variance of a product of independent factors
    mean = 1 - (1 - share) ** (1 / 3)
    one = beta(2 * mean, 2 * (1 - mean))
    second = (1 - one.mean()) ** 2 + one.var()
    deviation = np.sqrt(second**3 - (1 - share) ** 2)
    assert free.mean() == pytest.approx(1 - share, abs=4 * deviation / np.sqrt(free.size))
    assert free.std() == pytest.approx(deviation, rel=0.03)
    assert truth.depths.shape[0] == 4
    near = truth.depths[truth.depths < wall - 0.01]
    assert near.min() >= 0.6
    assert near.max() <= 1.1
    assert np.nanmedian(truth.depths[0]) < np.nanmedian(truth.depths[1])
    again = effect_truth(seen, paper, settings)
    assert np.array_equal(again.shares, truth.shares)
    other = effect_truth(seen, paper, settings.replace(seed=1))
    assert not np.array_equal(other.shares, truth.shares)


def test_leaves_behind_the_scene_change_nothing(instrument):
    seen = scene("plane", instrument, distance=0.5)
    behind = ideal(foliage_share=0.4, foliage_depth=0.6).replace(ambient=0.1)
    without = ideal().replace(ambient=0.1)
    assert np.array_equal(
        expected_rates(seen, instrument, behind).detections(),
        expected_rates(seen, instrument, without).detections(),
    )


def test_leaves_reflect_ambient_light_and_lie_in_the_fog(instrument):
    white, black, green = (
        scene("plane", instrument, distance=1.5, surface=surface)
        for surface in (1.0, 0.0, "green brick")
    )
    leaves, foggy = ideal(foliage_share=0.4), ideal(foliage_share=0.4, fog_per_m=0.5)
    free = light_of("surface", white, instrument, leaves)[0][0]
    free = free[0] / light_of("surface", white, instrument, ideal())[0][0][0]
    dark, full = (
        ambient_light(seen, instrument, settings.replace(ambient=0.1))[0, 1]
        for seen, settings in ((black, leaves), (green, ideal()))
    )
    assert full > 0
    assert dark == pytest.approx((1 - free) * full)
    clear, delays = light_of("leaf", white, instrument, leaves)
    fogged, _ = light_of("leaf", white, instrument, foggy)
    # there and back
    assert fogged == pytest.approx(clear * np.exp(-0.5 * delays * LIGHT_M_PER_NS)[:, None])


# -- multipath ------------------------------------------------------------------------------------


def test_multipath_is_later_by_its_path_and_has_the_color_of_both_surfaces(instrument):
    seen = scene("plane", instrument, distance=1.0, surface="red brick")
    reflectance = seen.truth(instrument).reflectance[:, 0, 1]
    settings = ideal(bounce_share=0.3, bounce_path=0.9)
    direct, arrival = light_of("surface", seen, instrument, settings)
    late, times = light_of("bounce", seen, instrument, settings)
    assert late[0] == pytest.approx(0.3 * direct[0] * reflectance)
    assert times - arrival == pytest.approx(0.9 / LIGHT_M_PER_NS)
    truth = effect_truth(seen, instrument, settings)
    assert truth.stray_photons[:, 0, 1] == pytest.approx(late[0])
    empty = scene("empty", instrument)
    assert (effect_truth(empty, instrument, settings).stray_photons == 0).all()


# -- motion ---------------------------------------------------------------------------------------


def test_motion_away_blurs_the_pulse_uniformly(instrument):
    path = 3.0
    seen = scene("plane", instrument, distance=12.0, motion=(0.0, 0.0, path))
    settings = ideal().replace(drive=(1.0, 0.0))
    moments = [
        code_probabilities(expected_rates(moment, instrument, settings))[0, 1, 1:201]
        for moment in seen.moments
    ]
    p = np.mean(moments, axis=0)
    p /= p.sum()
    t = np.arange(200) + 0.5
    variance = (t - t @ p) ** 2 @ p - 1 / 12  # Sheppard's correction for bins of 1 ns
    # a uniform blur adds its length² / 12; light falls with the square of the distance,
    # which changes that by a few parts in a thousand here
    blur = 2 * path / LIGHT_M_PER_NS
    assert variance == pytest.approx(SIGMA_NS**2 + blur**2 / 12 * (1 - 1 / 16**2), rel=0.01)
    truth = effect_truth(seen, instrument, settings)
    assert np.nanmin(truth.depths) == pytest.approx(12 - path / 2 * (1 - 1 / 16))
    assert np.nanmax(truth.depths) == pytest.approx(12 + path / 2 * (1 - 1 / 16))
    assert truth.mixed().all()


def test_an_edge_that_moves_across_a_pixel_gives_it_both_surfaces(instrument):
    near, far = 0.6, 1.5
    # strips meet on the axis; the near one's edge crosses the middle pixel, 6 µm wide there, in
    # the whole capture: all others see one surface
    step = near * 1e-3 / 100
    seen = scene("staircase", instrument, near=near, far=far, steps=2, motion=(step, 0.0, 0.0))
    truth = effect_truth(seen, instrument, ideal().replace(drive=(1.0, 0.0)))
    light = np.array([1 / near**2, 1 / far**2])
    assert truth.shares[:, 0, 1] == pytest.approx(light / light.sum(), rel=1e-6)
    assert truth.mixed().tolist() == [[False, True, False]]


def test_frames_of_a_capture_follow_the_motion(instrument):
    seen = scene("plane", instrument, distance=2.0, motion=(0.0, 0.0, 2.0))
    settings = ideal(delay_drift_ps=0.0).replace(drive=(4.0, 0.0))
    frames = 64_000
    codes = np.concatenate(list(simulate_codes(seen, instrument, frames=frames, settings=settings)))
    assert codes.shape == (frames, 1, 3)
    half = [part[part > 0].mean() for part in (codes[: frames // 2], codes[frames // 2 :])]
    # light falls with the square of the distance, which makes the mean over a to b
    # ln(b/a) / (1/a - 1/b); exposures are so full that the nearest ones weigh a little less
    apart = np.log(1.5) / (1 / 2 - 1 / 3) - np.log(2) / (1 - 1 / 2)
    assert (half[1] - half[0]) * LIGHT_M_PER_NS / 2 == pytest.approx(apart, abs=0.05)
    counts = simulate_histogram(seen, instrument, frames=frames, settings=settings)
    assert (counts.sum(axis=-1) == frames).all()
    expected = np.mean([
        code_probabilities(expected_rates(moment, instrument, settings)) for moment in seen.moments
    ], axis=0)[0, :, 0]  # fmt: skip
    for empty in (counts[0, :, 0], (codes == 0).sum(axis=0)[0]):
        # false alarm rate 1e-4 for six draws, seeded
        limit = norm.isf(1e-4 / 12) * np.sqrt(frames * expected * (1 - expected))
        assert np.all(np.abs(empty - frames * expected) < limit)


def test_a_scene_that_comes_too_close_is_refused(instrument):
    with pytest.raises(SceneError, match=r"object is at -0\.1 m"):
        scene("plane", instrument, distance=0.4, motion=(0.0, 0.0, 1.0))
    with pytest.raises(SceneError, match="motion"):
        scene("plane", instrument, motion=(np.nan, 0.0, 0.0))


# -- warming --------------------------------------------------------------------------------------


def test_warm_leds_fire_later_and_longer(instrument):
    effects = Effects(
        warming=25.0, delay_ps_per_kelvin=(8.0, 20.0), width_per_kelvin=0.002,
        delay_drift_ps=(5.0, 0.0), pulse_width_factor=1.1,
    )  # fmt: skip
    seen = scene("plane", instrument)
    truth = effect_truth(seen, instrument, SimulationSettings(effects=effects))
    assert truth.delay_drift_ps == pytest.approx([25 * 8 + 5, 25 * 20])
    assert truth.pulse_width_factor == pytest.approx(1.1 * 1.05)
    settings = ideal(warming=25.0, width_per_kelvin=0.002).replace(drive=(1.0, 0.0))
    p = code_probabilities(expected_rates(seen, instrument, settings))[0, 1, 1:201]
    t = np.arange(200) + 0.5
    mean = t @ p / p.sum()
    variance = (t - mean) ** 2 @ p / p.sum() - 1 / 12
    assert mean == pytest.approx(LATENCY_NS + 2 / LIGHT_M_PER_NS + 0.25, abs=1e-4)
    assert np.sqrt(variance) == pytest.approx(1.05 * SIGMA_NS, rel=1e-4)
    with pytest.raises(SceneError, match=r"effects\.width_per_kelvin = -0\.1"):
        Effects(warming=10.0, width_per_kelvin=-0.1)


# -- the list of effects --------------------------------------------------------------------------


def test_every_effect_is_listed_with_a_strength_that_shows(paper):
    listed = set().union(*(entry.typical.active for entry in EFFECTS.values()))
    plain = Effects()
    switches = {
        name
        for name in vars(plain)
        # the others only say how an effect looks that another attribute switches on
        if getattr(plain, name) in (0.0, 1.0) and name not in ("flare_delay_ns",)
    }
    assert switches <= listed
    seen = scene("skyline", paper)
    without = expected_rates(seen, paper).detections()
    for name, entry in EFFECTS.items():
        settings = SimulationSettings(effects=entry.typical)
        layout = scene("skyline", paper, **entry.layout) if entry.layout else seen
        rates = expected_rates(layout, paper, settings)
        same = (
            np.array_equal(rates.detections(), without)
            and rates.trains == expected_rates(seen, paper).trains
            and rates.uneven is None
            and rates.secondary is None
            and np.array_equal(rates.bins.edges_ns, expected_rates(seen, paper).bins.edges_ns)
        )
        assert not same, name
