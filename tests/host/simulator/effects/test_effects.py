# SPDX-License-Identifier: Apache-2.0
"""Effects of the simulator against expectations from closed forms, written without its code."""

import itertools
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from scipy import integrate, stats

from hueflight import Instrument
from hueflight.errors import SceneError
from hueflight.simulator import (
    Effects,
    SimulationSettings,
    code_probabilities,
    effect_truth,
    expected_rates,
    pixels,
    scene,
    simulate_codes,
    simulate_histogram,
    time_bins,
)

LIGHT_M_PER_NS = 0.299792458
FWHM_PER_SIGMA = 2.3548200450309493
LATENCY_NS, PERIOD_NS = 30.0, 300.0

# forward, so that code n covers the time from n to n + 1 ns; 1 µm pixels behind a lens of 100 mm
# look along the axis
TOML = """
name = "test"
[sensor]
rows = 1
cols = 3
code_bits = 9
bin_width_ns = 1
pixel_width_um = 1
pixel_height_um = 1
[timing]
period_ns = 300
latency_ns = 30
[lens]
focal_length_mm = 100
[[bands]]
name = "blue"
wavelength_nm = 450
delay_ns = 0
pulse_fwhm_ns = 8
[[bands]]
name = "red"
wavelength_nm = 640
delay_ns = 120
pulse_fwhm_ns = 10
pulse_tail_ns = 3
"""


@pytest.fixture(scope="module")
def instrument() -> Instrument:
    return Instrument.from_toml(TOML)


def ideal(**effects: object) -> SimulationSettings:
    """An instrument without imperfection or pile-up, so that p(code) is proportional to light."""
    return SimulationSettings.ideal(pile_up=False, effects=Effects(**effects))


def shape(scene_, instrument: Instrument, settings: SimulationSettings) -> np.ndarray:
    """Distribution over the time bins of each pixel of the first row, (col, bin)."""
    p = code_probabilities(expected_rates(scene_, instrument, settings))[0, :, :300]
    return p / p.sum(axis=-1, keepdims=True)


def flight_ns(distance_m: float) -> float:
    return 2 * distance_m / LIGHT_M_PER_NS


def pulse(center_ns: float, fwhm_ns: float, tail_ns: float = 0.0) -> np.ndarray:
    """Share of one pulse in each bin of 1 ns on the circle of the period."""
    if tail_ns == 0:
        law = stats.norm(center_ns, fwhm_ns / FWHM_PER_SIGMA)
    else:  # `fwhm_ns` is that of the Gaussian part here
        sigma = fwhm_ns / FWHM_PER_SIGMA
        law = stats.exponnorm(tail_ns / sigma, center_ns, sigma)
    edges = np.arange(-PERIOD_NS, 5 * PERIOD_NS + 1)
    return np.diff(law.cdf(edges)).reshape(-1, int(PERIOD_NS)).sum(axis=0)


def only(instrument: Instrument, band: str) -> dict[str, tuple[float, ...]]:
    return {"drive": tuple(float(b.name == band) for b in instrument.bands)}


# -- several returns ------------------------------------------------------------------------------


@pytest.mark.parametrize(("share", "pane", "wall"), [(0.5, 1.0, 4.0), (0.1, 0.4, 1.7)])
def test_a_pane_gives_two_returns_with_the_shares_of_their_light(instrument, share, pane, wall):
    settings = ideal(pane_share=share, pane_depth=pane).replace(**only(instrument, "blue"))
    seen = scene("plane", instrument, distance=wall, surface=1.0)
    # light falls with the square of the distance; both are white and face the camera
    light = np.array([share / pane**2, (1 - share) / wall**2])
    parts = light / light.sum()
    expected = sum(
        part * pulse(LATENCY_NS + flight_ns(distance), 8.0)
        for part, distance in zip(parts, (pane, wall), strict=True)
    )
    assert shape(seen, instrument, settings)[1] == pytest.approx(expected, abs=1e-7)
    truth = effect_truth(seen, instrument, settings)
    assert truth.depths[:, 0, 1] == pytest.approx([pane, wall])
    assert truth.shares[:, 0, 1] == pytest.approx(parts)
    assert truth.mixed().all()


def test_a_pane_changes_neither_what_is_in_front_of_it_nor_the_empty_sky_behind_it(instrument):
    settings = ideal(pane_share=0.3, pane_depth=2.0)
    front = scene("plane", instrument, distance=1.0)
    with_pane = expected_rates(front, instrument, settings)
    assert np.array_equal(
        with_pane.detections(), expected_rates(front, instrument, ideal()).detections()
    )
    nothing = scene("empty", instrument)
    truth = effect_truth(nothing, instrument, settings)
    assert truth.depths[:, 0, 1] == pytest.approx([2.0])
    white = expected_rates(scene("plane", instrument, distance=2.0, surface=1.0), instrument)
    assert truth.photons[0, :, 0, 1] == pytest.approx(0.3 * white.photons[:, 0, 1], rel=1e-9)


def test_a_pane_reflects_ambient_light(instrument):
    dark_wall = scene("plane", instrument, distance=3.0, surface=0.2)
    settings = ideal(pane_share=0.25).replace(drive=0.0, ambient=0.1)
    base = ideal().replace(drive=0.0, ambient=0.1)
    ratio = (
        expected_rates(dark_wall, instrument, settings).detections()
        / expected_rates(dark_wall, instrument, base).detections()
    )
    assert ratio == pytest.approx((0.75 * 0.2 + 0.25) / 0.2)


# -- footprint ------------------------------------------------------------------------------------


def test_a_pixel_half_on_each_side_of_an_edge_gets_half_of_each_light(instrument):
    # two strips meet on the axis, in the middle of the middle one of three pixels
    near, far = 0.6, 1.5
    seen = scene("staircase", instrument, near=near, far=far, steps=2, rays=4)
    settings = ideal().replace(**only(instrument, "blue"))
    rates = expected_rates(seen, instrument, settings)
    alone = 0.35 * 0.8  # detections of a reflectance of 0.8 at 1 m
    all_on = expected_rates(seen, instrument, ideal()).detections()
    assert all_on[0] == pytest.approx(
        [alone / near**2, alone * (1 / near**2 + 1 / far**2) / 2, alone / far**2], rel=1e-6
    )
    light = np.array([1 / near**2, 1 / far**2])
    mixture = sum(
        part * pulse(LATENCY_NS + flight_ns(distance), 8.0)
        for part, distance in zip(light / light.sum(), (near, far), strict=True)
    )
    found = code_probabilities(rates)[0, 1, :300]
    assert found / found.sum() == pytest.approx(mixture, abs=1e-7)

    truth = effect_truth(seen, instrument, settings)
    assert truth.depths.shape == (2, 1, 3)
    assert truth.depths[:, 0, 1] == pytest.approx([near, far])
    assert truth.shares[:, 0, 1] == pytest.approx(light / light.sum(), rel=1e-6)
    assert np.isnan(truth.depths[1, 0, [0, 2]]).all()
    assert truth.mixed().tolist() == [[False, True, False]]


def test_a_footprint_is_the_mean_over_the_pixels_of_a_finer_sensor(paper, resized):
    coarse = resized(paper, 12, 8, pixel_width_um=300.0, pixel_height_um=150.0)
    fine = resized(paper, 36, 24, pixel_width_um=100.0, pixel_height_um=50.0)
    settings = SimulationSettings.ideal(ambient=0.3)
    averaged = expected_rates(scene("fig1", coarse, rays=3), coarse, settings)
    finer = expected_rates(scene("fig1", fine), fine, settings)
    blocks = finer.detections().reshape(12, 3, 8, 3).mean(axis=(1, 3))
    assert averaged.detections() == pytest.approx(blocks, rel=1e-9)
    assert len(averaged.further) == 8


def test_a_footprint_does_not_change_the_truth_of_the_centres(paper):
    with_rays, without = scene("fig7", paper, rays=2), scene("fig7", paper)
    a, b = with_rays.truth(paper), without.truth(paper)
    assert np.array_equal(a.depth, b.depth, equal_nan=True)
    assert np.array_equal(a.reflectance, b.reflectance, equal_nan=True)
    mixed = effect_truth(with_rays, paper).mixed()
    assert 0.005 < mixed.mean() < 0.2  # the edges of wall and window
    assert not effect_truth(without, paper).mixed().any()


def test_a_footprint_needs_a_lens_and_a_number_of_rays(instrument):
    with pytest.raises(SceneError, match="rays = 0"):
        scene("plane", instrument, rays=0)
    with pytest.raises(SceneError, match="no lens"):
        scene("plane", msgspec.structs.replace(instrument, lens=None), rays=2)


# -- empty regions --------------------------------------------------------------------------------


def test_the_sky_and_the_absorber_return_no_led_light(paper):
    seen = scene("skyline", paper)
    settings = SimulationSettings.ideal()
    truth, ideal_truth = effect_truth(seen, paper, settings), seen.truth(paper)
    absorber = seen.regions["absorber"]
    assert absorber.any()
    assert np.array_equal(truth.empty, absorber | ~seen.visible)
    assert np.isnan(ideal_truth.depth[~seen.visible]).all()
    assert 0.3 < (~seen.visible).mean() < 0.7
    assert np.array_equal(expected_rates(seen, paper, settings).detections() == 0, truth.empty)


def test_the_sky_shines_steadily(paper):
    seen = scene("skyline", paper)
    settings = SimulationSettings.ideal(drive=0.0, ambient=0.2, effects=Effects(sky=2.5))
    white = expected_rates(scene("plane", paper, surface=1.0), paper, settings).detections()
    ratio = expected_rates(seen, paper, settings).detections() / white
    assert ratio[~seen.visible] == pytest.approx(2.5)
    assert (ratio[seen.visible] < 1).all()
    assert np.all(ratio[seen.regions["absorber"]] == 0)


# -- light that is not constant in time -----------------------------------------------------------


@pytest.mark.parametrize(
    "effects",
    [
        {"background_ramp": 0.5},
        {"background_ramp": -1.0},
        {"background_decay_share": 0.4, "background_decay_ns": 50.0},
        {"background_ramp": 0.3, "background_decay_share": 0.2, "background_decay_ns": 400.0},
    ],
)
def test_the_background_is_the_integral_of_its_shape(instrument, effects):
    settings = ideal(**effects).replace(drive=0.0, ambient=0.2, dnl_lsb=0.1)
    slope = effects.get("background_ramp", 0.0)
    share = effects.get("background_decay_share", 0.0)
    tau = effects.get("background_decay_ns", 1.0)

    def density(t: float) -> float:
        decay = np.exp(-t / tau) / (tau * (1 - np.exp(-PERIOD_NS / tau)))
        return (1 - share) * (1 + slope * (2 * t / PERIOD_NS - 1)) / PERIOD_NS + share * decay

    edges = time_bins(instrument, settings).edges_ns
    expected = [integrate.quad(density, a, b)[0] for a, b in itertools.pairwise(edges)]
    wall = scene("plane", instrument)
    assert shape(wall, instrument, settings)[1] == pytest.approx(expected, rel=1e-9)
    flat = settings.replace(effects=Effects())
    assert expected_rates(wall, instrument, settings).detections() == pytest.approx(
        expected_rates(wall, instrument, flat).detections()
    )


def test_dark_counts_stay_constant_in_time(instrument):
    noisy = msgspec.structs.replace(
        instrument, sensor=msgspec.structs.replace(instrument.sensor, dark_count_hz=1e5)
    )
    settings = ideal(background_ramp=1.0).replace(drive=0.0, dark_counts=1.0)
    assert shape(scene("empty", noisy), noisy, settings) == pytest.approx(1 / PERIOD_NS)


# -- LED pulses -----------------------------------------------------------------------------------


def test_delay_and_width_of_each_band_drift(instrument):
    settings = ideal(delay_drift_ps=(150.0, -80.0), pulse_width_factor=(1.1, 1.0))
    wall = scene("plane", instrument, distance=1.0)
    blue = shape(wall, instrument, settings.replace(**only(instrument, "blue")))[1]
    drifted = pulse(LATENCY_NS + 0.150 + flight_ns(1.0), 8.0 * 1.1)
    assert blue == pytest.approx(drifted, abs=1e-7)
    t = np.arange(PERIOD_NS) + 0.5
    red_only = only(instrument, "red")
    red = shape(wall, instrument, settings.replace(**red_only))[1]
    before = shape(wall, instrument, ideal().replace(**red_only))[1]
    # bins of 1 ns sample so wide a pulse finely enough for its mean
    assert t @ red - t @ before == pytest.approx(-0.080, abs=1e-5)
    truth = effect_truth(wall, instrument, settings)
    assert truth.delay_drift_ps.tolist() == [150.0, -80.0]
    assert truth.pulse_width_factor.tolist() == [1.1, 1.0]


def test_a_width_factor_scales_the_whole_pulse(instrument):
    wall = scene("plane", instrument, distance=1.0)
    red = only(instrument, "red")
    t = np.arange(PERIOD_NS) + 0.5

    def moments(settings):
        p = shape(wall, instrument, settings.replace(**red))[1]
        mean = t @ p
        return mean, (t - mean) ** 2 @ p - 1 / 12  # Sheppard's correction for bins of 1 ns

    mean, variance = moments(ideal())
    wide_mean, wide_variance = moments(ideal(pulse_width_factor=1.2))
    assert wide_variance / variance == pytest.approx(1.2**2, rel=1e-5)
    assert wide_mean - mean == pytest.approx(0.2 * 3.0, abs=1e-5)  # the tail's mean is 3 ns


@pytest.mark.parametrize("tail_ns", [1.0, 2.9999, 3.0, 15.0, 50.0])
@pytest.mark.parametrize("band", ["blue", "red"])
def test_a_share_of_the_light_comes_through_an_exponential_delay(instrument, band, tail_ns):
    share = 0.2
    wall = scene("plane", instrument, distance=1.0)
    settings = ideal(tail_share=share, tail_ns=tail_ns).replace(**only(instrument, band))
    found = shape(wall, instrument, settings)[1]
    direct = shape(wall, instrument, ideal().replace(**only(instrument, band)))[1]
    # convolution on the circle by Fourier series; the filter of an exponential is 1/(1 + iωτ)
    omega = 2 * np.pi * np.fft.rfftfreq(int(PERIOD_NS), d=1.0)
    delayed = np.fft.irfft(np.fft.rfft(direct) / (1 + 1j * omega * tail_ns), n=int(PERIOD_NS))
    assert found == pytest.approx((1 - share) * direct + share * delayed, abs=3e-7)


def test_a_share_of_one_leaves_no_direct_light(instrument):
    wall = scene("plane", instrument, distance=1.0)
    settings = ideal(tail_share=1.0, tail_ns=20.0).replace(**only(instrument, "blue"))
    expected = pulse(LATENCY_NS + flight_ns(1.0), 8.0, tail_ns=20.0)
    assert shape(wall, instrument, settings)[1] == pytest.approx(expected, abs=1e-7)


# -- stray light ----------------------------------------------------------------------------------


def test_flare_is_the_mean_light_at_its_mean_time(instrument):
    near, far, share, delay = 0.6, 1.5, 0.1, 4.0
    seen = scene("staircase", instrument, near=near, far=far, steps=2)
    on = only(instrument, "blue")
    settings = ideal(flare_share=share, flare_delay_ns=delay).replace(**on)
    # pixels at -1, 0 and +1 of the axis: one sees the near strip, two the far one
    light = np.array([1 / near**2, 1 / far**2, 1 / far**2])
    times = np.array([flight_ns(near), flight_ns(far), flight_ns(far)])
    flare = share * light.mean()
    arrival = light @ times / light.sum() + delay
    for col in range(3):
        expected = light[col] * pulse(LATENCY_NS + times[col], 8.0)
        expected = expected + flare * pulse(LATENCY_NS + arrival, 8.0)
        expected /= light[col] + flare
        assert shape(seen, instrument, settings)[col] == pytest.approx(expected, abs=1e-7)
    truth = effect_truth(seen, instrument, settings)
    direct = expected_rates(seen, instrument, ideal().replace(**on)).photons
    assert truth.stray_photons[0, 0] == pytest.approx(share * direct[0].mean())
    assert truth.depths.shape[0] == 1  # flare is not a surface that a pixel sees


def test_a_fixed_reflection_does_not_depend_on_the_scene(instrument):
    settings = ideal(reflection=1.5, reflection_delay_ns=0.4).replace(**only(instrument, "red"))
    nothing = scene("empty", instrument)
    rates = expected_rates(nothing, instrument, settings)
    white = scene("plane", instrument, distance=1.0, surface=1.0)
    bright = expected_rates(white, instrument, settings.replace(effects=Effects()))
    assert rates.detections() == pytest.approx(1.5 * bright.detections(), rel=1e-6)
    both = expected_rates(white, instrument, settings)
    assert both.detections() == pytest.approx(2.5 * bright.detections(), rel=1e-6)
    t = np.arange(PERIOD_NS) + 0.5
    at_1m = shape(white, instrument, settings.replace(effects=Effects()))[1]
    found = shape(nothing, instrument, settings)[1]
    assert t @ found - t @ at_1m == pytest.approx(0.4 - flight_ns(1.0), abs=1e-5)
    assert effect_truth(nothing, instrument, settings).empty.all()


# -- the sensor -----------------------------------------------------------------------------------


def test_pixels_that_turn_hot_are_new_and_change_no_other(paper):
    before = pixels(paper, SimulationSettings())
    settings = SimulationSettings(effects=Effects(new_hot_share=0.02))
    after = pixels(paper, settings)
    turned = effect_truth(scene("empty", paper), paper, settings).turned_hot
    assert turned.sum() == round(0.02 * 192 * 128)
    assert not (turned & (before.hot | before.dead)).any()
    assert np.array_equal(after.hot, before.hot | turned)
    assert np.array_equal(after.dead, before.dead)
    assert np.array_equal(after.delay_ns, before.delay_ns)
    assert np.array_equal(after.dark_rate_hz[~turned], before.dark_rate_hz[~turned])
    assert (after.dark_rate_hz[turned] >= 1e6).all()
    again = pixels(paper, settings)
    assert np.array_equal(again.hot, after.hot)
    other = pixels(paper, settings.replace(seed=1)).hot
    assert not np.array_equal(other, after.hot)


def test_a_scanned_sensor_has_the_same_hot_pixels_at_each_step():
    line = Instrument.load("line1024")
    settings = SimulationSettings(effects=Effects(new_hot_share=0.05))
    hot = pixels(line, settings).hot
    steps = hot.reshape(line.sensor.scan_steps, line.sensor.rows, line.sensor.cols)
    assert (steps == steps[0]).all()
    assert hot.sum() > pixels(line, SimulationSettings()).hot.sum()


def test_all_pixels_can_turn_hot_but_dead_ones(paper):
    everything = pixels(paper, SimulationSettings(effects=Effects(new_hot_share=1.0)))
    assert np.array_equal(everything.hot, ~everything.dead)


def test_bin_widths_drift_independently(paper):
    before = time_bins(paper, SimulationSettings())
    settings = SimulationSettings(effects=Effects(bin_width_drift=0.02))
    after = time_bins(paper, settings)
    change = after.widths_ns / before.widths_ns - 1
    # 499 draws: 3 % of the deviation, .04 of the correlation
    assert change.std() == pytest.approx(0.02, rel=0.12)
    assert abs(np.corrcoef(change[1:], change[:-1])[0, 1]) < 0.15
    assert after.edges_ns[[0, -1]].tolist() == before.edges_ns[[0, -1]].tolist()
    assert np.array_equal(after.codes, before.codes)
    assert np.array_equal(time_bins(paper, settings).edges_ns, after.edges_ns)
    other = time_bins(paper, settings.replace(seed=1))
    assert not np.array_equal(other.edges_ns, after.edges_ns)
    truth = effect_truth(scene("empty", paper), paper, settings)
    assert np.array_equal(truth.edges_ns, after.edges_ns)


# -- all of them ----------------------------------------------------------------------------------

EVERYTHING = Effects(
    sky=1.0, pane_share=0.2, pane_depth=0.3, background_ramp=0.4, background_decay_share=0.1,
    delay_drift_ps=100.0, pulse_width_factor=1.02, tail_share=0.1, flare_share=0.1,
    flare_delay_ns=4.0, reflection=0.2, reflection_delay_ns=0.5, new_hot_share=0.01,
    bin_width_drift=0.02, foliage_share=0.1, fog_per_m=0.1, bounce_share=0.1, warming=5.0,
    crosstalk_share=0.01, afterpulse_share=0.02,
)  # fmt: skip
_SHAPES = {
    "background_decay_ns", "tail_ns", "pane_depth", "foliage_depth", "foliage_thickness",
    "fog_backscatter", "fog_start", "bounce_path", "delay_ps_per_kelvin", "width_per_kelvin",
    "afterpulse_ns",
}  # fmt: skip


def test_every_effect_is_off_by_default(paper):
    assert Effects().active == {}
    assert SimulationSettings().effects == Effects()
    rates = expected_rates(scene("fig1", paper), paper)
    assert rates.further == ()
    assert rates.uneven is None
    assert rates.trains == tuple(paper.pulses(band) for band in range(9))
    assert rates.secondary is None
    assert set(EVERYTHING.active) == set(vars(Effects())) - _SHAPES


def test_both_samplers_follow_the_probabilities(paper, resized, goodness_of_fit):
    small = resized(paper, 2, 2)
    settings = SimulationSettings(effects=EVERYTHING, hot_share=0.0, dead_share=0.0)
    seen = scene("fig1", small, rays=2)
    rates = expected_rates(seen, small, settings)
    p = code_probabilities(rates)
    counts = simulate_histogram(seen, small, frames=200_000, settings=settings, seed=4)
    frames = 20_000
    codes = np.concatenate(
        list(simulate_codes(seen, small, frames=frames, settings=settings, seed=5))
    )
    for row in range(2):
        # p(code) of some rows is that of the whole
        assert code_probabilities(rates, slice(row, row + 1))[0] == pytest.approx(p[row], abs=1e-9)
        for col in range(2):
            drawn = np.bincount(codes[:, row, col], minlength=512)
            # false alarm rate 1e-4 each, seeded
            assert goodness_of_fit(counts[row, col], p[row, col]) > 1e-4
            assert goodness_of_fit(drawn, p[row, col]) > 1e-4
    again = simulate_histogram(seen, small, frames=200_000, settings=settings, seed=4)
    assert np.array_equal(again, counts)


def test_expected_detections_are_those_of_the_probabilities(paper, resized):
    small = resized(paper, 4, 3)
    settings = SimulationSettings(effects=EVERYTHING)
    rates = expected_rates(scene("fig1", small, rays=2), small, settings)
    photons_alone = replace(rates, secondary=None)
    p = code_probabilities(photons_alone)
    assert p[..., 0] == pytest.approx(np.exp(-rates.detections()), rel=1e-5, abs=1e-300)


@pytest.mark.parametrize(
    ("effects", "message"),
    [
        ({"pane_share": 1.2}, "effects.pane_share = 1.2"),
        ({"tail_share": float("nan")}, "effects.tail_share = nan"),
        ({"background_ramp": 1.5}, "effects.background_ramp = 1.5"),
        ({"background_decay_ns": 0.0}, "effects.background_decay_ns = 0.0"),
        ({"reflection_delay_ns": -1.0}, "effects.reflection_delay_ns = -1.0"),
        ({"bin_width_drift": 0.3}, "effects.bin_width_drift = 0.3"),
        ({"delay_drift_ps": (0.0, float("inf"))}, "effects.delay_drift_ps"),
        ({"pulse_width_factor": 0.0}, "effects.pulse_width_factor = 0.0"),
    ],
)
def test_impossible_effects_are_refused_by_name(effects, message):
    with pytest.raises(SceneError, match=message.replace(".", r"\.")):
        Effects(**effects)


def test_a_drift_for_other_bands_is_refused(paper):
    settings = SimulationSettings(effects=Effects(delay_drift_ps=(1.0, 2.0)))
    with pytest.raises(SceneError, match="2 entries but the instrument has 9 bands"):
        expected_rates(scene("plane", paper), paper, settings)
