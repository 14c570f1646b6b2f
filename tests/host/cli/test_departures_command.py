# SPDX-License-Identifier: Apache-2.0
"""The options of `hueflight reconstruct` that check the whole picture."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import hueflight as hf
from hueflight import simulator
from hueflight.cli.app import main
from hueflight.importers.captures import write_counts
from hueflight.model import BackgroundShape
from hueflight.reconstruction.sampled_pixels import background_of

DRIFT_PS = (-600.0, 200.0, 100.0, 0.0, 100.0, 0.0, 100.0, 0.0, 100.0)


@pytest.fixture(scope="module")
def folder(small, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A calibration, a capture whose first LED fires early, and one in ambient light that rises."""
    path = tmp_path_factory.mktemp("departures")
    camera = small("paper", rows=12, cols=12)
    plain = simulator.SimulationSettings.ideal(white_detections=0.05, ambient=0.2)
    words = {"distance": 1.0, "frames": 400_000}
    captures = {
        kind: simulator.simulate_capture(kind, camera, settings=plain, **words)
        for kind in ("reference", "bands")
    }
    hf.calibrate(captures["reference"], camera, distance=1.0, bands=captures["bands"]).save(
        path / "cal.zarr"
    )
    for name, effects in {
        "drifted": simulator.Effects(delay_drift_ps=DRIFT_PS),
        "rising": simulator.Effects(background_ramp=0.5),
    }.items():
        settings = plain.replace(effects=effects)
        counts = simulator.simulate_capture("reference", camera, settings=settings, seed=7, **words)
        write_counts(path / f"{name}.npz", counts, camera)
    return path


@pytest.fixture
def run(folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    monkeypatch.chdir(folder)

    def run(*words: str, code: int = 0) -> str:
        with pytest.raises(SystemExit) as stop:
            raise SystemExit(main(["reconstruct", *words, "-c", "cal.zarr", "--no-preview"]))
        captured = capsys.readouterr()
        assert (stop.value.code or 0) == code, captured.err
        return captured.err if code else captured.out

    return run


def test_check_is_printed_and_stated_in_the_image(folder: Path, run) -> None:
    shown = json.loads(run("drifted.npz", "-o", "checked.zarr", "--check", "--json"))
    assert shown["departures"] >= 1
    assert "deep red -" in shown["departure_delay"]
    stated = json.loads(hf.read_image(folder / "checked.zarr").attrs["image_check"])
    found = [suspect["name"] for suspect in stated["suspects"] if suspect["found"]]
    assert "delay" in found


def test_drift_is_corrected_on_request(folder: Path, run) -> None:
    shown = json.loads(run("drifted.npz", "-o", "corrected.zarr", "--correct-drift", "--json"))
    drift = json.loads(shown["drift_corrected"])["delay_ps"]
    np.testing.assert_allclose(drift, DRIFT_PS, atol=100)
    image = hf.read_image(folder / "corrected.zarr")
    assert json.loads(image.attrs["calibration"])["drift"]["delay_ps"] == drift
    # the calibration itself stays as it is
    assert "drift" not in hf.Calibration.load(folder / "cal.zarr").provenance


def test_sloped_background_is_fitted_by_name(folder: Path, run) -> None:
    run("rising.npz", "-o", "sloped.zarr", "--background", "sloped")
    image = hf.read_image(folder / "sloped.zarr")
    assert background_of(image).slope == pytest.approx(0.5, abs=0.05)
    run("rising.npz", "-o", "flat.zarr")
    assert background_of(hf.read_image(folder / "flat.zarr")) == BackgroundShape()


def test_folders_and_other_methods_are_refused(run) -> None:
    message = run("drifted.npz", "-o", "all", "--check", code=1)
    assert "--check and --correct-drift take one capture" in message
    options = ("--method", "paper", "--correct-drift")
    assert "method 'paper'" in run("drifted.npz", "-o", "paper.zarr", *options, code=1)
