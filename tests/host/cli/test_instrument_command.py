# SPDX-License-Identifier: Apache-2.0
"""Making, checking and showing an instrument on the command line."""

import json
from pathlib import Path

import numpy as np
import pytest

from hueflight.cli import main
from hueflight.model.instrument import Instrument

OPTIONS = ["--rows", "6", "--cols", "8", "--code-bits", "7", "--bin-width", "0.5", "--period", "60"]
BANDS = ["--band", "red,640,5,2", "--band", "green,530,20,2.5"]


def run(*words) -> int:
    with pytest.raises(SystemExit) as ended:
        main([str(word) for word in words])
    return ended.value.code or 0


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def test_from_options_to_a_checked_description(draw, capsys):
    pytest.importorskip("matplotlib")
    assert run("instrument", "new", "lab.toml", *OPTIONS, *BANDS) == 0
    assert "point clouds have no width" in capsys.readouterr().err
    made = Instrument.load("lab.toml")
    assert (made.name, made.histogram_shape) == ("lab", (6, 8, 128))
    assert [band.pulse_fwhm_ns for band in made.bands] == [2, 2.5]
    assert all(band.emission_fwhm_nm is None for band in made.bands)
    assert run("instrument", "new", "lab.toml", *OPTIONS, *BANDS) == 1
    assert "lab.toml" in capsys.readouterr().err

    np.save("board.npy", draw(made, depth=0.5, photons=5000))
    check = ["instrument", "check", "lab.toml", "board.npy", "-d", "0.5"]
    assert run(*check, "--picture", "check.png", "--json") == 0
    assert json.loads(capsys.readouterr().out)["fits"]
    assert Path("check.png").read_bytes()[:4] == b"\x89PNG"
    assert run("instrument", "new", "off.toml", *OPTIONS, *BANDS[:3], "green,530,26,2.5") == 0
    assert run("instrument", "check", "off.toml", "board.npy", "-d", "0.5") == 1
    assert "delay_ns" in capsys.readouterr().out


def test_a_lens_by_its_field_of_view():
    angle = ["--field-of-view", 20, "--pixel-width", 50]
    assert run("instrument", "new", "lab.toml", *OPTIONS, *BANDS, *angle) == 0
    right, down = Instrument.load("lab.toml").ray_slopes()
    # the outer edges lie half a pixel beyond the middles of the outer pixels
    assert right.max() * 8 / 7 == pytest.approx(np.tan(np.radians(10)), rel=1e-5)
    assert down.max() / right.max() == pytest.approx(5 / 7)


def test_show(capsys):
    assert run("instrument", "show", "paper", "--toml") == 0
    assert Instrument.from_toml(capsys.readouterr().out) == Instrument.load("paper")
    assert run("instrument", "show", "paper", "--json") == 0
    assert json.loads(capsys.readouterr().out)["period_ns"] == 320


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--rows", "3", *BANDS], "--cols, --code-bits, --bin-width missing"),
        (OPTIONS, "--band missing"),
        ([*OPTIONS, "--band", "red,640"], "--band red,640: give NAME"),
        ([*OPTIONS, "--band", "red,x,5,2"], "'x': a number is needed"),
        ([*OPTIONS, *BANDS, "--focal-length", "8"], "need --pixel-width"),
        ([*OPTIONS, *BANDS, "--from", "no.ptu"], "no.ptu"),
    ],
)
def test_what_is_missing_is_said(words, message, capsys):
    assert run("instrument", "new", "lab.toml", *words) == 1
    said = capsys.readouterr().err
    assert message in said
    assert "Traceback" not in said


def test_a_cloud_without_a_lens_says_so(draw, capsys):
    assert run("instrument", "new", "lab.toml", *OPTIONS, *BANDS) == 0
    made = Instrument.load("lab.toml")
    np.save("board.npy", draw(made, depth=0.5, photons=5000))
    calibrate = ["calibrate", "board.npy", "--instrument", "lab.toml", "-d", "0.5", "-o", "c.zarr"]
    assert run(*calibrate) == 0
    image = ["reconstruct", "board.npy", "-c", "c.zarr", "-o", "i.zarr", "--no-preview"]
    assert run(*image) == 0
    capsys.readouterr()
    assert run("export", "i.zarr", "i.ply") == 0
    assert "no lens, so that the points lie on a line" in capsys.readouterr().err
    assert run("export", "i.zarr", "i.csv") == 0
    # and no spectral width is invented where none was stated
    lines = [line for line in Path("i.csv").read_text().splitlines() if not line.startswith("#")]
    assert lines[1].split(",")[2:4] == ["640", ""]
    assert run("export", "i.zarr", "i.hdr") == 0
    assert "fwhm" not in Path("i.hdr").read_text()
