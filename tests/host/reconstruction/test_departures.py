# SPDX-License-Identifier: Apache-2.0
"""The check of a whole picture, and what is done about what it finds.

Pictures are drawn from pulses in continuous time; the calibration's waveforms are those pulses, so
that nothing but the departure under test is off.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace

import msgspec
import numpy as np
import pytest
import xarray as xr

import hueflight as hf
from hueflight import simulator
from hueflight.calibration.drift import with_drift
from hueflight.errors import CalibrationError, HistogramError, HueflightError
from hueflight.model import BackgroundShape
from hueflight.reconstruction import ImageCheck, departures, with_floor

Small = Callable[..., hf.Instrument]
Draw = Callable[..., np.ndarray]
ROWS, COLS = 24, 32
DRIFT_PS = (-180.0, 160.0, 140.0, -120.0, 190.0, -120.0, 40.0, -180.0, 70.0)  # their mean is 0
QUIET = simulator.SimulationSettings.ideal(white_detections=0.05, ambient=0.01)
BRIGHTER = 2.5  #: light of the pictures relative to that of the calibration


@pytest.fixture(scope="module")
def instrument() -> hf.Instrument:
    paper = hf.Instrument.load("paper")
    sensor = msgspec.structs.replace(paper.sensor, rows=ROWS, cols=COLS)
    return paper.replace(sensor=sensor, lens=None)


@pytest.fixture(scope="module")
def calibration(instrument: hf.Instrument) -> hf.Calibration:
    settings = QUIET.replace(white_detections=0.05 / BRIGHTER)
    reference = simulator.simulate_capture(
        "reference", instrument, frames=1_000_000, distance=1.0, settings=settings, seed=1
    )
    bands = simulator.simulate_capture(
        "bands", instrument, frames=1_000_000, distance=1.0, settings=settings, seed=2
    )
    return hf.calibrate(reference, instrument, distance=1.0, bands=bands)


def picture(
    instrument: hf.Instrument, seed: int = 3, ambient: float = 0.01, **effects: object
) -> np.ndarray:
    """About 3000 photons in every pixel from a white plane."""
    settings = QUIET.replace(ambient=ambient, effects=simulator.Effects(**effects))
    return simulator.simulate_capture(
        "reference", instrument, frames=60_000, distance=1.2, settings=settings, seed=seed
    )


def checked(histogram: np.ndarray, calibration: hf.Calibration) -> ImageCheck:
    return hf.check_image(histogram, calibration, hf.reconstruct(histogram, calibration))


def test_picture_that_obeys_its_calibration_names_nothing(
    instrument: hf.Instrument, calibration: hf.Calibration
) -> None:
    # no score of seven above 4 in any of three pictures: false alarm in 7e-4 of such tests
    for seed in (3, 4, 5):
        check = checked(picture(instrument, seed), calibration)
        assert check.holds, str(check)


def test_drift_of_delays_is_found_and_corrected(
    instrument: hf.Instrument, calibration: hf.Calibration
) -> None:
    histogram = picture(instrument, delay_drift_ps=DRIFT_PS)
    image = hf.reconstruct(histogram, calibration)
    correction = hf.correct_drift(histogram, calibration, image)
    delay = correction.before["delay"]
    assert [suspect.name for suspect in correction.before.found] == ["delay"]
    error = (np.array(delay.sizes) - DRIFT_PS) / delay.deviations
    assert np.sqrt(np.mean(error**2)) < 2  # of 9 values: exceeded in 1e-4 of draws
    assert correction.after.holds, str(correction.after)
    drift = correction.calibration.provenance["drift"]
    np.testing.assert_allclose(drift["delay_ps"], DRIFT_PS, atol=4 * max(delay.deviations))
    assert drift["width_factor"] == [1.0] * 9


def test_longer_pulses_are_found_as_width(
    instrument: hf.Instrument, calibration: hf.Calibration
) -> None:
    histogram = picture(instrument, pulse_width_factor=1.05)
    image = hf.reconstruct(histogram, calibration)
    correction = hf.correct_drift(histogram, calibration, image)
    assert correction.before["width"].found
    assert not correction.before["tail"].found
    factors = np.array(correction.calibration.provenance["drift"]["width_factor"])
    assert np.average(factors, weights=calibration.brightness) == pytest.approx(1.05, abs=0.01)


def test_tail_is_found_and_widens_the_deviations(
    instrument: hf.Instrument, calibration: hf.Calibration
) -> None:
    histogram = picture(instrument, tail_share=0.2, tail_ns=3.0)
    image = hf.reconstruct(histogram, calibration)
    check = hf.check_image(histogram, calibration, image)
    assert check["tail"].found
    widened = with_floor(image, histogram, calibration, check)
    error = np.abs(image["depth"].values - 1.2)
    assert (error < 1.96 * image["depth_std"].values).mean() < 0.5
    assert (error < 1.96 * widened["depth_std"].values).mean() >= 0.9
    assert (widened["reflectance_std"] >= image["reflectance_std"]).all()
    assert widened["depth_std"].attrs["systematic"].startswith("predicted bias by tail")
    scores = {"tail": 0.0, "flare": 9.0}  # as if the light had been a flare
    suspects = [replace(one, score=scores.get(one.name, one.score)) for one in check.suspects]
    flare = with_floor(image, histogram, calibration, replace(check, suspects=tuple(suspects)))
    assert flare["depth_std"].attrs["systematic"] == "predicted bias by flare"
    assert (flare["depth_std"] >= image["depth_std"]).all()
    assert not flare["depth_std"].equals(widened["depth_std"])


def test_image_without_tails_keeps_its_deviations(
    instrument: hf.Instrument, calibration: hf.Calibration
) -> None:
    histogram = picture(instrument)
    image = hf.reconstruct(histogram, calibration)
    check = hf.check_image(histogram, calibration, image)
    assert with_floor(image, histogram, calibration, check) is image


@pytest.mark.parametrize(
    "effects",
    [
        {"background_ramp": 0.5},
        {"background_decay_share": 0.4, "background_decay_ns": 50.0},
    ],
    ids=["ramp", "decay"],
)
def test_sloped_background_no_longer_biases_reflectance(
    instrument: hf.Instrument, calibration: hf.Calibration, effects: dict[str, float]
) -> None:
    histogram = picture(instrument, ambient=1.0, **effects)
    flat = hf.reconstruct(histogram, calibration)
    sloped = hf.reconstruct(histogram, calibration, background="sloped")
    bias = [
        np.abs(image["reflectance"].mean(("row", "col")).values / BRIGHTER - 1)
        for image in (flat, sloped)
    ]
    assert bias[0].max() > 0.2
    assert bias[1].max() < 0.02
    assert "shape" in sloped["background"].attrs
    assert "shape" not in flat["background"].attrs


def test_flat_background_stays_flat_when_a_slope_is_looked_for(
    instrument: hf.Instrument, calibration: hf.Calibration
) -> None:
    histogram = picture(instrument, ambient=1.0)
    flat = hf.reconstruct(histogram, calibration)
    sloped = hf.reconstruct(histogram, calibration, background="sloped")
    np.testing.assert_array_equal(flat["reflectance"], sloped["reflectance"])


def test_shape_can_be_given(instrument: hf.Instrument, calibration: hf.Calibration) -> None:
    histogram = picture(instrument, ambient=1.0, background_ramp=0.5)
    image = hf.reconstruct(histogram, calibration, background=BackgroundShape(slope=0.5))
    check = hf.check_image(histogram, calibration, image)  # against what the image states
    assert not check["background slope"].found
    flat = hf.check_image(histogram, calibration, image, background=BackgroundShape())
    assert flat["background slope"].found


def test_uneven_bins_are_found(instrument: hf.Instrument, calibration: hf.Calibration) -> None:
    check = checked(picture(instrument, ambient=1.0, bin_width_drift=0.1), calibration)
    assert check["bin widths"].found
    assert check["bin widths"].sizes[0] == pytest.approx(0.1, rel=0.2)


def test_result_is_plain_json(instrument: hf.Instrument, calibration: hf.Calibration) -> None:
    check = checked(picture(instrument), calibration)
    plain = json.loads(json.dumps(check.to_json()))
    assert {one["name"] for one in plain["suspects"]} >= {"delay", "width", "tail", "flare"}
    assert "obeys its calibration" in str(check)
    with pytest.raises(KeyError):
        check["moon"]


def test_too_few_pixels_are_refused(instrument: hf.Instrument, calibration: hf.Calibration) -> None:
    histogram = picture(instrument)
    image = hf.reconstruct(histogram, calibration, region=np.s_[:2, :3])
    with pytest.raises(HistogramError, match="only 6 pixels"):
        hf.check_image(histogram, calibration, image)


def test_one_band_in_bins_too_wide_to_tell_their_widths(small: Small, draw: Draw) -> None:
    """Delays of bands against one another, and widths of bins, are not looked for."""
    one = small(rows=16, cols=16, code_bits=8, bin_width_ns=1.926)
    one = one.replace(bands=one.bands[4:5])
    calibration = hf.calibrate(draw(one, photons=20_000), one, distance=0.5)
    histogram = draw(one, depth=0.9, photons=3000, background=50, seed=1)
    image = hf.reconstruct(histogram, calibration)
    check = hf.check_image(histogram, calibration, image, pileup_correction=False)
    assert check.holds, str(check)
    names = ["width", "background slope", "tail", "background decay", "flare"]
    assert [suspect.name for suspect in check.suspects] == names


def test_counts_that_are_smoothed_are_refused(small: Small, draw: Draw) -> None:
    coarse = small(rows=12, cols=12, code_bits=7, bin_width_ns=2.568)
    histogram = draw(coarse, photons=20_000)
    calibration = hf.calibrate(histogram, coarse, distance=0.5)
    with pytest.raises(HueflightError, match="the bins are too wide for the pulses"):
        checked(histogram, calibration)


def test_departures_that_never_settle_are_given_up(
    calibration: hf.Calibration, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each check finds another slope and one more picosecond, however often it is corrected."""
    slopes = (0.1 * number for number in range(1, 9))
    checks = {
        "sample_pixels": lambda *_, background, **_options: background,
        "check_pixels": lambda shape, _calibration: ImageCheck((), 100, 1e5, shape),
        "background_found": lambda _check: BackgroundShape(slope=next(slopes)),
        "drift_of": lambda _suspects, bands: (np.ones(bands), np.ones(bands)),
    }
    for name, stub in checks.items():
        monkeypatch.setattr(departures, name, stub)
    histogram = np.ones(calibration.instrument.histogram_shape, np.uint32)
    nothing = np.zeros((ROWS, COLS))
    image = xr.Dataset(dict.fromkeys(("depth", "quality"), (("row", "col"), nothing)))
    shape = BackgroundShape()
    correction = hf.correct_drift(histogram, calibration, image, background=shape)
    assert correction.background.slope == pytest.approx(0.1 * departures.BACKGROUND_PASSES)
    drift = correction.calibration.provenance["drift"]
    np.testing.assert_allclose(drift["delay_ps"], float(departures.DRIFT_PASSES))


def test_methods_that_can_not_take_a_slope_refuse_it(
    instrument: hf.Instrument, calibration: hf.Calibration
) -> None:
    histogram = picture(instrument)
    with pytest.raises(HueflightError, match=r"background = 'sloped'.*joint"):
        hf.reconstruct(histogram, calibration, method="paper", background="sloped")
    with pytest.raises(HueflightError, match="choose 'flat' or 'sloped'"):
        hf.reconstruct(histogram, calibration, background="steep")


def test_drift_adds_up_and_is_kept_in_files(calibration: hf.Calibration, tmp_path: object) -> None:
    once = with_drift(calibration, delay_ps=np.arange(9.0), width_factor=1.1)
    twice = with_drift(once, delay_ps=1.0, width_factor=1.1)
    twice.save(tmp_path / "drifted.zarr")
    drift = hf.Calibration.load(tmp_path / "drifted.zarr").provenance["drift"]
    np.testing.assert_allclose(drift["delay_ps"], np.arange(9.0) + 1)
    np.testing.assert_allclose(drift["width_factor"], 1.21)
    assert "drift" not in calibration.provenance


@pytest.mark.parametrize("wrong", [{"delay_ps": np.nan}, {"width_factor": 3.0}])
def test_absurd_drift_is_refused(calibration: hf.Calibration, wrong: dict[str, float]) -> None:
    with pytest.raises(CalibrationError, match=next(iter(wrong))):
        with_drift(calibration, **wrong)
    assert replace(calibration).provenance == calibration.provenance
